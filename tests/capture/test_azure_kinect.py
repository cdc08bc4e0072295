"""The Azure Kinect back end against a fake of pyk4a's interface."""

import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthmocap.capture import azure_kinect
from depthmocap.capture.azure_kinect import AzureKinect, find, five_coefficients
from depthmocap.capture.source import CameraError, NoFrame

#: The rational lens of a depth camera as its factory calibrates it: numerator and denominator nearly cancel.
LENS = np.array([0.52, -0.02, 1e-4, -2e-5, 0.006, 0.86, 0.105, 0.0])


class FakeError(Exception):
    pass


class FakeTimeoutError(FakeError):
    pass


class Fake:
    """A device or a recording that gives depth frames with numbers in them, every second capture without depth."""

    serials = ("one", "two")
    busy = False
    count = 3

    def __init__(self, path: str = "", config: Any = None, device_id: int = 0) -> None:
        self.path, self.serial, self.running = path, self.serials[device_id], False
        self.calls = 0
        self.calibration = self

    def open(self) -> None:
        if self.busy:
            raise FakeError("busy")
        self.running = True

    start = open

    def stop(self) -> None:
        self.running = False

    close = stop

    def get_camera_matrix(self, kind: str) -> np.ndarray:
        assert kind == "depth"
        return np.array([[504.0, 0, 320.5], [0, 505.0, 330.5], [0, 0, 1]])

    def get_distortion_coefficients(self, kind: str) -> np.ndarray:
        return LENS

    def get_capture(self, timeout: int) -> Any:
        assert self.running
        self.calls += 1
        number = self.calls // 2
        if number > self.count:
            raise EOFError if self.path else FakeTimeoutError("timeout")
        depth = np.full((6, 8), number, np.uint16) if self.calls % 2 == 0 else None
        return types.SimpleNamespace(depth=depth, depth_timestamp_usec=33_333 * number)

    def get_next_capture(self) -> Any:
        return self.get_capture(0)


@pytest.fixture
def sdk(monkeypatch: pytest.MonkeyPatch) -> Any:
    names = types.SimpleNamespace
    fake = names(
        PyK4A=Fake, PyK4APlayback=Fake, K4AException=FakeError, K4ATimeoutException=FakeTimeoutError,
        Config=names, ColorResolution=names(OFF=0), DepthMode=names(NFOV_UNBINNED=2), FPS=names(FPS_30=2),
        CalibrationType=names(DEPTH="depth"), connected_device_count=lambda: len(Fake.serials),
    )  # fmt: skip
    monkeypatch.setattr(azure_kinect, "load_sdk", lambda: fake)
    return fake


def test_frames_of_a_device(sdk: Any) -> None:
    with AzureKinect("left", "two") as source:
        camera = source.camera
        assert (camera.width, camera.height, camera.fx, camera.cy, camera.depth_unit_m) == (8, 6, 504.0, 330.5, 0.001)
        frames = [source.read(0.1) for _ in range(3)]
        assert [frame and frame.timestamp_ns for frame in frames] == [33_333_000, 66_666_000, 99_999_000]
        assert [frame and int(frame.raw[0, 0]) for frame in frames] == [1, 2, 3]
        assert frames[0] is not None
        assert frames[0].clock == "azure two device"
        with pytest.raises(NoFrame):
            source.read(0.1)


def test_a_recording_ends(sdk: Any, tmp_path: Path) -> None:
    (tmp_path / "x.mkv").write_bytes(b"")
    with AzureKinect("left", str(tmp_path / "x.mkv")) as source:
        assert len(list(source)) == 3
    with pytest.raises(CameraError, match="not a file"):
        AzureKinect("left", str(tmp_path / "y.mkv")).__enter__()


def test_what_is_wrong_is_told(sdk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert [camera.spec for camera in find()] == ["azure:one", "azure:two"]
    with pytest.raises(CameraError, match="serial number three: connected are one, two"):
        AzureKinect("left", "three").__enter__()
    monkeypatch.setattr(Fake, "busy", True)
    assert all("in use" in camera.problem for camera in find())
    with pytest.raises(CameraError, match="in use, connected by USB 2"):
        AzureKinect("left").__enter__()
    monkeypatch.setattr(Fake, "serials", ())
    with pytest.raises(CameraError, match="no Azure Kinect is connected"):
        AzureKinect("left").__enter__()


def test_five_coefficients_stand_for_eight() -> None:
    """Within half a pixel over the narrow mode's field."""
    k1, k2, p1, p2, k3 = five_coefficients(LENS)
    r = np.linspace(0, 0.95, 100)
    r2 = r * r
    full = (1 + r2 * (0.52 + r2 * (-0.02 + r2 * 0.006))) / (1 + r2 * (0.86 + r2 * 0.105))
    ours = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    assert np.abs(r * (full - ours)).max() * 504 < 0.5
    assert (p1, p2) == (1e-4, -2e-5)
    five = np.array([0.1, -0.05, 0.001, 0.002, 0.01, 0, 0, 0])
    assert five_coefficients(five) == pytest.approx(five[:5].tolist(), abs=1e-9)
