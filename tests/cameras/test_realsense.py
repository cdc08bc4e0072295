"""The RealSense back end, through the SDK's own software device."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthmocap.cameras.modes import ModeRequest
from depthmocap.cameras.realsense import MAKE, RealSenseCamera, find_cameras
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import CameraError, DepthSource, FrameTimeoutError
from depthmocap.errors import InputError
from depthmocap.recordings.open_recording import open_recording

try:
    rs = MAKE.load()
except InputError as error:
    pytest.skip(str(error), allow_module_level=True)

WIDTH, HEIGHT = 64, 48
UNIT_M = 0.00025


class Software:
    """A camera that delivers what the test hands it."""

    def __init__(self, usb: str = "3.2", sizes: tuple[tuple[int, int], ...] = ((32, 24), (WIDTH, HEIGHT))) -> None:
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.serial_number, "0123")
        self.device.register_info(rs.camera_info.usb_type_descriptor, usb)
        self.sensor = self.device.add_sensor("Depth")
        self.profiles: dict[tuple[int, int], Any] = {}
        for number, (width, height) in enumerate(sizes):
            lens = rs.intrinsics()
            lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = width, height, 50.0, 51.0, 31.5, 23.5
            lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.125, 0.0, 0.0, 0.0, 0.25]
            stream = rs.video_stream()
            stream.type, stream.index, stream.uid, stream.fmt = rs.stream.depth, 0, number, rs.format.z16
            stream.width, stream.height, stream.fps, stream.bpp, stream.intrinsics = width, height, 30, 2, lens
            self.profiles[width, height] = self.sensor.add_video_stream(stream)
        self.sensor.add_read_only_option(rs.option.depth_units, UNIT_M)

    def deliver(self, raw: np.ndarray, timestamp_ms: float, number: int, domain: str = "hardware_clock") -> None:
        frame = rs.software_video_frame()
        frame.pixels, frame.stride, frame.bpp = raw, 2 * raw.shape[1], 2
        frame.timestamp, frame.frame_number, frame.depth_units = timestamp_ms, number, UNIT_M
        frame.domain = getattr(rs.timestamp_domain, domain)
        frame.profile = self.profiles[raw.shape[1], raw.shape[0]].as_video_stream_profile()
        self.sensor.on_video_frame(frame)


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 65536, (HEIGHT, WIDTH)).astype(np.uint16)


def test_frames_come_as_the_device_gave_them() -> None:
    software = Software()
    with RealSenseCamera("front", device=software.device) as source:
        camera = source.camera
        assert (camera.name, camera.width, camera.height) == ("front", WIDTH, HEIGHT)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50.0, 51.0, 31.5, 23.5)
        assert camera.distortion == (0.125, 0.0, 0.0, 0.0, 0.25)
        assert camera.depth_unit_m == pytest.approx(UNIT_M, rel=1e-6)
        for i in range(2):
            software.deliver(picture(i), 1000.25 + i, 7 + 2 * i)
            frame = source.read(5.0)
            assert frame is not None
            np.testing.assert_array_equal(frame.raw, picture(i))
            assert frame.raw.dtype == np.uint16
            assert (frame.timestamp_ns, frame.number) == (1_000_250_000 + i * 1_000_000, 7 + 2 * i)
            assert frame.clock == "realsense 0123 hardware_clock"
        with pytest.raises(FrameTimeoutError, match="still connected"):
            source.read(0.02)


def test_a_frame_outlives_the_next() -> None:
    software = Software()
    with RealSenseCamera("front", device=software.device) as source:
        software.deliver(picture(0), 1.0, 1)
        first = source.read(5.0)
        for i in range(1, 40):
            software.deliver(picture(i), 1.0 + i, 1 + i)
            source.read(5.0)
        assert first is not None
        np.testing.assert_array_equal(first.raw, picture(0))


def test_the_hosts_clock_is_shared() -> None:
    software = Software()
    with RealSenseCamera("front", device=software.device) as source:
        software.deliver(picture(0), 1.0, 1, "global_time")
        frame = source.read(5.0)
        assert frame is not None
        assert frame.clock == "host global_time"


def test_read_latest_and_again() -> None:
    software = Software()
    source = RealSenseCamera("front", device=software.device)
    for _ in range(2):  # a camera can be opened again
        with source:
            software.deliver(picture(3), 5.0, 1)
            np.testing.assert_array_equal(source.read_latest(5000.0).raw, picture(3))


def test_modes() -> None:
    with RealSenseCamera("front", request=ModeRequest(size=(32, 24)), device=Software().device) as source:
        assert (source.camera.width, source.camera.height) == (32, 24)
    for request, has in (
        (ModeRequest(size=(640, 480)), "size=640x480: it has 32x24, 64x48"),
        (ModeRequest(fps=60), "fps=60: it has 30"),
    ):
        with pytest.raises(CameraError, match=f"camera 'front' has no {has}$"):
            RealSenseCamera("front", request=request, device=Software().device).__enter__()
    (source,) = make_sources(["realsense:1?size=64x48"])
    assert source.name == "realsense-1"


def test_a_recorded_file_is_a_camera_that_ends(tmp_path: Path) -> None:
    path, software = tmp_path / "Take 1.db3", Software(usb="2.1")
    recorder = rs.recorder(str(path), software.device)
    (sensor,) = recorder.query_sensors()
    profile = next(p for p in sensor.get_stream_profiles() if p.as_video_stream_profile().width() == WIDTH)
    queue = rs.frame_queue(8)
    sensor.open(profile)
    sensor.start(queue)
    for i in range(4):
        software.deliver(picture(i), 1000.0 + 10 * i, i)
        assert queue.try_wait_for_frame(5000)[0]
    sensor.stop()
    sensor.close()
    del sensor, recorder  # which writes the file's end
    with pytest.raises(InputError, match=r"as in depthmocap record realsense:.*Take 1.db3"):
        open_recording(path)
    (source,) = make_sources([f"realsense:{path}"])
    assert source.name == "realsense-Take-1"
    with source:
        assert not source.reopens  # it would be played from its beginning again
        assert (source.camera.fx, source.camera.cy) == (50.0, 23.5)
        assert source.camera.depth_unit_m == pytest.approx(UNIT_M, rel=1e-6)
        for i in range(4):
            frame = source.read(5.0)
            assert frame is not None
            np.testing.assert_array_equal(frame.raw, picture(i))
            assert (frame.timestamp_ns, frame.clock) == (
                1_000_000_000 + i * 10_000_000,
                "realsense 0123 hardware_clock",
            )
        assert _last(source) is None


def _last(source: DepthSource) -> object:
    """What comes after the last frame, once the SDK has noticed."""
    for _ in range(100):
        with contextlib.suppress(FrameTimeoutError):
            return source.read(0.05)
    raise AssertionError


def test_files_that_are_no_recordings_of_its(tmp_path: Path) -> None:
    for content, message in (
        (b"something else", "is no recording of a RealSense camera"),
        (b"topic=/cam/sensor_3/frameType_3", "recorded by an Orbbec camera: name it orbbec:"),
    ):
        (tmp_path / "x.bag").write_bytes(content)
        with pytest.raises(CameraError, match=message):
            RealSenseCamera("front", str(tmp_path / "x.bag")).__enter__()
    with pytest.raises(InputError, match="not found"):
        RealSenseCamera("front", str(tmp_path / "y.bag")).__enter__()


def test_usb_2_is_told() -> None:
    with pytest.raises(CameraError, match=r"USB 2\.1: use a USB 3 port"):
        RealSenseCamera("front", device=Software(usb="2.1").device).__enter__()


def test_no_camera_is_told() -> None:
    if find_cameras():
        pytest.skip("a camera is connected")
    with pytest.raises(CameraError, match="no RealSense camera is connected"):
        RealSenseCamera("front").__enter__()
