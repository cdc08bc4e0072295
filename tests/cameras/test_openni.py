"""The OpenNI back end: against a fake of the package's interface, and with OpenNI itself where it is installed."""

import contextlib
import ctypes
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oni_file import write_oni

from depthmocap.cameras import openni, sdk
from depthmocap.cameras.openni import OpenNICamera, find_cameras
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import CameraError, FrameTimeoutError
from depthmocap.errors import InputError

WIDTH, HEIGHT = 64, 48
MM, TENTHS, SHIFT = 100, 101, 102


class FakeError(Exception):
    """OpenNIError: code, message, file of the log."""


def mode(width: int, height: int, fps: int, pixels: int = MM) -> Any:
    return types.SimpleNamespace(resolutionX=width, resolutionY=height, fps=fps, pixelFormat=pixels)


class Stream:
    """Frames of rows that are longer than the picture."""

    modes = (mode(1280, 1024, 30), mode(640, 480, 30, SHIFT), mode(640, 480, 30, TENTHS), mode(320, 240, 60))
    mirrored: bool | None = False
    fov: float | None = 1.0
    promised = count = 3

    def __init__(self) -> None:
        self.mode, self.number, self.running = self.modes[0], 0, False
        self.words = (ctypes.c_uint16 * ((1280 + 8) * 1024))()

    def get_sensor_info(self) -> Any:
        return types.SimpleNamespace(videoModes=list(self.modes))

    def get_video_mode(self) -> Any:
        return self.mode

    def set_video_mode(self, mode: Any) -> None:
        self.mode = mode

    def get_number_of_frames(self) -> int:
        return self.promised

    def set_mirroring_enabled(self, on: bool) -> None:
        if self.mirrored is None:
            raise FakeError(3, b"not supported", None)

    def get_mirroring_enabled(self) -> bool:
        if self.mirrored is None:
            raise FakeError(3, b"not supported", None)
        return self.mirrored

    def get_horizontal_fov(self) -> float:
        if self.fov is None:
            raise FakeError(2, b"not implemented", None)
        return self.fov

    def get_vertical_fov(self) -> float:
        return 0.8

    def start(self) -> None:
        self.running = True

    def close(self) -> None:
        self.running = False

    def read_frame(self) -> Any:
        self.number += 1
        width, height = self.mode.resolutionX, self.mode.resolutionY
        rows = np.frombuffer(memoryview(self.words), np.uint16)[: (width + 8) * height].reshape(height, width + 8)
        rows[:] = 7
        rows[:, 0] = self.number
        return types.SimpleNamespace(
            width=width, height=height, stride=2 * (width + 8), timestamp=33_000 * self.number, frameIndex=self.number,
            get_buffer_as_uint16=lambda: (ctypes.c_uint16 * rows.size).from_buffer(self.words),
            close=lambda: rows.fill(9),
        )  # fmt: skip


class Device:
    uris: tuple[bytes, ...] = (b"1d27/0601@1/2", b"1d27/0601@1/3", b"/opened/before.ONI")
    error = ""
    opened: "Device"

    def __init__(self, uri: bytes) -> None:
        if self.error:
            raise FakeError(1, self.error.encode(), None)
        self.uri, self.stream, self.settings = uri, Stream(), {}
        set_ = self.settings.__setitem__
        self.playback = types.SimpleNamespace(
            set_repeat_enabled=lambda on: set_("repeat", on), set_speed=lambda speed: set_("speed", speed)
        )
        Device.opened = self

    @classmethod
    def enumerate_uris(cls) -> list[bytes]:
        return list(cls.uris)

    def create_depth_stream(self) -> Stream:
        return self.stream

    def close(self) -> None:
        self.uri = b""


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> Any:
    """openni.openni2 as a fake."""

    def wait(streams: list[Stream], timeout_s: float) -> Stream | None:
        (stream,) = streams
        assert stream.running
        return stream if stream.number < stream.count else None

    fake = types.SimpleNamespace(
        Device=Device, OpenNIError=FakeError, InitializationError=type("InitializationError", (Exception,), {}),
        PIXEL_FORMAT_DEPTH_1_MM=MM, PIXEL_FORMAT_DEPTH_100_UM=TENTHS, wait_for_any_stream=wait,
        initialize=lambda folders=None: None, unload=lambda: None,
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "openni", types.ModuleType("openni"))
    monkeypatch.setitem(sys.modules, "openni.openni2", fake)
    monkeypatch.setattr(sdk, "usb_devices", list)
    return fake


def test_frames_of_a_device(package: Any) -> None:
    with OpenNICamera("left", "1d27/0601@1/3") as source:
        device, camera = Device.opened, source.camera
        assert (device.uri, device.settings) == (b"1d27/0601@1/3", {})
        assert device.stream.mode is Stream.modes[2]
        assert (camera.width, camera.height, camera.depth_unit_m) == (640, 480, 1e-4)
        assert (camera.cx, camera.cy) == (319.5, 239.5)
        assert camera.fx == pytest.approx(320 / np.tan(0.5))
        assert camera.fy == pytest.approx(240 / np.tan(0.4))
        frames = [source.read(0.1) for _ in range(3)]
        assert [frame and frame.timestamp_ns for frame in frames] == [33_000_000, 66_000_000, 99_000_000]
        assert [frame and frame.number for frame in frames] == [1, 2, 3]
        assert frames[1] is not None
        assert frames[1].clock == "openni 1d27/0601@1/3 device"
        assert frames[1].raw.shape == (480, 640)
        np.testing.assert_array_equal(frames[1].raw[:, [0, 1, 639]], np.broadcast_to([2, 7, 7], (480, 3)))
        with pytest.raises(FrameTimeoutError, match="still connected"):
            source.read(0.01)
    assert device.uri == b""
    assert not device.stream.running


def test_modes(package: Any, tmp_path: Path) -> None:
    (source,) = make_sources(["openni:1d27/0601@1/3?size=320x240&fps=60"])
    with source:
        assert Device.opened.stream.mode is Stream.modes[3]
        assert (source.camera.width, source.camera.height) == (320, 240)
    (source,) = make_sources(["openni:1d27/0601@1/3?fps=15"])
    with pytest.raises(CameraError, match=r"camera 'openni-1d27-0601-1-3' has no fps=15: it has 30, 60$"):
        source.__enter__()
    assert Device.opened.uri == b""  # closed
    (tmp_path / "what?.oni").touch()
    (source,) = make_sources([f"openni:{tmp_path}/what?.oni"])  # a name with a question mark
    with source:
        assert source.camera.width == 1280
    (source,) = make_sources([f"openni:{tmp_path}/what?.oni?size=320x240"])
    with pytest.raises(CameraError, match=r"has no size=320x240: it has 1280x1024$"):
        source.__enter__()
    (source,) = make_sources([r"openni:\\?\usb#vid_2bc5&pid_0401#5"])
    with source:
        assert Device.opened.uri == rb"\\?\usb#vid_2bc5&pid_0401#5"


@pytest.mark.parametrize(("mirrored", "column"), [(True, 639), (False, 0), (None, 0)])
def test_a_mirror_is_turned_back(
    package: Any, monkeypatch: pytest.MonkeyPatch, mirrored: bool | None, column: int
) -> None:
    monkeypatch.setattr(Stream, "mirrored", mirrored)
    with OpenNICamera("left") as source:
        frame = source.read(0.1)
        assert frame is not None
        assert np.flatnonzero(frame.raw[0] == 1).tolist() == [column]


def test_what_is_wrong_is_told(package: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert [camera.spec for camera in find_cameras()] == ["openni:1d27/0601@1/2", "openni:1d27/0601@1/3"]
    for change, told in (
        ({"fov": None}, "does not tell its field of view"),
        ({"fov": 0.0}, "no usable calibration"),
        ({"modes": (mode(640, 480, 30, SHIFT),)}, "no depth in millimetres"),
    ):
        with monkeypatch.context() as patch:
            for name, value in change.items():
                patch.setattr(Stream, name, value)
            with pytest.raises(CameraError, match=told):
                OpenNICamera("left").__enter__()
            assert Device.opened.uri == b""  # closed
    with OpenNICamera("left") as source:
        monkeypatch.setattr(Stream, "read_frame", lambda self: (_ for _ in ()).throw(FakeError(1, b"usb gone", None)))
        with pytest.raises(CameraError, match="failed: usb gone"):
            source.read(0.1)
    monkeypatch.setattr(Device, "error", "device is busy")
    with pytest.raises(CameraError, match="in use"):
        OpenNICamera("left").__enter__()
    with pytest.raises(CameraError, match="connected are 1d27/0601@1/2, 1d27"):
        OpenNICamera("left", "2bc5/0401@1/9").__enter__()
    with pytest.raises(CameraError, match="is not a file"):
        OpenNICamera("left", str(tmp_path / "no.oni")).__enter__()
    (tmp_path / "bad.oni").touch()
    with pytest.raises(CameraError, match=r"bad\.oni is no ONI file that OpenNI can read"):
        OpenNICamera("left", str(tmp_path / "bad.oni")).__enter__()
    monkeypatch.setattr(Device, "uris", ())
    with pytest.raises(CameraError, match="no OpenNI camera is connected"):
        OpenNICamera("left").__enter__()

    def fail(folders: Any = None) -> None:
        raise package.InitializationError("OpenNI2 could not be loaded:\n    /lib: file does not exist")

    monkeypatch.setattr(package, "initialize", fail)
    with pytest.raises(InputError, match=r"apt install libopenni2-dev.*could not be loaded: /lib: file does not exist"):
        find_cameras()


def test_a_file_is_played_frame_by_frame(package: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "take.oni").touch()
    with OpenNICamera("left", str(tmp_path / "take.oni")) as source:
        assert Device.opened.settings == {"repeat": False, "speed": -1.0}
        assert not source.reopens  # it would be played from its beginning again
        assert len(list(source)) == 3
    monkeypatch.setattr(Stream, "promised", 5)
    with OpenNICamera("left", str(tmp_path / "take.oni")) as source:
        for _ in range(3):
            source.read()
        with pytest.raises(CameraError, match=r"take\.oni is cut off: its last 2 frames are missing"):
            source.read()


@pytest.fixture
def real() -> Any:
    """OpenNI itself."""
    with contextlib.suppress(InputError):
        return openni.load()
    return pytest.skip("OpenNI 2 is not installed")


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 10_000, (HEIGHT, WIDTH)).astype(np.uint16)


@pytest.mark.parametrize("mirror", [0, 1])
def test_a_file_by_openni_itself(real: Any, tmp_path: Path, mirror: int) -> None:
    write_oni(tmp_path / "take.oni", [(33_000 * (1 + i), picture(i)) for i in range(40)], mirror=mirror)
    with OpenNICamera("left", str(tmp_path / "take.oni")) as source:
        assert source.camera.fx == pytest.approx(WIDTH / 2 / np.tan(0.5))
        frames = list(source)
    assert [frame.timestamp_ns for frame in frames] == [33_000_000 * (1 + i) for i in range(40)]
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.raw, picture(i)[:, ::-1] if mirror else picture(i))
    (tmp_path / "bad.oni").write_bytes((tmp_path / "take.oni").read_bytes()[:50_000])
    with pytest.raises(CameraError, match="no ONI file that OpenNI can read"):
        OpenNICamera("left", str(tmp_path / "bad.oni")).__enter__()
