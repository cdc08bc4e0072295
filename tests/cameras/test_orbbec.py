"""The Orbbec back end against a fake of the SDK's interface, whose names are those of its package."""

import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthmocap.cameras import orbbec
from depthmocap.cameras.orbbec import OrbbecCamera, find_cameras
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import CameraError, FrameTimeoutError
from depthmocap.errors import InputError
from depthmocap.recordings.open_recording import open_recording

WIDTH, HEIGHT = 640, 576


class FakeError(Exception):
    """OBError."""


class Profile:
    """A mode; also what ``as_video_stream_profile`` gives."""

    model = "BROWN_CONRADY_K6"
    fx = 504.0

    def __init__(self, width: int, height: int, rate: int, form: str = "Y16") -> None:
        self.mode = width, height, rate
        self.form = form

    def as_video_stream_profile(self) -> "Profile":
        return self

    def get_format(self) -> str:
        return self.form

    def get_width(self) -> int:
        return self.mode[0]

    def get_height(self) -> int:
        return self.mode[1]

    def get_fps(self) -> int:
        return self.mode[2]

    def get_intrinsic(self) -> Any:
        return types.SimpleNamespace(fx=self.fx, fy=505.0, cx=320.5, cy=288.5, width=self.mode[0], height=self.mode[1])

    def get_distortion(self) -> Any:
        lens = dict(k1=0.52, k2=-0.02, k3=0.006, k4=0.86, k5=0.105, k6=0.0, p1=1e-4, p2=-2e-5)
        return types.SimpleNamespace(model=types.SimpleNamespace(name=self.model), **lens)


class Frame:
    buffer = np.zeros((HEIGHT, WIDTH), np.uint16)

    def __init__(self, number: int) -> None:
        self.number = number

    def get_data(self) -> np.ndarray:
        self.buffer[:] = self.number  # the same memory every time, as the SDK has it
        self.buffer[0, 1] = 0x1234
        return self.buffer.view(np.uint8).ravel()

    def get_width(self) -> int:
        return WIDTH

    def get_height(self) -> int:
        return HEIGHT

    def get_depth_scale(self) -> float:
        return 0.25

    def get_timestamp_us(self) -> int:
        return 33_333 * self.number

    def get_index(self) -> int:
        return self.number


class Fake:
    """Context, list of devices, device, pipeline, configuration and list of profiles in one; gives ``count`` frames."""

    serials: tuple[str, ...] = ("one", "two")
    profiles = (
        Profile(1024, 1024, 15), Profile(WIDTH, HEIGHT, 30, "RLE"), Profile(WIDTH, HEIGHT, 5),
        Profile(WIDTH, HEIGHT, 30), Profile(320, 288, 30),
    )  # fmt: skip
    start_error = lost = ""
    count = 3
    enabled: Any = None

    def __init__(self, device: Any = None) -> None:
        self.device, self.number, self.running = device, 0, False

    @staticmethod
    def set_logger_to_file(level: str, path: str) -> None:
        assert (level, path) == ("none", "")

    def query_devices(self) -> "Fake":
        return self

    def get_count(self) -> int:
        return len(self.serials)

    def get_device_serial_number_by_index(self, index: int) -> str:
        return self.serials[index]

    def get_device_name_by_index(self, index: int) -> str:
        return "Femto Bolt"

    def get_device_by_index(self, index: int) -> str:
        return self.serials[index]

    def get_stream_profile_list(self, sensor: str) -> Any:
        assert sensor == "depth"
        own = self.profiles
        return types.SimpleNamespace(get_count=lambda: len(own), get_stream_profile_by_index=lambda i: own[i])

    def enable_stream(self, profile: Profile) -> None:
        self.enabled = profile

    def start(self, config: "Fake") -> None:
        if self.start_error:
            raise FakeError(self.start_error)
        Fake.enabled = config.enabled
        self.running = True
        Fake.last = self

    def stop(self) -> None:
        self.running = False

    def wait_for_frames(self, timeout_ms: int) -> Any:
        assert self.running
        if self.lost:
            raise FakeError(self.lost)
        self.number += 1
        number = self.number // 2  # every second set has no depth
        if number > self.count:
            return None
        depth = Frame(number) if self.number % 2 == 0 else None
        return types.SimpleNamespace(get_depth_frame=lambda: depth)

    last: "Fake"


class Bag:
    """What a bag file holds."""

    def __init__(self, path: str) -> None:
        if Path(path).read_bytes() != b"#ROSBAG V2.0":
            raise RuntimeError("Error reading version line")

    def get_device_info(self) -> Any:
        return types.SimpleNamespace(get_serial_number=lambda: "seven")

    def get_playback_status(self) -> int:
        return 3 if Fake.last.number >= 2 * Fake.count else 1


@pytest.fixture
def sdk(monkeypatch: pytest.MonkeyPatch) -> Any:
    names = types.SimpleNamespace
    fake = names(
        Context=Fake, Pipeline=Fake, Config=Fake, OBError=FakeError, OBSensorType=names(DEPTH_SENSOR="depth"),
        OBFormat=names(Y16="Y16", Z16="Z16"), PlaybackDevice=Bag, OBPlaybackStatus=names(PLAYING=1, STOPPED=3),
        OBLogLevel=names(NONE="none"),
    )  # fmt: skip
    monkeypatch.setitem(__import__("sys").modules, "pyorbbecsdk", fake)
    return fake


def test_frames_as_the_device_gave_them(sdk: Any) -> None:
    with OrbbecCamera("left", "two") as source:
        camera = source.camera
        assert Fake.last.device == "two"
        assert Fake.enabled is Fake.profiles[3]
        assert (source.up, camera.world_from_camera.tolist()) == ("-y", np.eye(4).tolist())  # upright, y is down
        assert (camera.width, camera.height, camera.fx, camera.cy) == (WIDTH, HEIGHT, 504.0, 288.5)
        assert camera.depth_unit_m == pytest.approx(0.00025)
        assert camera.distortion[2:4] == (1e-4, -2e-5)
        frames = [source.read(0.5) for _ in range(3)]
        assert [frame and frame.timestamp_ns for frame in frames] == [33_333_000, 66_666_000, 99_999_000]
        assert [frame and frame.number for frame in frames] == [1, 2, 3]
        assert [frame and int(frame.raw[5, 5]) for frame in frames] == [1, 2, 3]  # copies: the SDK reuses its memory
        assert frames[0] is not None
        assert (frames[0].raw.shape, int(frames[0].raw[0, 1])) == ((HEIGHT, WIDTH), 0x1234)
        assert frames[0].clock == "orbbec two device"
        with pytest.raises(FrameTimeoutError, match="still connected"):
            source.read(0.05)
    assert not Fake.last.running


def test_modes(sdk: Any) -> None:
    for asked, index in (("fps=5", 2), ("size=320x288", 4), ("size=1024x1024&fps=15", 0)):
        (source,) = make_sources([f"orbbec:two?{asked}"])
        with source:
            assert Fake.enabled is Fake.profiles[index]
    for asked, has in (
        ("fps=60", "fps=60: it has 5, 15, 30"),
        ("size=640x480", "size=640x480: it has 320x288, 640x576, 1024x1024"),
        ("size=320x288&fps=5", "fps=5 with size=320x288: it has 30"),
    ):
        (source,) = make_sources([f"orbbec:two?{asked}"])
        with pytest.raises(CameraError, match=f"camera 'orbbec-two' has no {has}$"):
            source.__enter__()
        assert not Fake.last.running


def test_lenses_of_other_models(sdk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Profile, "model", "KANNALA_BRANDT4")
    with pytest.raises(CameraError, match="lens model KANNALA_BRANDT4"):
        OrbbecCamera("left").__enter__()
    assert not Fake.last.running  # it was started, and must not stay so
    zeros = dict.fromkeys(("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"), 0.0)
    none = types.SimpleNamespace(model=types.SimpleNamespace(name="KANNALA_BRANDT4"), **zeros)
    monkeypatch.setattr(Profile, "get_distortion", lambda self: none)
    with OrbbecCamera("left") as source:
        assert not any(source.camera.distortion)
    old = types.SimpleNamespace(**zeros | {"k1": 0.25})  # as of version 2.0 of the package
    monkeypatch.setattr(Profile, "get_distortion", lambda self: old)
    with OrbbecCamera("left") as source:
        assert source.camera.distortion == (0.25, 0, 0, 0, 0)


def test_what_is_wrong_is_told(sdk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert [(camera.spec, camera.model) for camera in find_cameras()] == [
        ("orbbec:one", "Femto Bolt"), ("orbbec:two", "Femto Bolt")
    ]  # fmt: skip
    with pytest.raises(CameraError, match="serial number three: connected are one, two"):
        OrbbecCamera("left", "three").__enter__()
    with OrbbecCamera("left") as source:
        source.read(0.5)
        monkeypatch.setattr(Fake, "lost", "usb gone")
        with pytest.raises(CameraError, match="failed: usb gone"):
            source.read(0.5)
    monkeypatch.setattr(Fake, "lost", "")
    for said, told in (
        ("device is busy", "in use: close the other program"),
        ("permission denied", "may not use camera .*: (install the udev rules|let programs use)"),
        ("no idea", r"cannot be started.*\(no idea\)"),
    ):
        monkeypatch.setattr(Fake, "start_error", said)
        with pytest.raises(CameraError, match=told):
            OrbbecCamera("left").__enter__()
    monkeypatch.setattr(Fake, "start_error", "")
    monkeypatch.setattr(Profile, "fx", float("nan"))
    with pytest.raises(CameraError, match="no usable calibration"):
        OrbbecCamera("left").__enter__()
    monkeypatch.setattr(Fake, "profiles", (Profile(WIDTH, HEIGHT, 30, "RLE"),))
    with pytest.raises(CameraError, match="no 16-bit depth"):
        OrbbecCamera("left").__enter__()
    monkeypatch.setattr(Fake, "count", 0)
    monkeypatch.setattr(orbbec, "_FIRST_FRAME_S", 0.02)
    with pytest.raises(CameraError):
        OrbbecCamera("left").__enter__()
    monkeypatch.setattr(Fake, "serials", ("one", "one"))
    with pytest.raises(CameraError, match="2 cameras are orbbec:one"):
        OrbbecCamera("left", "one").__enter__()
    monkeypatch.setattr(Fake, "serials", ())
    with pytest.raises(CameraError, match="no Orbbec camera is connected"):
        OrbbecCamera("left").__enter__()


def test_a_bag_file_is_a_camera_that_ends(sdk: Any, tmp_path: Path) -> None:
    path = tmp_path / "Take 1.BAG"
    path.write_bytes(b"#ROSBAG V2.0")
    (source,) = make_sources([f"orbbec:{path}"])
    assert source.name == "orbbec-Take-1"
    with source:
        assert isinstance(Fake.last.device, Bag)
        assert not source.reopens  # it would be played from its beginning again
        assert source.camera.fx == 504.0
        frames = [source.read(0.05) for _ in range(Fake.count + 1)]
    assert [frame and (frame.number, frame.clock) for frame in frames] == [
        (1, "orbbec seven device"), (2, "orbbec seven device"), (3, "orbbec seven device"), None
    ]  # fmt: skip
    path.write_bytes(b"something else")
    with pytest.raises(CameraError, match=r"Take 1.BAG is no bag file of an Orbbec camera \(Error reading"):
        source.__enter__()
    path.unlink()
    with pytest.raises(CameraError, match=r"Take 1.BAG does not exist"):
        source.__enter__()
    path.write_bytes(b"#ROSBAG V2.0" + bytes(5000) + b"topic=/cam/sensor_3/frameType_3")
    with pytest.raises(InputError, match=r"as in depthmocap record orbbec:.*Take 1.BAG"):
        open_recording(path)
    path.write_bytes(b"#ROSBAG V2.0" + bytes(5000) + b"topic=/device_0/sensor_0/Depth_0/image/data")
    with pytest.raises(InputError, match=r"as in depthmocap record realsense:.*Take 1.BAG"):
        open_recording(path)
    with pytest.raises(CameraError, match=r"recorded by a RealSense camera: name it realsense:.*Take 1.BAG"):
        source.__enter__()
    path.write_bytes(b"#ROSBAG V2.0" + bytes(5000) + b"topic=/robot/camera")
    with pytest.raises(InputError, match=r"neither the RealSense SDK nor Orbbec's recorded"):
        open_recording(path)
