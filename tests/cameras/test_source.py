"""The contract that every camera keeps, on sources without hardware."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from virtual_time import VirtualTime

from depthmocap.cameras import registry as cameras
from depthmocap.cameras.modes import Mode, ModeRequest
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import CamerasSettings, find_cameras, list_cameras, make_sources, open_camera
from depthmocap.cameras.source import (
    CLOSE_S,
    OPEN_S,
    CameraError,
    ConnectedCamera,
    DepthFrame,
    DepthSource,
    FrameTimeoutError,
    missing_source_problems,
    place_in_rig,
)
from depthmocap.core.console import Terminal
from depthmocap.errors import InputError, missing_extra
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.recordings.recorded_camera import RecordedCamera
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter

CAMERA = DepthCamera("cam0", 8, 6, 7.0, 7.0, 4.0, 3.0, depth_unit_m=0.0005)


class Scripted(DepthSource):
    """Gives a frame whenever it is told to; fails, or hangs, when told to."""

    def __init__(self, virtual: VirtualTime) -> None:
        super().__init__("cam0")
        self.time = virtual
        self.frames: list[int] = []
        self.failure: Exception | None = None
        self.closed = 0

    def _open(self) -> DepthCamera:
        return CAMERA

    def _read(self, timeout_s: float) -> DepthFrame | None:
        if self.failure is not None:
            raise self.failure
        if not self.frames:
            self.time.sleep(0.01)
            raise FrameTimeoutError("none yet")
        stamp = self.frames.pop(0)
        return DepthFrame("cam0", np.full((6, 8), stamp, np.uint16), stamp, "device 1", self.time.monotonic_ns())

    def _close(self) -> None:
        self.closed += 1


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    cameras = (CAMERA, DepthCamera("cam1", 8, 6, 7.0, 7.0, 4.0, 3.0))
    with RecordingWriter(tmp_path / "rec", Rig(cameras, up="y")) as writer:
        for i in range(4):
            for k in range(2):
                writer.write(10**9 + i * 20_000_000 + k, {f"cam{k}": np.full((6, 8), 100 * i + k + 1, np.uint16)})
    return Recording(tmp_path / "rec")


def test_every_frame_in_order(recording: Recording) -> None:
    with RecordedCamera(recording, "cam1") as source:
        assert source.camera.world_from_camera.shape == (4, 4)
        frames = list(source)
        assert source.read() is None
    assert [frame.timestamp_ns for frame in frames] == recording.stamps("cam1")
    assert [int(frame.raw[0, 0]) for frame in frames] == [2, 102, 202, 302]
    assert [frame.number for frame in frames] == [0, 1, 2, 3]
    assert {(frame.camera, frame.clock) for frame in frames} == {("cam1", "recording")}


def test_a_closed_camera_says_so(virtual: VirtualTime) -> None:
    source = Scripted(virtual)
    for use in (source.read, source.read_latest, lambda: source.camera):
        with pytest.raises(CameraError, match="not open"):
            use()
    with source:
        assert source.camera is CAMERA
        with pytest.raises(CameraError, match="open already"):
            source.__enter__()
    assert source.closed == 1
    with source:  # a source can be used again
        pass
    assert source.closed == 2


def test_read_latest_skips_what_was_missed(virtual: VirtualTime) -> None:
    source = Scripted(virtual)
    with source:
        source.frames = [1, 2, 3]
        source.read_latest(1000.0)
        virtual.sleep(0.005)
        assert source.read_latest(1000.0).timestamp_ns == 3
        with pytest.raises(CameraError, match="read_latest"):
            source.read()


def test_read_latest_refuses_what_is_old(virtual: VirtualTime) -> None:
    source = Scripted(virtual)
    with source:
        with pytest.raises(FrameTimeoutError, match="no frame yet"):
            source.read_latest(1.0)
        source.frames = [1]
        assert source.read_latest(5000.0).timestamp_ns == 1
        virtual.sleep(0.03)
        with pytest.raises(FrameTimeoutError, match="the last frame is 40 ms old"):
            source.read_latest(10.0)


@pytest.mark.parametrize("failure", [CameraError("unplugged"), RuntimeError("unplugged")])
def test_a_camera_that_dies_is_told_where_frames_are_asked_for(virtual: VirtualTime, failure: Exception) -> None:
    source = Scripted(virtual)
    with source:
        source.failure = failure
        with pytest.raises(CameraError, match="unplugged"):
            source.read_latest(5000.0)


def test_a_camera_that_stays_silent_is_lost(virtual: VirtualTime) -> None:
    source = Scripted(virtual)
    with source:
        begun_s = virtual.monotonic()
        with pytest.raises(FrameTimeoutError):
            source.read()
        with pytest.raises(CameraError, match="was it unplugged") as caught:
            for _ in range(1000):
                with contextlib.suppress(FrameTimeoutError):
                    source.read()
        assert not isinstance(caught.value, FrameTimeoutError)
        assert virtual.monotonic() - begun_s == pytest.approx(source.lost_after_s, abs=0.02)
        source.frames = [1]
        assert source.read() is not None  # patience begins anew
        with pytest.raises(FrameTimeoutError):
            source.read()


class Hanging(Scripted):
    """Hangs when it is opened or closed."""

    def __init__(self, virtual: VirtualTime) -> None:
        super().__init__(virtual)
        self.go_on = {"open": virtual.Event(), "close": virtual.Event()}

    def _open(self) -> DepthCamera:
        self.go_on["open"].wait()
        return super()._open()

    def _close(self) -> None:
        self.go_on["close"].wait()
        super()._close()


def test_a_call_that_hangs_is_left_behind_and_undone(virtual: VirtualTime) -> None:
    source, begun_s = Hanging(virtual), virtual.monotonic()
    with pytest.raises(CameraError, match="hangs in a call"):
        source.__enter__()
    assert virtual.monotonic() - begun_s == pytest.approx(OPEN_S)
    with pytest.raises(CameraError, match="stuck in a call"):  # a second call on top would make it worse
        source.__enter__()
    source.go_on["open"].set()
    source.go_on["close"].set()
    virtual.sleep(0.001)
    assert source.closed == 1  # what was opened too late does not stay open
    source.go_on["close"].clear()
    begun_s = virtual.monotonic()
    with source:  # the thread has gone: it opens
        pass
    assert virtual.monotonic() - begun_s == pytest.approx(CLOSE_S)  # leaving does not hang
    with pytest.raises(CameraError, match="stuck in a call"):
        source.__enter__()
    source.go_on["close"].set()


def test_what_opening_raises_comes_through(virtual: VirtualTime) -> None:
    class Broken(Scripted):
        def _open(self) -> DepthCamera:
            raise CameraError("no permission")

    with pytest.raises(CameraError, match="no permission"):
        Broken(virtual).__enter__()


def test_the_end_of_a_recording_ends_read_latest(recording: Recording, virtual: VirtualTime) -> None:
    with RecordedCamera(recording, "cam0") as source, pytest.raises(CameraError, match="at its end"):
        while True:
            source.read_latest(1.0)
            virtual.sleep(0.002)  # what was read is old by then


def test_real_time_keeps_time(recording: Recording, virtual: VirtualTime) -> None:
    begun_ns = virtual.monotonic_ns()
    with RecordedCamera(recording, "cam0", PlaybackClock(1.0)) as source:
        arrivals = [frame.arrival_ns for frame in source]
    np.testing.assert_allclose(np.array(arrivals) - begun_ns, np.arange(4) * 20_000_000, atol=10)
    with RecordedCamera(recording, "cam0", PlaybackClock(0.001)) as source:
        assert source.read(0.1) is not None
        with pytest.raises(FrameTimeoutError):
            source.read(0.01)


@pytest.mark.parametrize("speed", [-1.0, float("nan"), float("inf")])
def test_bad_speeds(speed: float) -> None:
    with pytest.raises(InputError, match="speed"):
        PlaybackClock(speed)


def test_a_frame_that_cannot_be_read_is_a_lost_one(recording: Recording) -> None:
    (recording.path / "cam0" / f"{recording.stamps('cam0')[1]}.png").write_bytes(b"nonsense")
    with RecordedCamera(recording, "cam0") as source:
        assert [frame.number for frame in source] == [0, 2, 3]
        assert [str(recording.stamps("cam0")[1]) in line for line in source.problems] == [True]


def test_the_rig_places_a_camera_and_the_device_scales_it() -> None:
    pose = np.eye(4)
    pose[0, 3] = 2.0
    rig = Rig((DepthCamera("cam0", 8, 6, 9.0, 9.0, 4.0, 3.0, pose),))
    placed = place_in_rig(CAMERA, rig)
    assert (placed.fx, placed.depth_unit_m, placed.world_from_camera[0, 3]) == (9.0, 0.0005, 2.0)
    with pytest.raises(CameraError, match="calibrated at 8×6"):
        place_in_rig(DepthCamera("cam0", 16, 12, 9.0, 9.0, 4.0, 3.0), rig)
    with pytest.raises(CameraError, match="no camera 'other'"):
        place_in_rig(DepthCamera("other", 8, 6, 9.0, 9.0, 4.0, 3.0), rig)
    assert missing_source_problems(rig, ["cam0"]) == []
    assert missing_source_problems(rig, ["other"]) == [
        "the rig has a camera 'cam0', but no source of that name was given; going on without it"
    ]
    assert missing_source_problems(Rig((rig["cam0"], DepthCamera("b", 8, 6, 9.0, 9.0, 4.0, 3.0))), []) == [
        "the rig has cameras 'cam0' and 'b', but no sources of those names were given; going on without them"
    ]


def test_a_spec_that_is_nothing_is_told_so_wherever_the_command_runs(recording: Recording, monkeypatch) -> None:
    monkeypatch.chdir(recording.path)
    with pytest.raises(InputError, match="nosuch is neither a recording nor a camera"):
        make_sources(["nosuch"])


def test_specs(recording: Recording, tmp_path: Path) -> None:
    path = str(recording.path)
    assert [source.name for source in make_sources([path])] == ["cam0", "cam1"]
    with open_camera(f"{path}#cam1") as source:
        assert source.camera.name == "cam1"
    with pytest.raises(InputError, match="choose one as"):
        open_camera(path)
    with pytest.raises(InputError, match="no camera 'cam7'"):
        make_sources([f"{path}#cam7"])
    with pytest.raises(InputError, match="two cameras are called 'cam0'"):
        make_sources([path, f"{path}#cam0"])
    with pytest.raises(InputError, match="neither a recording nor a camera"):
        make_sources([str(tmp_path / "nothing")])
    for pair in (("realsense:123", "realsense:123"), ("realsense", "realsense:123"), ("realsense:1", "realsense")):
        with pytest.raises(InputError, match=rf"a={pair[0]} and b={pair[1]} may be one device"):
            make_sources([f"a={pair[0]}", f"b={pair[1]}"])
    makes = ["realsense:1", "realsense:2", "azure", "left=kinect2", "openni:1d27/0601@1/2", f"openni:{tmp_path}/b.oni"]
    names = [source.name for source in make_sources(makes)]
    assert names == ["realsense-1", "realsense-2", "azure", "left", "openni-1d27-0601-1-2", "openni-b"]


@pytest.mark.parametrize(
    "asked",
    [
        "",
        "fps",
        "fps=",
        "fps=0",
        "fps=fast",
        "fps=1.5",
        "size=640",
        "size=0x480",
        "rate=30",
        "fps=15&fps=30",
        "fps=15&",
        "mode=",
    ],
)
def test_what_is_no_mode_is_told(asked: str) -> None:
    for spec in (f"left=azure:1?{asked}", f"realsense?{asked}", f"synthetic#cam0?{asked}"):
        with pytest.raises(InputError, match="stand mode=NAME, size=WIDTHxHEIGHT or fps=NUMBER") as caught:
            make_sources([spec])
        assert str(caught.value).startswith(f"{spec}: ")


def test_a_zero_byte_is_in_no_spec() -> None:
    for spec in ("openni:a\0.oni", "rec\0ording"):
        with pytest.raises(InputError, match="has a zero byte in it"):
            make_sources([spec])


def test_the_usual_mode() -> None:
    sizes = ((1280, 720, 30), (640, 480, 15), (640, 480, 30), (640, 480, 90), (320, 240, 30))
    modes = [Mode(*each) for each in sizes]
    assert ModeRequest().choose("left", modes) == 2
    assert ModeRequest().choose("left", modes[:1]) == 0
    assert ModeRequest(fps=90).choose("left", modes) == 3
    assert ModeRequest(size=(320, 240)).choose("left", modes) == 4
    assert ModeRequest.parse("x", "size=320×240&fps=30") == ModeRequest(size=(320, 240), fps=30)


def test_a_recording_has_no_modes(recording: Recording) -> None:
    with pytest.raises(InputError, match="a recording has no other modes than it was made in"):
        make_sources([f"{recording.path}?fps=15"])


def test_looking_for_cameras_never_fails(monkeypatch: pytest.MonkeyPatch, virtual: VirtualTime) -> None:
    """Every kind is listed, or told why not; one whose SDK fails or hangs does not keep the others from the list."""
    found, unable = find_cameras()
    assert {camera.spec.partition(":")[0] for camera in found} | set(unable) <= set(cameras.BACK_ENDS)
    here = ConnectedCamera("orbbec:7", "Femto", "7", "")
    hang = virtual.Event()

    def fail() -> list[ConnectedCamera]:
        raise RuntimeError("usb is broken")

    def missing() -> list[ConnectedCamera]:
        raise missing_extra("openni", "openni")

    looks = {"realsense": fail, "azure": hang.wait, "orbbec": lambda: [here], "openni": missing}
    for back_end, look in looks.items():
        monkeypatch.setattr(f"{cameras.BACK_ENDS[back_end]}.find_cameras", look)
    monkeypatch.setattr(cameras, "BACK_ENDS", {name: cameras.BACK_ENDS[name] for name in looks})
    console = Terminal(record=True, width=150)
    assert list_cameras(CamerasSettings(), console) == [here]
    hang.set()
    text = console.export_text()
    assert "orbbec:7" in text
    assert "• realsense: its SDK failed: usb is broken" in text
    assert "• azure: its SDK did not answer" in text
    assert "• openni: this needs the package 'openni': pip install 'depthmocap[openni]'" in text


def test_the_synthetic_scene_is_a_source_for_each_of_its_cameras() -> None:
    pytest.importorskip("anny")
    told: list[str] = []
    sources = make_sources(["synthetic?fps=5"], tell=told.append)
    assert [line[:26] for line in told] == ["making the synthetic scene"]
    stamps = []
    for each in reversed(sources):  # in any order: the others' frames wait
        with each as source:
            frames = [source.read(), source.read()]
            for frame in frames:
                assert frame is not None
                assert frame.raw.shape == (source.camera.height, source.camera.width)
                assert (frame.raw > 0).mean() > 0.5
            assert source.up == "z"
            stamps.append([frame.timestamp_ns for frame in frames if frame])
    assert (np.ptp(stamps, axis=0) < 10_000_000).all()
    np.testing.assert_allclose(np.diff(stamps), 200e6, atol=6e6)
    for spec in ("synthetic#x", "synthetic#x?fps=5"):
        with pytest.raises(CameraError, match="no camera 'x': it has cam0, cam1, cam2"):
            make_sources([spec])
    with pytest.raises(CameraError, match=r"camera 'cam0' has no fps=7: it has 5, 8, 10, 15, 20, 30$"):
        make_sources(["synthetic?fps=7"])
    with pytest.raises(CameraError, match=r"camera 'cam2' has no size=320x288: it has 256x212$"):
        make_sources(["synthetic#cam2?size=320x288"])
