"""The Azure Kinect back end against a fake of libk4a, and with the library itself where it is installed."""

import ctypes
from typing import Any

import numpy as np
import pytest

from depthmocap.cameras import azure_kinect, k4a, sdk
from depthmocap.cameras.azure_kinect import AzureKinect, find_cameras
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import CameraError, FrameTimeoutError
from depthmocap.errors import InputError

WIDTH, HEIGHT = 640, 576


class FakeK4a:
    """libk4a, as ctypes calls it: devices that give depth with numbers in it; every second capture has none."""

    def __init__(self) -> None:
        self.serials = [b"one", b"two"]
        self.busy: set[int] = set()
        self.count, self.lost, self.starts, self.focal = 3, False, True, 504.0
        self.started: tuple[int, int] | None = None
        self.running: list[int] = []
        self.open: list[int] = []
        self.number = 0
        self.held: list[int] = []
        self.stride = 2 * WIDTH + 16
        self.words = (ctypes.c_uint16 * (self.stride // 2 * HEIGHT))()

    def k4a_device_get_installed_count(self) -> int:
        return len(self.serials)

    def k4a_device_open(self, index: int, handle: Any) -> int:
        if index in self.busy or index in self.open:
            return 1
        self.open.append(index)
        handle._obj.value = index + 1
        return 0

    def k4a_device_close(self, handle: Any) -> None:
        self.open.remove(handle.value - 1)

    def k4a_device_get_serialnum(self, handle: Any, text: Any, size: Any) -> int:
        assert size._obj.value == len(text)
        text.value = self.serials[handle.value - 1]
        return 0

    def k4a_device_start_cameras(self, handle: Any, configuration: Any) -> int:
        asked = configuration._obj
        assert asked.color_resolution == 0
        self.started = asked.depth_mode, asked.camera_fps
        if not self.starts:
            return 1
        self.running.append(handle.value)
        return 0

    def k4a_device_stop_cameras(self, handle: Any) -> None:
        self.running.remove(handle.value)

    def k4a_device_get_calibration(self, handle: Any, mode: int, color: int, found: Any) -> int:
        assert self.started
        assert (mode, color) == (self.started[0], 0)
        lens = found._obj.depth
        lens.width, lens.height = WIDTH, HEIGHT
        values = (320.5, 330.5, self.focal, 505.0, 0.52, -0.02, 0.006, 0.86, 0.105, 0.0, 0.0, 0.0, -2e-5, 1e-4)
        for i, value in enumerate(values):
            lens.values[i] = value
        return 0

    def k4a_device_get_capture(self, handle: Any, capture: Any, timeout_ms: int) -> int:
        assert handle.value in self.running
        assert timeout_ms > 0
        self.number += 1
        if self.lost:
            return 1
        if self.number // 2 > self.count:
            return 2
        capture._obj.value = 1000 + self.number
        self.held.append(1000 + self.number)
        return 0

    def k4a_capture_get_depth_image(self, capture: Any) -> int | None:
        if self.number % 2:
            return None
        rows = np.frombuffer(memoryview(self.words), np.uint16).reshape(HEIGHT, -1)
        rows[:], rows[:, WIDTH:] = self.number // 2, 9
        self.held.append(2000)
        return 2000

    def k4a_capture_release(self, capture: Any) -> None:
        self.held.remove(capture.value)

    def k4a_image_release(self, image: int) -> None:
        self.held.remove(image)
        np.frombuffer(memoryview(self.words), np.uint16)[:] = 7  # the memory is used for something else

    def k4a_image_get_buffer(self, image: int) -> int:
        return ctypes.addressof(self.words)

    def k4a_image_get_width_pixels(self, image: int) -> int:
        return WIDTH

    def k4a_image_get_height_pixels(self, image: int) -> int:
        return HEIGHT

    def k4a_image_get_stride_bytes(self, image: int) -> int:
        return self.stride

    def k4a_image_get_device_timestamp_usec(self, image: int) -> int:
        return 33_333 * (self.number // 2)


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> FakeK4a:
    fake = FakeK4a()
    monkeypatch.setattr(k4a, "load", lambda: fake)
    monkeypatch.setattr(sdk, "usb_devices", list)
    return fake


def test_frames_of_a_device(library: FakeK4a) -> None:
    with AzureKinect("left", "two") as source:
        camera = source.camera
        assert library.running == [2]
        assert library.started == (2, 2)  # K4A_DEPTH_MODE_NFOV_UNBINNED, K4A_FRAMES_PER_SECOND_30
        assert (camera.width, camera.height, camera.depth_unit_m) == (WIDTH, HEIGHT, 0.001)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (504.0, 505.0, 320.5, 330.5)
        assert camera.distortion[2:4] == pytest.approx((1e-4, -2e-5))
        frames = [source.read(0.5) for _ in range(3)]
        assert [frame and frame.timestamp_ns for frame in frames] == [33_333_000, 66_666_000, 99_999_000]
        for i, frame in enumerate(frames):
            assert frame is not None
            assert frame.raw.shape == (HEIGHT, WIDTH)
            assert (frame.raw == i + 1).all()
            assert frame.clock == "azure two device"
        with pytest.raises(FrameTimeoutError, match="still connected"):
            source.read(0.01)
        assert library.held == []  # everything was given back
    assert (library.running, library.open) == ([], [])


@pytest.mark.parametrize(
    ("asked", "started"),
    [
        ("", (2, 2)), ("mode=nfov&fps=15", (2, 1)), ("fps=5", (2, 0)), ("mode=nfov-binned", (1, 2)),
        ("size=512x512", (3, 2)), ("fps=15&mode=wfov", (4, 1)), ("mode=wfov", (4, 1)),
    ],
)  # fmt: skip
def test_modes(library: FakeK4a, asked: str, started: tuple[int, int]) -> None:
    (source,) = make_sources([f"left=azure:two{asked and '?'}{asked}"])
    with source:
        assert source.name == "left"
        assert library.running == [2]
        assert library.started == started


def test_modes_that_it_has_not(library: FakeK4a) -> None:
    for asked, has in (
        ("mode=passive", "no mode=passive: it has nfov, nfov-binned, wfov, wfov-binned"),
        ("size=640x480", "no size=640x480: it has 320x288, 512x512, 640x576, 1024x1024"),
        ("mode=nfov&size=320x288", "no size=320x288 with mode=nfov: it has 640x576"),
        ("mode=wfov&fps=30", "no fps=30 with mode=wfov: it has 5, 15"),
    ):
        with pytest.raises(CameraError, match=f"camera 'azure-two' has {has}$"):
            make_sources([f"azure:two?{asked}"])


def test_what_is_wrong_is_told(library: FakeK4a) -> None:
    assert [camera.spec for camera in find_cameras()] == ["azure:one", "azure:two"]
    with pytest.raises(CameraError, match="serial number three: connected are one, two"):
        AzureKinect("left", "three").__enter__()
    with AzureKinect("left", "one") as source:
        assert [camera.problem for camera in find_cameras()] == ["in use, or this user may not open it", ""]
        library.lost = True
        with pytest.raises(CameraError, match="'left' failed: k4a_device_get_capture failed"):
            source.read(0.5)
    library.busy = {0, 1}
    with pytest.raises(CameraError, match=r"cannot be started: it may be in use.*k4a_device_open failed"):
        AzureKinect("left").__enter__()
    library.busy = set()
    library.starts = False
    with pytest.raises(CameraError, match="k4a_device_start_cameras failed"):
        AzureKinect("left").__enter__()
    library.starts, library.focal = True, 0.0
    with pytest.raises(CameraError, match="no usable calibration"):
        AzureKinect("left").__enter__()
    assert (library.running, library.open) == ([], [])
    library.serials = []
    with pytest.raises(CameraError, match="no Azure Kinect is connected"):
        AzureKinect("left").__enter__()
    with pytest.raises(InputError, match=r"take\.mkv is a recording and no camera: give its path alone"):
        make_sources(["azure:take.mkv"])


def test_the_library_itself() -> None:
    """Its structures are laid out as ours, and it is asked as it wants to be."""
    try:
        library = k4a.load()
    except InputError as error:
        pytest.skip(str(error))
    assert azure_kinect._serials(library) == [""] * library.k4a_device_get_installed_count()
    with pytest.raises(k4a.K4aError, match="k4a_device_open failed"):
        k4a.Device(library, 99)
