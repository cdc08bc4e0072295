"""Simulated cameras: what is asked for is what is delivered, and nothing else."""

import itertools

import camera_simulator as simulator
import numpy as np
import pytest
from camera_simulator import Faults, RecordedScene, SimulatedCamera, Simulation
from ramp_scene import Ramp, small_rig

from depthmocap.cameras.source import CameraError
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, View


def events(faults, seconds=10.0, seed=0):
    return list(Simulation(Ramp(1), 30.0, seconds, {"cam0": faults}, seed=seed).events())


def test_cameras_without_faults_deliver_everything_in_step():
    found = list(Simulation(Ramp(), 30.0, 2.0).events())
    assert len(found) == 4 * 60
    assert {event.arrival_ns - event.exposure_ns for event in found} == {5_000_000}
    assert found[0].load()[0, 0] == 1000
    assert found[-1].load()[0, 0] == 1000 + round(59 / 30 * 1000)
    assert all(b.arrival_ns >= a.arrival_ns for a, b in itertools.pairwise(found))


def test_the_same_seed_gives_the_same_faults():
    faults = Faults(loss=0.2, jitter_ms=10.0, reorder=0.1, duplicate=0.1)
    first, second, other = ([(e.timestamp_ns, e.arrival_ns) for e in events(faults, seed=seed)] for seed in (1, 1, 2))
    assert first == second != other


def test_loss_and_duplicates_are_of_their_share():
    assert len(events(Faults(loss=0.2), 60.0)) == pytest.approx(0.8 * 1800, rel=0.05)
    twice = [e.timestamp_ns for e in events(Faults(duplicate=0.1), 60.0)]
    assert len(twice) - len(set(twice)) == pytest.approx(180, rel=0.3)


def test_clock_drifts_and_jumps():
    found = events(Faults(offset_s=3.0, drift_ppm=200.0, jumps=((5.0, -1.0),)))
    ahead = np.array([e.timestamp_ns - (e.exposure_ns - 1_000_000_000) for e in found]) * 1e-9
    exposure = np.arange(300) / 30
    np.testing.assert_allclose(ahead, 3.0 + 200e-6 * exposure - (exposure >= 5.0), atol=1e-8)


def test_a_camera_that_was_unplugged_knows_nothing_of_jumps_before():
    found = events(Faults(jumps=((2.0, 5.0), (8.0, -1.0)), unplugged=((4.0, 6.0),)))
    exposure = np.array([e.exposure_ns - 1_000_000_000 for e in found]) * 1e-9
    expected = exposure + 5.0 * (exposure >= 2.0) - (exposure >= 6.0) * 11.0 - 1.0 * (exposure >= 8.0)
    np.testing.assert_allclose([e.timestamp_ns * 1e-9 for e in found], expected, atol=1e-8)


def test_reordered_frames_follow_their_successor():
    found = events(Faults(reorder=0.1))
    steps = np.diff([e.timestamp_ns for e in found])
    assert 10 < np.count_nonzero(steps < 0) < 50
    assert len(found) == 300


def test_pictures_freeze_turn_to_noise_and_go_dark():
    found = events(Faults(frozen=((1.0, 2.0),), garbage=((3.0, 4.0),), dark=((5.0, 6.0),)))
    assert all(found[i].load()[0, 0] == 2000 for i in range(30, 60))
    assert len(np.unique(found[100].load())) > 6
    assert not found[160].load().any()
    assert found[200].load()[0, 0] == 1000 + round(200 / 30 * 1000)


def test_stuck_call_and_unplugged_camera():
    times = [
        (e.exposure_ns - 1_000_000_000) * 1e-9 for e in events(Faults(stuck=((2.0, 4.0),), unplugged=((6.0, 8.0),)))
    ]
    arrivals = [
        (e.arrival_ns - 1_000_000_000) * 1e-9 for e in events(Faults(stuck=((2.0, 4.0),), unplugged=((6.0, 8.0),)))
    ]
    assert not [t for t in arrivals if 2.006 < t < 4.0 - 1e-9]
    assert sum(2 <= t < 4 for t in times) == 1
    assert not [t for t in times if 6 <= t < 8]
    assert events(Faults(unplugged=((6.0, 8.0),)))[-1].timestamp_ns == pytest.approx((299 / 30 - 8) * 1e9, abs=1)


def test_recorded_scene_goes_back_and_forth():
    camera = small_rig(1)["cam0"]
    sets = [FrameSet(i, (View(camera, np.full((3, 4), 1.0 + i, np.float32)),)) for i in range(3)]
    scene = RecordedScene(sets, small_rig(1), 10.0)
    shown = [scene.depth("cam0", i / 10)[0, 0] for i in range(9)]
    assert shown == [1000, 2000, 3000, 2000, 1000, 2000, 3000, 2000, 1000]


def test_bad_settings():
    with pytest.raises(InputError, match="shares"):
        Faults(loss=1.5)
    with pytest.raises(InputError, match="cam9"):
        Simulation(Ramp(), 30.0, 1.0, {"cam9": Faults()})
    with pytest.raises(InputError, match="phases"):
        Simulation(Ramp(), 30.0, 1.0, phases=[0.5])
    with pytest.raises(InputError, match="no frames"):
        RecordedScene([], small_rig(1), 30.0)


class Clock:
    """Stands for the module ``time``: time passes only while somebody sleeps."""

    def __init__(self) -> None:
        self.now_ns = 5_000_000_000

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += int(seconds * 1e9) + 1  # never less than asked for


def test_a_simulated_camera_delivers_in_time_and_dies_and_returns(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(simulator, "time", clock)
    simulation = Simulation(Ramp(1), 100.0, 2.0, {"cam0": Faults(unplugged=((0.2, 0.3),), stuck=((1.0, 1.5),))})
    camera, zero_ns = SimulatedCamera(simulation, "cam0", clock.now_ns), clock.now_ns
    with camera, pytest.raises(CameraError, match="not connected"):
        while camera.read() is not None:
            pass
    assert 0.2 <= (clock.now_ns - zero_ns) * 1e-9 < 0.3
    with pytest.raises(CameraError, match="not connected"), camera:
        pass
    clock.sleep(0.31 - (clock.now_ns - zero_ns) * 1e-9)
    with camera:
        frames = list(camera)
        assert camera.read() is None
    # A hundredth of a second apart, and 5 ms on the way; a call that was stuck gives one frame when it returns.
    late_s = [*np.arange(0.315, 1.0, 0.01), 1.5, *np.arange(1.505, 2.0, 0.01)]
    np.testing.assert_allclose([(frame.arrival_ns - zero_ns) * 1e-9 for frame in frames], late_s, atol=1e-6)
    assert frames[0].timestamp_ns < 1_690_000_000  # its clock began anew, at 0.3 s
    assert frames[-1].timestamp_ns == 1_690_000_000
