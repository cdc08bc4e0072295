"""The Kinect 2 back end against a fake of the interface of the package freenect2."""

import types
from typing import Any

import numpy as np
import pytest

from depthmocap.cameras import kinect2, sdk
from depthmocap.cameras.kinect2 import Kinect2, find_cameras, to_raw
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import CameraError, FrameTimeoutError
from depthmocap.cameras.usb import UsbDevice

DEPTH, COLOR = object(), object()


class Frame:
    status = 0

    def __init__(self, number: int) -> None:
        self.sequence, self.timestamp = number, 267 * number

    def to_array(self) -> np.ndarray:
        depth = np.full((424, 512), 1000.0 + self.sequence, np.float32)
        depth[:, 0] = 500.4
        depth[:, 511] = np.nan
        return depth


class Device:
    """Calls its listener when it is told to."""

    opened: "Device"
    starts = True

    def __init__(self, reference: Any = None) -> None:
        if reference is None:
            raise NoDeviceError
        self.reference, self.state = reference, "open"
        self.listener: Any = None
        self.ir_camera_params: Any = None
        Device.opened = self

    def start(self, frame_listener: Any) -> None:
        self.listener, self.state = frame_listener, "running"
        lens = dict(fx=365.0, fy=366.0, cx=250.0, cy=205.0, k1=0.09, k2=-0.27, k3=0.09, p1=0.001, p2=0.002)
        self.ir_camera_params = types.SimpleNamespace(**lens if self.starts else dict.fromkeys(lens, 0.0))

    def deliver(self, *numbers: int) -> None:
        for number in numbers:
            self.listener(COLOR, None)
            self.listener(DEPTH, Frame(number))

    def stop(self) -> None:
        self.state = "stopped"

    def close(self) -> None:
        self.state = "closed"


class NoDeviceError(RuntimeError):
    pass


@pytest.fixture
def freenect2(monkeypatch: pytest.MonkeyPatch) -> Any:
    names = types.SimpleNamespace
    serials = ["111", "222"]
    lib = names(
        freenect2_create=lambda: "context", freenect2_dispose=None, serials=serials, busy=False,
        freenect2_enumerate_devices=lambda context: len(serials),
    )  # fmt: skip
    lib.freenect2_open_default_device = lambda context: None if lib.busy else "default"
    lib.freenect2_open_device_by_serial = lambda context, serial: None if lib.busy else serial
    fake = names(
        lib=lib, ffi=names(gc=lambda made, dispose: made), Device=Device, NoDeviceError=NoDeviceError,
        FrameType=names(Depth=DEPTH, Color=COLOR),
    )  # fmt: skip
    monkeypatch.setattr(kinect2, "_context", lambda sdk: "context")
    monkeypatch.setitem(__import__("sys").modules, "freenect2", fake)
    monkeypatch.setattr(Device, "starts", True)
    return fake


@pytest.fixture
def on_usb(monkeypatch: pytest.MonkeyPatch, freenect2: Any, tmp_path: Any) -> list[UsbDevice]:
    """Both sensors on USB, the second by USB 2."""
    node = tmp_path / "node"
    node.touch()
    devices = [
        UsbDevice(0x045E, 0x02D8, "Xbox NUI Sensor", serial, speed, node)
        for serial, speed in zip(freenect2.lib.serials, (5000.0, 480.0), strict=True)
    ]
    monkeypatch.setattr(sdk, "usb_devices", lambda: devices)
    return devices


def test_depth_in_whole_millimetres_and_not_mirrored() -> None:
    depth = np.array([[1.4, np.nan, np.inf], [-3.0, 0.0, 70000.0]], np.float32)
    np.testing.assert_array_equal(to_raw(depth), np.array([[0, 0, 1], [0, 0, 0]], np.uint16))


def test_frames(on_usb: list[UsbDevice]) -> None:
    with Kinect2("left", "111") as source:
        device, camera = Device.opened, source.camera
        assert device.reference == b"111"
        assert (camera.width, camera.height, camera.fx, camera.fy, camera.cy) == (512, 424, 365.0, 366.0, 204.5)
        assert camera.cx == 511 - 249.5
        assert camera.distortion == (0.09, -0.27, 0.001, -0.002, 0.09)
        assert camera.depth_unit_m == 0.001
        with pytest.raises(FrameTimeoutError, match="still connected"):
            source.read(0.01)
        device.deliver(1, 2)
        first, second = source.read(1.0), source.read(1.0)
        assert first is not None
        assert second is not None
        assert (first.number, second.number) == (1, 2)
        assert second.timestamp_ns - first.timestamp_ns == 267 * 125_000  # a frame of 30 a second
        assert first.clock == "kinect2 111 device"
        np.testing.assert_array_equal(first.raw[3, [0, 1, 510, 511]], [0, 1001, 1001, 500])
        device.deliver(*range(3, 13))
        frame = source.read(1.0)
        assert frame is not None
        assert frame.number == 9  # nobody read for ten frames: the newest four wait
    assert device.state == "closed"


def test_a_mirrored_lens_sees_the_same(on_usb: list[UsbDevice]) -> None:
    """A point right of the axis is left of it in the mirror, at the same distance."""
    with Kinect2("left", "111") as source:
        camera = source.camera
    k1, k2, p1, p2, k3 = 0.09, -0.27, 0.001, 0.002, 0.09
    x, y = 0.31, 0.22
    for sign in (1, -1):
        mx = -sign * x  # in libfreenect2's picture
        r2 = mx * mx + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = 365.0 * (mx * radial + 2 * p1 * mx * y + p2 * (r2 + 2 * mx * mx)) + 249.5
        v = 366.0 * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * mx * y) + 204.5
        ours = camera.project(np.array([[sign * x * 2, y * 2, 2.0]]))[0]
        assert ours == pytest.approx([511 - u, v, 2.0], abs=1e-9)


def test_its_only_mode_can_be_asked_for(freenect2: Any) -> None:
    (source,) = make_sources(["kinect2:111?size=512x424&fps=30"])
    assert isinstance(source, Kinect2)
    for asked, has in (("fps=15", "fps=15: it has 30"), ("mode=nfov", "mode=nfov: it has no modes with names")):
        with pytest.raises(CameraError, match=f"camera 'kinect2-111' has no {has}$"):
            make_sources([f"kinect2:111?{asked}"])


def test_what_is_wrong_is_told(freenect2: Any, on_usb: list[UsbDevice], monkeypatch: pytest.MonkeyPatch) -> None:
    assert [(camera.spec, camera.problem[:27]) for camera in find_cameras()] == [
        ("kinect2:111", ""), ("kinect2:222", "it is connected by USB 2 (4")
    ]  # fmt: skip
    with pytest.raises(CameraError, match="serial number 333: connected are 111, 222"):
        Kinect2("left", "333").__enter__()
    freenect2.lib.busy = True
    with pytest.raises(CameraError, match="may be in use"):
        Kinect2("left", "111").__enter__()
    with pytest.raises(CameraError, match="USB 2"):
        Kinect2("left", "222").__enter__()
    freenect2.lib.busy = False
    monkeypatch.setattr(Device, "starts", False)
    with pytest.raises(CameraError, match="did not start it"):
        Kinect2("left", "111").__enter__()
    assert Device.opened.state == "closed"


def test_without_serial_numbers(freenect2: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """On systems whose USB cannot be listed, a serial number is tried as it is, and cameras are only counted."""
    monkeypatch.setattr(sdk, "usb_devices", list)
    assert [camera.spec for camera in find_cameras()] == ["kinect2", "kinect2"]
    with Kinect2("left", "333") as source:
        assert Device.opened.reference == b"333"
        assert source.name == "left"
    with Kinect2("left"):
        assert Device.opened.reference == "default"
    freenect2.lib.serials.clear()
    with pytest.raises(CameraError, match="no Kinect 2 is connected"):
        Kinect2("left").__enter__()
