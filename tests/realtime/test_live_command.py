"""``depthmocap live`` on a small recording, with a pipeline that costs nothing: its files, and what it says."""

import contextlib
import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from camera_simulator import Faults, SimulatedCamera, Simulation
from fakes import Board, fake_pipeline

from depthmocap.calibration.rig_watch import RigWatch
from depthmocap.cli import main
from depthmocap.core.console import Terminal
from depthmocap.core.network_devices import NetworkDevices
from depthmocap.errors import InputError
from depthmocap.exporting import read_bvh, read_csv, read_trc
from depthmocap.exporting.summary import read_summary
from depthmocap.geometry import load_rig, rigid_inverse, transform_points
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.realtime import live_capture as live_module
from depthmocap.realtime import live_command as command
from depthmocap.realtime.live_command import LiveSettings, run_live
from depthmocap.recordings.convert import ConvertSettings, convert
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.smooth.filters import Bones, load_filter

SETS = 30


class EmptyRoom:
    """Finds nobody."""

    people, problems = 1, []

    def __call__(self, frames):
        return ()

    def reset(self):
        pass


def use_pipelines(monkeypatch, load):
    for module in (live_module, command):
        monkeypatch.setattr(module, "load_pipeline", load)


@pytest.fixture
def recording(tmp_path, monkeypatch):
    use_pipelines(monkeypatch, lambda *arguments, **others: fake_pipeline())
    scene, path = Board(2), tmp_path / "recording"
    with RecordingWriter(path, scene.rig) as writer:
        for i in range(SETS):
            frames = {name: scene.depth(name, i * 0.04) for name in scene.rig.names}
            writer.write(1_700_000_000_000_000_000 + i * 40_000_000, frames)
    return str(path)


def test_as_fast_as_it_goes_every_set_becomes_a_pose(recording, tmp_path):
    summary = run_live(LiveSettings((recording,), out=tmp_path / "out")).summary
    times_s, joints, _ = read_csv(tmp_path / "out" / "pose.csv")
    np.testing.assert_allclose(times_s, np.arange(SETS) * 0.04, atol=1e-6)
    assert np.isfinite(joints).all()
    assert len(read_trc(tmp_path / "out" / "pose.trc")[0]) == len(read_bvh(tmp_path / "out" / "pose.bvh")[0]) == SETS
    written = read_summary(tmp_path / "out")
    assert written["command"] == "live" and written["sources"] == [recording]
    assert written["first_timestamp_ns"] == 1_700_000_000_000_000_000
    assert written["frames"] == summary["frames"] == SETS
    assert written["sets_dropped"] == 0
    assert written["cameras"]["cam1"]["counts"]["used"] == SETS
    assert not written["interrupted"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_streams_that_are_full_end_nothing(recording, tmp_path, monkeypatch):
    with open("/dev/full", "w", encoding="utf-8") as full:  # noqa: PTH123 - of the type of the standard streams
        monkeypatch.setattr(sys, "stderr", full)
        assert main(["live", recording, "--out", str(tmp_path / "out")]) == 0
    assert len(read_csv(tmp_path / "out" / "pose.csv")[0]) == SETS
    assert len(read_bvh(tmp_path / "out" / "pose.bvh")[0]) == SETS


@pytest.mark.parametrize("terminal", [False, True])
def test_the_dashboard_is_drawn_in_a_terminal_alone(recording, monkeypatch, terminal):
    drawn = []
    monkeypatch.setattr(command, "DRAW_S", 0.0)
    monkeypatch.setattr(command, "draw_dashboard", lambda *told: drawn.append(told) or "cameras")
    out = io.StringIO()
    run_live(LiveSettings((recording,)), Terminal(file=out, force_terminal=terminal))
    assert bool(drawn) == terminal == ("cameras" in out.getvalue())


def test_a_filter_that_waits_gives_every_pose_once(recording, tmp_path, monkeypatch):
    pipeline = fake_pipeline(load_filter("fixed-lag"))
    use_pipelines(monkeypatch, lambda *arguments, **others: pipeline)
    run_live(LiveSettings((recording,), out=tmp_path / "out"))
    np.testing.assert_allclose(read_csv(tmp_path / "out" / "pose.csv")[0], np.arange(SETS) * 0.04, atol=1e-6)


def test_an_interruption_leaves_complete_files(recording, tmp_path, monkeypatch):
    pipeline = fake_pipeline()

    class Interrupted:
        smoothing, segment, devices = None, EmptyRoom(), NetworkDevices()

        def __init__(self):
            self.calls = 0

        def __call__(self, frames):
            self.calls += 1
            if self.calls > 10:
                raise KeyboardInterrupt
            return pipeline(frames)

        def finish(self):
            return []

    use_pipelines(monkeypatch, lambda *arguments, **others: Interrupted())
    for earlier in (tmp_path / "out", tmp_path / "out" / "person-4"):
        earlier.mkdir()
        (earlier / "pose.csv").write_text("time_s,Head_x\n")
        (earlier / "report.html").touch()
    summary = run_live(LiveSettings((recording,), out=tmp_path / "out")).summary
    assert summary["interrupted"]
    results = {"pose.csv", "pose.trc", "pose.bvh", "summary.json"}  # nothing of an earlier run
    assert {path.name for path in (tmp_path / "out").iterdir()} == results
    for read, name in ((read_csv, "pose.csv"), (read_trc, "pose.trc"), (read_bvh, "pose.bvh")):
        assert len(read(tmp_path / "out" / name)[0]) == 10
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["interrupted"]


def test_in_real_time_everything_is_recorded_once_the_cameras_are_open(recording, tmp_path, virtual):
    pytest.importorskip("foxglove")
    copy = tmp_path / "copy.mcap"
    summary = run_live(
        LiveSettings((recording,), out=tmp_path / "out", record=copy, realtime=True, segment="none")
    ).summary
    counted = [summary[name] for name in ("frames", "sets_dropped", "sets_before_ready")]
    assert counted[0] + counted[1] > SETS / 2
    assert counted[2] >= 1
    assert SETS - 2 <= sum(counted) <= SETS  # no set is without an account, but for those while cameras open
    made, original = open_recording(copy), open_recording(Path(recording))
    for name in ("cam0", "cam1"):
        assert SETS / 2 < len(made.stamps(name)) <= SETS
        assert made.stamps(name) == original.stamps(name)[-len(made.stamps(name)) :]
        np.testing.assert_array_equal(made.raw(name, made.stamps(name)[5]), original.raw(name, made.stamps(name)[5]))


@pytest.mark.parametrize("realtime", [False, True])
def test_bones_are_steady_or_free(recording, tmp_path, monkeypatch, virtual, realtime):
    given = []

    def load(*arguments, **others):
        given.append(others["settings"].bones)
        return fake_pipeline(load_filter("kalman", bones=given[-1]))

    use_pipelines(monkeypatch, load)

    def bones_told(bones: Bones) -> object:
        smoothing = run_live(LiveSettings((recording,), realtime=realtime, bones=bones)).summary["smoothing"]
        assert smoothing is not None
        return smoothing["bones"]

    free, steady = bones_told("free"), bones_told("steady")
    # In real time each is made once more before cameras are opened, to compile what it needs.
    assert (given[::2] if realtime else given, free) == (["free", "steady"], None)
    assert steady is not None


@pytest.mark.parametrize("realtime", [False, True])
def test_it_ends_in_time_even_if_no_camera_delivers(recording, monkeypatch, virtual, realtime):
    faults = {"cam0": Faults(unplugged=((1.0, 900.0),))}

    def sources(specs, pace, tell):
        return [SimulatedCamera(Simulation(Board(1), 20.0, 900.0, faults), "cam0", virtual.monotonic_ns())]

    if realtime:
        monkeypatch.setattr(command, "make_sources", sources)
    summary = run_live(LiveSettings((recording,), realtime=realtime, seconds=5.0)).summary
    assert summary["frames"] > 5
    assert summary["seconds"] is not None and summary["seconds"] < 6


def test_what_it_takes_to_be_ready_is_told_and_waited_for(recording, monkeypatch, virtual):
    def load(*arguments, **others):
        virtual.sleep(6.0)  # nothing is compiled yet
        return fake_pipeline()

    class Slow(SimulatedCamera):
        def _open(self):
            virtual.sleep(4.0)
            return super()._open()

    use_pipelines(monkeypatch, load)
    console = Terminal(record=True, width=200)
    with monkeypatch.context() as patch:
        simulation = Simulation(Board(2), 10.0, 60.0)
        made = [Slow(simulation, "cam0", virtual.monotonic_ns()), SimulatedCamera(simulation, "cam1", 5_000_000_000)]
        patch.setattr(command, "make_sources", lambda *arguments: made)
        summary = run_live(LiveSettings(("x",), seconds=2.0), console).summary
    assert summary["frames"] == pytest.approx(20, abs=3)
    assert summary["seconds"] == pytest.approx(2.0, abs=0.2)
    assert summary["sets_before_ready"] > 6.0 * 10 - 3
    told = console.export_text()
    assert told.index("• making ready for poses") < told.index("• still opening: cam0")
    for png in (each for name in ("cam0", "cam1") for each in sorted((Path(recording) / name).glob("17*.png"))[1:]):
        png.unlink()
    with pytest.raises(InputError, match="no set of frames came once it was ready for poses, and 1 before"):
        run_live(LiveSettings((recording,), realtime=True))


@pytest.mark.parametrize("realtime", [False, True])
def test_a_damaged_frame_of_a_recording_is_told(recording, tmp_path, virtual, realtime):
    bad = sorted((Path(recording) / "cam0").glob("*.png"))[12]
    bad.write_bytes(bad.read_bytes()[:-30])
    console = Terminal(record=True, width=200)
    problems = run_live(LiveSettings((recording,), realtime=realtime), console).summary["problems"]
    assert [(bad.name in problem["text"], problem["times"]) for problem in problems] == [(True, 1)]
    assert bad.name in console.export_text()


def test_a_recording_that_was_cut_off_is_told_once(recording, tmp_path, virtual):
    pytest.importorskip("foxglove")
    cut = tmp_path / "cut.mcap"
    convert(ConvertSettings(Path(recording), cut))
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    summary = run_live(LiveSettings((str(cut),), realtime=True)).summary
    assert [("cut off" in problem["text"], problem["times"]) for problem in summary["problems"]] == [(True, 1)]
    assert summary["frames"] > 5


def test_a_camera_in_the_dark_is_told_and_counted(tmp_path, monkeypatch, virtual):
    use_pipelines(monkeypatch, lambda *arguments, **others: fake_pipeline())
    scene, path = Board(2), tmp_path / "recording"
    with RecordingWriter(path, scene.rig) as writer:
        for i in range(100):
            frames = {name: scene.depth(name, i * 0.04) for name in scene.rig.names}
            if 25 <= i < 75:
                frames["cam1"][:] = 0
            writer.write(i * 40_000_000, frames)
    console = Terminal(record=True, width=200)
    summary = run_live(LiveSettings((str(path),), segment="none"), console).summary
    assert summary["frames"] == 100
    assert summary["cameras"]["cam1"]["counts"]["dark"] == 50
    assert "• camera 'cam1': no pixel has depth: is it covered, or too near to something? (50 times)" in (
        console.export_text()
    )


def test_a_key_places_the_camera_anew_that_was_moved(recording, tmp_path, monkeypatch, virtual):
    press, stood = [], []
    pipeline = fake_pipeline()
    estimate, rig = pipeline.estimate, Board(2).rig
    rng, moments = np.random.default_rng(0), []
    for i in range(60):  # a body that goes about, seen 0.3 m aside by the camera that was moved
        body, seen = rng.normal(0, 0.5, 3) + rng.normal(0, 0.3, (18, 3)), {}
        for camera in rig.cameras:
            aside = np.array([0.3 if camera.name == "cam1" else 0.0, 0.0, 0.0])
            own = transform_points(rigid_inverse(camera.world_from_camera), body + aside)
            seen[camera.name] = np.concatenate([own, np.full((18, 1), 0.05)], 1)
        moments.append((0.1 * i, seen))

    @contextlib.contextmanager
    def keys(on_key):
        press.append(on_key)
        yield True

    def estimate_and_press(labelled):
        stood.append(labelled.frames.views[1].camera.world_from_camera[:3, 3])
        if len(stood) == 3:  # the first that is not to compile or to warm up
            press[0]("p")
            watches[-1]._moved_s["cam1"] = 0.0
            press[0]("x")
            press[0]("P")
        return estimate(labelled)

    watches = []
    make = RigWatch.__init__
    monkeypatch.setattr(
        RigWatch, "__init__", lambda self, *given, **more: watches.append(self) or make(self, *given, **more)
    )
    monkeypatch.setattr(RigWatch, "moments", lambda self, name: moments)
    monkeypatch.setattr(command, "key_presses", keys)
    pipeline.estimate = estimate_and_press
    use_pipelines(monkeypatch, lambda *arguments, **others: pipeline)
    console = Terminal(record=True, width=300)
    settings = LiveSettings((recording,), out=tmp_path / "out", realtime=True, segment="none")
    run_live(settings, console)
    told = console.export_text()
    assert told.count("• no camera was moved that is not placed anew") == 1
    assert told.count("is placed anew: it had moved by 30.") == 1
    np.testing.assert_allclose(stood[-1] - stood[2], [-0.3, 0.0, 0.0], atol=1e-6)
    placed = load_rig(tmp_path / "out" / "rig-2.json")["cam1"].world_from_camera
    np.testing.assert_array_equal(placed[:3, 3], stood[-1])


def test_nobody_in_view_is_told(recording, tmp_path, monkeypatch):
    pipeline = fake_pipeline()
    pipeline.segment = EmptyRoom()
    use_pipelines(monkeypatch, lambda *arguments, **others: pipeline)
    run_live(LiveSettings((recording,), out=tmp_path / "out"))
    assert "no person" in (tmp_path / "out" / "summary.json").read_text()
    assert len((tmp_path / "out" / "pose.csv").read_text().splitlines()) == SETS + 1


def test_the_python_interface(recording, virtual):
    results = list(live_module.live(recording, segment="none"))
    assert 5 < len(results) <= SETS
    assert results[-1].pose.joints.shape == (18, 3)
    assert [person.number for person in results[-1].people] == [1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sources": ()}, "at least one"),
        ({"sources": ("nowhere",)}, "nowhere"),
        ({"seconds": 0.0}, "--seconds"),
        ({"record": Path("x.mcap")}, "--realtime"),
        ({"least_confidence": 2.0}, "--least-confidence must be from 0 to 1, got 2"),
        ({"record": Path("x.txt"), "realtime": True}, r"--record must end in \.mcap, got x\.txt"),
        *(({"rate_hz": x}, f"--rate-hz must be finite and above 0, got {x}$") for x in (-1.0, 0.0, np.nan, np.inf)),
        *(({"wait_ms": x}, f"--wait-ms must be finite and at least 0, got {x}$") for x in (-5.0, np.nan, np.inf)),
    ],
)
def test_bad_settings_are_one_clear_line(recording, change, message):
    with pytest.raises(InputError, match=message):
        run_live(LiveSettings(**{"sources": (recording,), **change}))


@pytest.mark.parametrize("realtime", [False, True])
def test_weights_of_your_own(recording, monkeypatch, virtual, realtime):
    use_pipelines(monkeypatch, load_pipeline)
    with pytest.raises(InputError, match=r"none\.onnx not found"):
        run_live(LiveSettings((recording,), realtime=realtime, weights=Path("none.onnx")))
