"""MKV files of the Azure Kinect's recorder."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth_scene import bands
from mkv_file import calibration, write_mkv
from rich.console import Console

from depthmocap.cameras.registry import open_camera
from depthmocap.errors import InputError
from depthmocap.recordings.convert import ConvertSettings, convert
from depthmocap.recordings.mkv_recording import MkvRecording
from depthmocap.recordings.open_recording import open_recording

STAMPS = [1_000_007 + 33_333 * i for i in range(6)]


def picture(seed: int, size: tuple[int, int] = (288, 320)) -> np.ndarray:
    return bands(size, np.random.default_rng(seed))


def frames(size: tuple[int, int] = (288, 320)) -> list[tuple[int, np.ndarray]]:
    return [(stamp, picture(i, size)) for i, stamp in enumerate(STAMPS)]


@pytest.mark.parametrize("unknown", [False, True])
def test_every_frame_as_it_was(tmp_path: Path, unknown: bool) -> None:
    write_mkv(tmp_path / "take.mkv", frames(), unknown=unknown)
    recording = open_recording(tmp_path / "take.mkv")
    assert isinstance(recording, MkvRecording)
    stamps = recording.stamps("take")
    # Within a cluster the first time cannot be before the cluster's, so that the first frame is 7 µs late.
    assert stamps == [1000 * stamp + (7000 if i == 0 else 0) for i, stamp in enumerate(STAMPS)]
    for i, stamp in enumerate(stamps):
        np.testing.assert_array_equal(recording.raw("take", stamp), picture(i))
        assert recording.device_time("take", stamp) == (stamp, "azure 000123 device")
    assert (len(recording), recording.up, recording.problems) == (6, "-y", [])
    assert recording[2].views[0].depth_m[5, 7] == pytest.approx(picture(2)[5, 7] / 1000)


@pytest.mark.parametrize(
    ("width", "height", "fx", "fy", "cx", "cy"),
    [
        # As k4a_calibration_get_from_raw of the SDK 1.4.2 computes them from the same calibration.
        (320, 288, 252.160004, 252.416, 159.5, 170.619995),
        (640, 576, 504.320007, 504.832001, 319.5, 341.73999),
        (512, 512, 252.160004, 252.416, 255.5, 260.619995),
        (1024, 1024, 504.320007, 504.832001, 511.5, 521.73999),
    ],
)
def test_calibration_of_each_mode(
    tmp_path: Path, width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> None:
    write_mkv(tmp_path / "take.mkv", [(7, picture(0, (height, width)))])
    (camera,) = MkvRecording(tmp_path / "take.mkv").rig.cameras
    assert (camera.width, camera.height, camera.depth_unit_m) == (width, height, 0.001)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((fx, fy, cx, cy), abs=1e-4)
    assert camera.distortion[2:4] == (1e-4, -2e-5)
    assert camera.distortion[0] == pytest.approx(0.52 - 0.86, abs=0.02)  # about what is left of the rational lens


def test_the_camera_is_called_as_the_file_as_far_as_it_can_be(tmp_path: Path) -> None:
    for file, name in (("take 1.mkv", "take 1"), ("con.mkv", "camera-con"), ("...mkv", "camera")):
        write_mkv(tmp_path / file, frames()[:1])
        assert MkvRecording(tmp_path / file).rig.names == (name,)


def test_converted_and_as_a_camera(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    write_mkv(tmp_path / "take.mkv", frames())
    convert(ConvertSettings(tmp_path / "take.mkv", tmp_path / "take.mcap"), Console(quiet=True))
    copied = open_recording(tmp_path / "take.mcap")
    assert copied.stamps("take") == open_recording(tmp_path / "take.mkv").stamps("take")
    assert copied.device_time("take", copied.stamps("take")[0])[1] == "azure 000123 device"
    np.testing.assert_array_equal(copied.raw("take", copied.stamps("take")[3]), picture(3))
    with open_camera(str(tmp_path / "take.mkv")) as source:
        assert [int(frame.raw[0, 0]) for frame in source] == [int(picture(i)[0, 0]) for i in range(6)]


def test_wired_cameras_share_a_clock(tmp_path: Path) -> None:
    write_mkv(tmp_path / "take.mkv", frames(), tags={"K4A_WIRED_SYNC_MODE": "SUBORDINATE"})
    recording = open_recording(tmp_path / "take.mkv")
    assert recording.device_time("take", recording.stamps("take")[0])[1] == "azure wired"


@pytest.mark.parametrize("unknown", [False, True])
def test_a_file_that_was_cut_off_is_read_to_there(tmp_path: Path, unknown: bool) -> None:
    write_mkv(tmp_path / "take.mkv", frames(), unknown=unknown)
    data = (tmp_path / "take.mkv").read_bytes()
    for lost, left in ((1, 5), (200_000, 5), (2 * 370_000, 3)):
        (tmp_path / "cut.mkv").write_bytes(data[:-lost])
        recording = open_recording(tmp_path / "cut.mkv")
        assert len(recording.stamps("cut")) == left
        assert "was cut off" in recording.problems[0]
        np.testing.assert_array_equal(recording.raw("cut", recording.stamps("cut")[-1]), picture(left - 1))


def test_garbage_never_gets_out(tmp_path: Path) -> None:
    """Whatever is in the file, it is read or told in one message."""
    write_mkv(tmp_path / "take.mkv", frames()[:2])
    data = bytearray((tmp_path / "take.mkv").read_bytes())
    rng = np.random.default_rng(0)
    read = 0
    for _ in range(150):
        bad = data.copy()
        for at in rng.integers(0, 1200, 3):
            bad[at] ^= 1 << int(rng.integers(8))
        (tmp_path / "bad.mkv").write_bytes(bad)
        try:
            recording = open_recording(tmp_path / "bad.mkv")
            read += len(recording)
        except InputError as error:
            assert "bad" in str(error)
    assert read > 20


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "COLOR"}, "no track DEPTH.*COLOR, IR"),
        ({"fourcc": b"MJPG"}, "unknown form.*MJPG"),
        ({"attached": b"{}"}, "calibration of the depth camera cannot be read"),
        ({"attached": b"no json"}, "calibration of the depth camera cannot be read"),
        ({"attached": calibration("elsewhere")}, "calibration of the depth camera cannot be read"),
        ({"tags": {"K4A_CALIBRATION_FILE": "other.json"}}, "no calibration attached"),
        ({"tags": {"K4A_START_OFFSET_NS": "soon"}}, "K4A_START_OFFSET_NS.*'soon'"),
        ({"frames": []}, "no depth frame"),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    write_mkv(tmp_path / "take.mkv", **{"frames": frames()[:1], **change})
    with pytest.raises(InputError, match=message):
        open_recording(tmp_path / "take.mkv")


def test_files_that_are_none(tmp_path: Path) -> None:
    for content, message in ((b"", "it is empty"), (b"RIFF1234", "not a Matroska file")):
        (tmp_path / "x.mkv").write_bytes(content)
        with pytest.raises(InputError, match=message):
            open_recording(tmp_path / "x.mkv")
    with pytest.raises(InputError, match="not found"):
        open_recording(tmp_path / "y.mkv")
    with pytest.raises(InputError, match=r"depthmocap record openni:.*z\.oni"):
        open_recording(tmp_path / "z.oni")
