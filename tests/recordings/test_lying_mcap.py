"""MCAP files that lie cost what they lie about, or are told in one line; recover keeps whatever can be read."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

pytest.importorskip("foxglove")
pytest.importorskip("zstandard")

import foxglove
import zstandard
from foxglove import messages as fg

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.recordings import mcap_file
from depthmocap.recordings.convert import RecoverSettings, recover
from depthmocap.recordings.mcap_file import MAGIC, McapFile, iterate_topics
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mcap_writer import TRUTH_SCHEMA, McapSink

WIDTH, HEIGHT, PERIOD = 32, 24, 33_333_333
FRAMES = [np.full((HEIGHT, WIDTH), 1000 + i, "<u2") for i in range(3)]
JOINTS_AT_0 = {joint: [0.0, 1.0, 2.0] for joint in JOINTS}


def write(
    path: Path,
    focal: float = 30.0,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
    matrix: str | None = None,
    unit: str = "0.001",
    up: str = "z",
    stamps: tuple[int, ...] = (0, PERIOD, 2 * PERIOD),
    truth: tuple[bytes, ...] = (),
    others: tuple[tuple[str, str, Any], ...] = (),
) -> Path:
    """A recording of a camera "c", whatever it tells. ``others``: topic, encoding and schema of other channels."""
    sink = McapSink(path)
    channels, context = sink.sdk.channels, sink.context
    sink.metadata("depthmocap", {"version": "1", "up": up})
    K = [focal, 0.0, 16.0, 0.0, 30.0, 12.0, 0.0, 0.0, 1.0]
    calibration = fg.CameraCalibration(frame_id="c", width=size[0], height=size[1], K=K)
    channels.CameraCalibrationChannel("/c/calibration", context=context).log(calibration, log_time=0)
    x, y, z, w = rotation
    place = fg.FrameTransform(
        parent_frame_id="world", child_frame_id="c", translation=fg.Vector3(x=1.0, y=2.0, z=3.0),
        rotation=fg.Quaternion(x=x, y=y, z=z, w=w),
    )  # fmt: skip
    told = {} if matrix is None else {"world_from_camera": matrix}
    channels.FrameTransformChannel("/c/transform", context=context, metadata=told).log(place, log_time=0)
    depth = channels.RawImageChannel("/c/depth", context=context, metadata={"kind": "depth", "depth_unit_m": unit})
    for stamp, frame in zip(stamps, FRAMES, strict=True):
        at = fg.Timestamp(*divmod(stamp % 2**32, 10**9))
        image = fg.RawImage(
            timestamp=at, frame_id="c", width=WIDTH, height=HEIGHT, encoding="16UC1", step=2 * WIDTH,
            data=frame.tobytes(),
        )  # fmt: skip
        depth.log(image, log_time=stamp)
        sink.flush()
    if truth:
        channel = foxglove.Channel("/truth", schema=TRUTH_SCHEMA, message_encoding="json", context=context)
        for i, message in enumerate(truth):
            channel.log(message, log_time=i)
    for topic, encoding, schema in others:
        sink.channel(topic, encoding, {}, schema).log(topic.encode(), 5, None)
    sink.close()
    return path


def views(recording: McapRecording) -> int:
    return sum(len(frames.views) for frames in recording)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"unit": "x"}, 'depth_unit_m must be a finite number, got "x"'),
        ({"unit": "nan"}, 'depth_unit_m must be a finite number, got "nan"'),
        ({"unit": "-1"}, "depth_unit_m must be 1e-07 to 1 metres, got -1"),
        ({"focal": float("nan")}, "fx must be 1 to"),
        ({"size": (60_000, 60_000)}, "60000×60000"),
        ({"rotation": (1e-320, 0.0, 0.0, 0.0)}, "its length must be 1"),
        ({"rotation": (float("nan"), 0.0, 0.0, 1.0)}, "its length must be 1"),
        ({"matrix": "[x]"}, "world_from_camera is not valid JSON"),
        ({"matrix": 9999 * "["}, "brackets within one another"),
        ({"matrix": "[[1, 0], [0, 1]]"}, "world_from_camera must be 4×4"),
        ({"matrix": json.dumps((2 * np.eye(4)).tolist())}, "not a rotation"),
        ({"up": "x"}, 'up must be "z"'),
        ({"stamps": (2**63, 2**63 + 1, 2**64 - 1)}, "3 frames of 'c' have no time that can be"),
    ],
)
def test_numbers_that_are_none_are_told(tmp_path: Path, options: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        McapRecording(write(tmp_path / "x.mcap", **options))


def test_frames_and_true_joints_that_lie_are_left_out_alone(tmp_path: Path) -> None:
    good = json.dumps({"timestamp_ns": 0, "joints": JOINTS_AT_0}).encode()
    bad = [
        9999 * b"[", b'{"timestamp_ns": ' + 5000 * b"9" + b"}", b'{"timestamp_ns": 0}', b"\xff", b"",
        json.dumps({"timestamp_ns": 1e999, "joints": JOINTS_AT_0}).encode(),
        json.dumps({"timestamp_ns": 5, "joints": JOINTS_AT_0 | {"Head": [True, 0, 0]}}).encode(),
        json.dumps({"timestamp_ns": 5, "joints": {"Head": [0, 0, 0]}}).encode(),
    ]  # fmt: skip
    recording = McapRecording(write(tmp_path / "x.mcap", stamps=(0, PERIOD, 2**63), truth=(good, *bad)))
    assert views(recording) == 2
    assert [stamp for stamp, _ in recording.truth_rows()] == [0]
    assert len(recording.problems) == 1 + len(bad)
    assert "1 frames of 'c' have no time that can be" in recording.problems[0]
    assert all("true joints" in problem and "left out" in problem for problem in recording.problems[1:])


def test_a_place_without_a_rotation_is_not_turned(tmp_path: Path) -> None:
    (camera,) = McapRecording(write(tmp_path / "x.mcap", rotation=(0.0, 0.0, 0.0, 0.0))).rig.cameras
    assert np.array_equal(camera.world_from_camera[:, 3], [1, 2, 3, 1])
    assert np.array_equal(camera.world_from_camera[:3, :3], np.eye(3))


def test_recover_keeps_channels_of_every_kind(tmp_path: Path) -> None:
    odd = foxglove.Schema(name="n\0", encoding="zz", data=b"\xff")
    others = (("/imu", "cdr", None), ("/note", "json", None), ("/a\0b", "", None), ("/odd", "protobuf", odd))
    source = write(tmp_path / "x.mcap", stamps=(0, PERIOD, 2**64 - 1), others=others)
    told = recover(RecoverSettings(source, tmp_path / "y.mcap"), Console(quiet=True))
    assert told == {"frames": 3, "damaged": 0, "lost_bytes": 0}

    def contents(path: Path) -> list[Any]:
        with McapFile(path) as file:
            return [
                (channel.topic, channel.encoding, channel.schema_name, channel.schema_encoding, channel.schema,
                 [(message.log_time_ns, file.payload(message)) for message in messages])
                for channel, messages in iterate_topics(file)
            ]  # fmt: skip

    assert contents(tmp_path / "y.mcap") == contents(source)


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _chunk(compression: str, packed: bytes, size: int) -> bytes:
    name = struct.pack("<I", len(compression)) + compression.encode()
    return _record(6, struct.pack("<QQQI", 0, 0, size, 0) + name + struct.pack("<Q", len(packed)) + packed)


def _packers() -> dict[str, Any]:
    packers = {"zstd": zstandard.ZstdCompressor(write_content_size=False).compress}
    try:
        import lz4.frame

        packers["lz4"] = lz4.frame.compress
    except ModuleNotFoundError:
        pass
    return packers


def test_chunks_unpack_to_what_they_say_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = write(tmp_path / "x.mcap")
    with McapFile(whole) as file:
        sound = whole.read_bytes()[len(MAGIC) : file.sound_end]
    records = b"".join(_record(5, struct.pack("<HIQQ", 1, 0, i, 0) + b"abc") for i in range(9))
    monkeypatch.setattr(mcap_file, "LARGEST_CHUNK", 1 << 20)
    for compression, pack in _packers().items():
        for data, size, count, told in (
            (records, len(records), 9, None),
            (records, len(records) - 1, 0, "does not unpack to the"),
            (records, len(records) + 1, 0, "does not unpack to the"),
            (bytes(50_000_000), 1000, 0, "is damaged: "),
            (bytes(50_000_000), 50_000_000, 0, "it says that it unpacks to 50,000,000 bytes"),
            (bytes(500_000), 500_000, 0, None),  # records of no kind
        ):
            path = tmp_path / f"{compression}.mcap"
            path.write_bytes(MAGIC + sound + _chunk(compression, pack(data), size) + _record(15, struct.pack("<I", 0)))
            with McapFile(path) as file:
                assert sum(message.end - message.start == 3 for message in file.messages) == count
                assert len(file.problems) == (told is not None)
                assert told is None or told in file.problems[0]
            recording = McapRecording(path)  # messages of its calibration that are none
            assert views(recording) == 3
            assert any("not protobuf" in problem for problem in recording.problems) == (count > 0)
