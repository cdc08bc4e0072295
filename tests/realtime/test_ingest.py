"""Twenty seconds of everything that goes wrong with four cameras, in virtual time, through checks and synchroniser."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from camera_simulator import Faults, Simulation
from fakes import Board, fake_pipeline

from depthmocap.realtime.ingest import FrameIngest, frame_set, recorded_frames
from depthmocap.realtime.problems import Problems
from depthmocap.realtime.status import camera_statuses
from depthmocap.realtime.sync import SyncSettings
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter

#: Each camera has its own trouble, and all lose frames, are late and drift.
COMMON = Faults(loss=0.05, jitter_ms=10.0)
FAULTS = {
    "cam0": replace(COMMON, drift_ppm=200.0, offset_s=7.0, frozen=((4.0, 6.0),), stuck=((10.0, 13.0),), duplicate=0.05),
    "cam1": replace(COMMON, offset_s=60.0, drift_ppm=-200.0, unplugged=((5.0, 9.0),), reorder=0.03),
    "cam2": replace(COMMON, jumps=((7.0, -50.0), (14.0, 1e5)), garbage=((3.0, 4.0),)),
    "cam3": replace(COMMON, offset_s=-1000.0, dark=((11.0, 12.0),)),
}


@pytest.fixture(scope="module")
def outcome():
    scene = Board()
    ingest = FrameIngest(SyncSettings(30.0))
    for camera in scene.rig.cameras:
        ingest.add_camera(camera)
    simulation = Simulation(scene, 30.0, 20.0, FAULTS)
    true = {(event.camera, event.timestamp_ns): event.exposure_ns for event in simulation.events()}
    sets = list(ingest.run(event.frame() for event in simulation.events()))
    exposures = [{name: true[name, frame.timestamp_ns] for name, frame in left.frames.items()} for left in sets]
    return ingest, sets, exposures


def seconds(sets):
    return np.array([(left.timestamp_ns - 1_000_000_000) * 1e-9 for left in sets])


def test_there_is_a_set_at_every_instant(outcome):
    _, sets, _ = outcome
    assert len(sets) >= 0.99 * 600
    steps = np.diff(seconds(sets))
    assert (steps > 0).all()
    assert steps.max() < 0.1


def test_frames_of_a_set_are_of_one_instant(outcome):
    _, _, exposures = outcome
    spread_ms = np.array([max(own.values()) - min(own.values()) for own in exposures]) * 1e-6
    assert np.mean(spread_ms < 1) >= 0.99


def test_broken_pictures_are_left_out_counted_and_told_of(outcome):
    ingest, _, exposures = outcome
    times = {
        name: np.array([(own[name] - 1_000_000_000) * 1e-9 for own in exposures if name in own]) for name in FAULTS
    }
    for name, (begin, end) in {"cam0": (4.5, 6.0), "cam2": (3.0, 4.0), "cam3": (11.0, 12.0)}.items():
        assert not ((times[name] >= begin) & (times[name] < end)).any(), name
    assert set(ingest.faults["cam0"]) == {"frozen"}
    assert ingest.faults["cam2"]["noise"] == pytest.approx(28, abs=4)
    assert ingest.faults["cam3"]["dark"] == pytest.approx(28, abs=4)
    assert sum("cam3" in line for line in ingest.problems.counts()) == 1
    dark = "camera 'cam3': no pixel has depth: is it covered, or too near to something?"
    assert ingest.problems.counts()[dark] == ingest.faults["cam3"]["dark"]


def test_clocks_that_jump_are_told(outcome):
    ingest, _, _ = outcome
    jumps = {line: times for line, times in ingest.problems.counts().items() if "clock" in line}
    assert jumps == {
        "camera 'cam1': its clock went back, or its frames were held up for a second": 1,  # it was unplugged
        "camera 'cam2': its clock went back, or its frames were held up for a second": 1,
        "camera 'cam2': its clock jumped ahead": 1,
    }


def test_a_camera_whose_time_runs_backwards_is_left_out_and_told_of():
    scene = Board(2)
    ingest = FrameIngest(SyncSettings(30.0))
    for camera in scene.rig.cameras:
        ingest.add_camera(camera)

    def backwards():
        for event in Simulation(scene, 30.0, 4.0).events():
            frame = event.frame()
            if frame.camera == "cam1":
                frame = dataclasses.replace(frame, timestamp_ns=10**12 - frame.timestamp_ns)
            yield frame

    sets = list(ingest.run(backwards()))
    assert sum("cam0" in left.frames for left in sets) == 120
    assert not any("cam1" in left.frames for left in sets[20:])
    assert ingest.problems.counts()["camera 'cam1': its time runs backwards or stands still: reconnect it"] == 110
    statuses = camera_statuses(ingest, {"cam0": "running", "cam1": "running"}, sets[-1].timestamp_ns)
    assert [status.state for status in statuses] == ["running", "clock: left out"]


def test_cameras_that_return_are_back_within_half_a_second(outcome):
    _, sets, exposures = outcome
    at = seconds(sets)
    for name, back_s in {"cam0": 6.0, "cam1": 9.0, "cam2": 14.0, "cam3": 12.0}.items():
        again = next(t for t, own in zip(at, exposures, strict=True) if t > back_s and name in own)
        assert again - back_s < 0.5, name
        share = np.mean([name in own for t, own in zip(at, exposures, strict=True) if back_s + 0.5 < t < back_s + 0.9])
        assert share > 0.7, name


def test_a_set_becomes_views_in_metres(outcome):
    ingest, sets, _ = outcome
    frames = frame_set(sets[0], ingest.cameras)
    names = [name for name in ingest.cameras if name in sets[0].frames]
    assert [view.camera.name for view in frames.views] == names
    late = dataclasses.replace(sets[0], frames=dict(reversed(sets[0].frames.items())))
    assert [view.camera.name for view in frame_set(late, ingest.cameras).views] == names
    assert frames.views[0].depth_m.mean() == pytest.approx(3.0, abs=0.1)
    assert np.isfinite(fake_pipeline()(frames).pose.joints).all()


def test_a_recording_gives_its_own_sets(tmp_path):
    scene = Board(2)
    with RecordingWriter(tmp_path / "recording", scene.rig) as writer:
        for i in range(20):
            time_ns = 1_700_000_000_000_000_000 + i * 40_000_000
            writer.write(time_ns, {"cam0": scene.depth("cam0", i * 0.04)})
            if i != 7:
                writer.write(time_ns + 3_000_000, {"cam1": scene.depth("cam1", i * 0.04)})
    bad = sorted((tmp_path / "recording" / "cam0").glob("*.png"))[12]
    bad.write_bytes(bad.read_bytes()[:-30])
    recording, problems = Recording(tmp_path / "recording"), Problems()
    ingest = FrameIngest(SyncSettings(25.0))
    for camera in recording.rig.cameras:
        ingest.add_camera(camera)
    sets = list(ingest.run(recorded_frames(recording, problems)))
    assert [len(left.frames) for left in sets] == [1 if i in (7, 12) else 2 for i in range(20)]
    assert [bad.name in line for line in problems.counts()] == [True]
