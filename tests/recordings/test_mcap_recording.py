"""Recordings in MCAP: exact, readable by others, and readable after any death of the writer."""

import dataclasses
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth_scene import bands

pytest.importorskip("foxglove")
pytest.importorskip("zstandard")

from full_disk import files_of_at_most

from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.recordings.convert import RecoverSettings, recover
from depthmocap.recordings.depth_codec import Coding, decode_depth
from depthmocap.recordings.mcap_file import McapFile, iterate_topics
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mcap_writer import McapWriter

PERIOD = 33_000_000
START = 1_700_000_000_000_000_000


def make_rig() -> Rig:
    poses = [look_at(np.array(eye), np.array([0.0, 0.0, 1.0])) for eye in ((0.1, -3.0, 1.3), (3.0, 0.2, 1.7))]
    return Rig(
        (
            DepthCamera("front", 40, 24, 30.1, 31.2, 19.3, 12.1, poses[0], (0.1, -0.2, 1e-3, 2e-3, 0.05), 0.00025),
            DepthCamera("seite links", 32, 16, 1 / 3 * 100, 30.0, 16.0, 8.0, poses[1]),
        ),
        up="y",
    )


def make_frame(camera: DepthCamera, seed: int = 0) -> np.ndarray:
    return bands((camera.height, camera.width), np.random.default_rng(seed))


def write(path: Path, count: int = 5, coding: Coding = "delta-zstd", **options) -> Rig:
    rig = make_rig()
    with McapWriter(path, rig, coding=coding, start_ns=START, **options) as writer:
        for i in range(count):
            for k, camera in enumerate(rig.cameras):
                writer.write(camera.name, START + i * PERIOD + k * 1000, make_frame(camera, 10 * i + k))
    return rig


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write(tmp_path / "rec.mcap")
    return tmp_path / "rec.mcap"


def same_camera(a: DepthCamera, b: DepthCamera) -> bool:
    return np.array_equal(a.world_from_camera, b.world_from_camera) and all(
        getattr(a, key) == getattr(b, key)
        for key in ("name", "width", "height", "fx", "fy", "cx", "cy", "distortion", "depth_unit_m")
    )


@pytest.mark.parametrize("coding", ["delta-zstd", "png", "raw"])
def test_everything_comes_back_exactly(tmp_path: Path, coding: Coding) -> None:
    path = tmp_path / "rec.mcap"
    rig = dataclasses.replace(make_rig(), area_m=((0.0, 0.0), (1.5, 0.0), (1.5, 2.0)))
    empty = make_frame(rig.cameras[1], 99)
    joints = np.random.default_rng(3).normal(size=(3, 18, 3))
    joints[1, 4] = np.nan
    with McapWriter(path, rig, {"seite links": empty}, coding, start_ns=START) as writer:
        for i in range(3):
            for k, camera in enumerate(rig.cameras):
                writer.write(camera.name, START + i * PERIOD + k, make_frame(camera, 10 * i + k))
            writer.write_truth(START + i * PERIOD, joints[i])
    recording = McapRecording(path)
    assert recording.complete
    assert recording.problems == []
    assert (recording.up, recording.rig.names, recording.period_ns) == ("y", rig.names, PERIOD)
    assert recording.area_m == rig.area_m
    assert all(map(same_camera, recording.rig.cameras, rig.cameras))
    assert len(recording) == 3
    for i, frame_set in enumerate(recording):
        assert [view.camera.name for view in frame_set.views] == list(rig.names)
        np.testing.assert_array_equal(frame_set.true_joints, joints[i])
        for k, camera in enumerate(rig.cameras):
            raw = recording.raw(camera.name, START + i * PERIOD + k)
            np.testing.assert_array_equal(raw, make_frame(camera, 10 * i + k))
            np.testing.assert_array_equal(frame_set.views[k].depth_m, camera.to_metres(raw))
    found = recording.raw_background("seite links")
    assert found is not None
    np.testing.assert_array_equal(found, empty)
    assert recording.background("front") is None


def message_class(name: str, descriptors: bytes) -> Any:
    """The class of a protobuf message, from the descriptors in the file."""
    descriptor_pb2 = pytest.importorskip("google.protobuf.descriptor_pb2")
    from google.protobuf import descriptor_pool, message_factory

    files = descriptor_pb2.FileDescriptorSet.FromString(descriptors)
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


@pytest.mark.parametrize("coding", ["delta-zstd", "png", "raw"])
def test_another_reader_reads_the_file(tmp_path: Path, coding: Coding) -> None:
    """The reference reader, with the message types that the file itself describes."""
    reader_module = pytest.importorskip("mcap.reader")
    rig = write(tmp_path / "rec.mcap", 3, coding)
    with (tmp_path / "rec.mcap").open("rb") as stream:
        reader = reader_module.make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 2 * (2 + 3 + 2)  # calibrations stand at both ends
        assert len(summary.chunk_indexes) == 1 + 2 * 3 + 1
        names = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
        frames = 0
        for schema, channel, message in reader.iter_messages():
            decoded = message_class(schema.name, schema.data).FromString(message.data)
            name = channel.topic.split("/")[1]
            camera = rig[name]
            if channel.topic.endswith("/calibration"):
                assert list(decoded.K) == camera.matrix.ravel().tolist()
                assert list(decoded.D) == list(camera.distortion)
                assert (decoded.width, decoded.height) == (camera.width, camera.height)
            elif channel.topic.endswith("/transform"):
                t = decoded.translation
                assert [t.x, t.y, t.z] == camera.world_from_camera[:3, 3].tolist()
                assert (decoded.parent_frame_id, decoded.child_frame_id) == ("world", name)
            elif channel.topic.endswith("/depth"):
                raw = decode_depth(decoded.data, coding, (camera.width, camera.height))
                i, k = divmod(message.log_time - START, PERIOD)
                np.testing.assert_array_equal(raw, make_frame(camera, 10 * i + k // 1000))
                assert decoded.frame_id == name
                assert decoded.timestamp.ToNanoseconds() == message.log_time
                if coding == "raw":
                    assert (decoded.encoding, decoded.step) == ("16UC1", 2 * camera.width)
                else:
                    assert decoded.format == coding
                frames += 1
        assert frames == 6
    kind = "RawImage" if coding == "raw" else "CompressedImage"
    assert names["/front/depth"] == f"foxglove.{kind}"
    assert names["/front/calibration"] == "foxglove.CameraCalibration"


def test_cut_off_anywhere_every_frame_before_the_cut_is_read(file: Path, tmp_path: Path) -> None:
    whole, data = McapFile(file), file.read_bytes()
    ends = [whole._chunk(message.chunk)[1] + message.end for message in whole.messages if message.end > 0]
    counts = []
    for cut in range(9, len(data), 397):
        (tmp_path / "cut.mcap").write_bytes(data[:cut])
        with McapFile(tmp_path / "cut.mcap") as part:
            assert not part.complete
            counts.append(len(part.messages))
            assert counts[-1] == sum(end <= cut for end in ends)
            for message, original in zip(part.messages, whole.messages, strict=False):
                assert part.payload(message) == whole.payload(original)
    assert counts[0] == 0
    assert counts[-1] == len(whole.messages)


def test_a_cut_recording_says_so_and_runs(file: Path, tmp_path: Path) -> None:
    data = file.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * 0.6)])
    recording = McapRecording(cut)
    assert not recording.complete
    assert "cut off" in recording.problems[0]
    assert "recover" in recording.problems[0]
    assert 0 < len(recording) < 5
    assert all(len(frame_set.views) > 0 for frame_set in recording)


def test_a_flipped_bit_costs_one_frame(file: Path) -> None:
    with McapFile(file) as whole:
        message = [m for m in whole.messages if whole.channels[m.channel].topic.endswith("depth")][-3]
        at = whole._chunk(message.chunk)[1] + message.end - 20
    data = bytearray(file.read_bytes())
    data[at] ^= 1
    file.write_bytes(data)
    recording = McapRecording(file)
    views = [len(frame_set.views) for frame_set in recording]
    assert sum(views) == 9
    assert len(recording.problems) == 1
    assert "damaged" in recording.problems[0]


@pytest.mark.parametrize("kind", ["calibration", "transform", "background", "first frame", "last calibration"])
def test_any_damage_costs_what_it_hits_alone(tmp_path: Path, kind: str) -> None:
    path, camera = tmp_path / "rec.mcap", make_rig().cameras[0]
    write(path, backgrounds={camera.name: make_frame(camera)})
    with McapFile(path) as whole:
        found = {topic.topic: messages for topic, messages in iterate_topics(whole)}
        topic = "depth" if kind == "first frame" else kind.split()[-1]
        messages = found[f"/{camera.name}/{topic}"]
        message = messages[-1 if kind.startswith("last") else 0]
        at = whole._chunk(message.chunk)[1] + message.end - 5
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)
    for file in (path, tmp_path / "recovered.mcap"):
        if not file.exists():
            recover(RecoverSettings(path, file))
        recording = McapRecording(file)
        assert all(same_camera(a, b) for a, b in zip(recording.rig.cameras, make_rig().cameras, strict=True))
        views = [len(frame_set.views) for frame_set in recording]
        assert sum(views) == (9 if kind == "first frame" else 10)
        assert (recording.background(camera.name) is None) == (kind == "background")
        if file == path:
            assert recording.problems


def test_a_killed_writer_leaves_every_frame_it_reported(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    script = f"""
        import sys; sys.path[:0] = {[str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]!r}
        from test_mcap_recording import *
        rig = make_rig()
        writer = McapWriter(Path({str(path)!r}), rig, start_ns=START)
        for i in range(100000):
            writer.write("front", START + i * PERIOD, make_frame(rig["front"], i))
            print(i, flush=True)
    """
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    last = -1
    while last < 20:
        last = int(process.stdout.readline())
    process.kill()
    last = max([last, *map(int, process.stdout.read().split())])
    process.stdout.close()
    process.wait()
    recording = McapRecording(path)
    stamps = recording.stamps("front")
    assert len(stamps) in (last + 1, last + 2)  # one may have been written and not reported
    np.testing.assert_array_equal(recording.raw("front", stamps[last]), make_frame(recording.rig["front"], last))


def test_a_full_disk_is_told_and_keeps_what_was_written(tmp_path: Path) -> None:
    path, rig = tmp_path / "rec.mcap", make_rig()
    written = 0
    with files_of_at_most(30_000), McapWriter(path, rig, start_ns=START) as writer:
        with pytest.raises(InputError, match="cannot be written any further"):
            for i in range(1000):
                writer.write("front", START + i * PERIOD, make_frame(rig["front"], i))
                written += 1
        with pytest.raises(InputError, match="any further"):
            writer.write("front", START, make_frame(rig["front"], 0))
    assert 5 < written < 30
    recording = McapRecording(path)
    assert len(recording.stamps("front")) == written
    with McapFile(path) as file:
        assert file.sound_end == path.stat().st_size  # no half record at its end


def test_cameras_of_different_clocks_meet_by_arrival(tmp_path: Path) -> None:
    rig = make_rig()
    with McapWriter(tmp_path / "rec.mcap", rig, start_ns=START) as writer:
        for i in range(3):
            writer.write("front", 5_000 + i * PERIOD, make_frame(rig["front"]), START + i * PERIOD, "a")
            writer.write("seite links", 7 + i * PERIOD, make_frame(rig["seite links"]), START + i * PERIOD + 9, "b")
    recording = McapRecording(tmp_path / "rec.mcap")
    assert [len(frame_set.views) for frame_set in recording] == [2, 2, 2]
    assert recording[1].timestamp_ns == START + PERIOD + 4
    assert recording.device_time("front", START + PERIOD) == (5_000 + PERIOD, "a")


def test_bad_frames_are_refused(tmp_path: Path) -> None:
    rig = make_rig()
    frame = make_frame(rig["front"])
    with McapWriter(tmp_path / "rec.mcap", rig, start_ns=START) as writer:
        with pytest.raises(InputError, match="no camera 'back'"):
            writer.write("back", START, frame)
        with pytest.raises(InputError, match="24 rows and 40 columns"):
            writer.write("front", START, frame[:-1])
        for stamp in (-1, 2**32 * 10**9):
            with pytest.raises(InputError, match="timestamp_ns"):
                writer.write("front", stamp, frame)
        writer.write("front", START, frame)
        assert writer.frames == {"front": 1, "seite links": 0}
    with pytest.raises(InputError, match="exists already"):
        McapWriter(tmp_path / "rec.mcap", rig)
    with pytest.raises(InputError, match="cannot be written"):
        McapWriter(tmp_path / "none" / "rec.mcap", rig)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "not an MCAP"), (b"\x89MC", "within its first bytes"), (b"\x89MCAP1\r\nabc", "another version"),
     (b"PK\x03\x04 and so on", "not an MCAP"), (b"\x89MCAP0\r\n", "no foxglove.CameraCalibration")],
)  # fmt: skip
def test_foreign_files_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(InputError, match=message):
        McapRecording(tmp_path / "x.mcap")
    with pytest.raises(InputError, match="not found"):
        McapRecording(tmp_path / "missing.mcap")
