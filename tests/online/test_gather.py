"""Threads that read simulated cameras in real time. Times are loose: a busy machine is late, but nothing may hang."""

import itertools
import threading
import time

import pytest
from fakes import Board, fake_pipeline

from depthmocap.capture.simulator import Faults, SimulatedCamera, Simulation
from depthmocap.capture.sync import SyncSettings
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import Rig
from depthmocap.online.gather import Gatherer
from depthmocap.online.live import LiveCapture

RATE = 20.0


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Inner loops are compiled or read from their cache before time counts."""
    board = Board(1)
    camera = board.rig["cam0"]
    fake_pipeline()(FrameSet(0, (View(camera, camera.to_metres(board.depth("cam0", 0.0))),)))


def cameras(simulation, zero_ns=None):
    zero_ns = zero_ns or time.monotonic_ns() + 50_000_000
    return [SimulatedCamera(simulation, name, zero_ns) for name in simulation.scene.rig.names]


def test_poses_come_until_the_cameras_end():
    simulation = Simulation(Board(2), RATE, 2.0)
    with LiveCapture(cameras(simulation), None, fake_pipeline()) as capture:
        poses = list(capture)
    used = [status.counts["used"] for status in capture.statuses()]
    assert max(used) <= len(poses) + capture.dropped <= sum(used)
    assert len(poses) > 10
    assert all(b.pose.timestamp_ns > a.pose.timestamp_ns for a, b in itertools.pairwise(poses))
    assert any(len(each.synced.frames) == 2 for each in poses)
    assert {status.state for status in capture.statuses()} == {"at its end"}
    assert capture.gatherer.intake.sync.settings.rate_hz == pytest.approx(RATE, rel=0.01)
    assert capture.books.summary()["poses"] == len(poses)


def test_a_slow_consumer_gets_the_newest_set_and_the_rest_is_dropped():
    simulation = Simulation(Board(2), RATE, 2.5)
    taken = []
    with Gatherer(cameras(simulation), sync=SyncSettings(RATE), measure_rate=False) as gatherer:
        for synced in gatherer.sets():
            newest_ns = max(frame.arrival_ns for frame in synced.frames.values())
            taken.append((time.monotonic_ns() - newest_ns) * 1e-9)
            time.sleep(0.4)
    assert len(taken) < 12
    assert gatherer.dropped > 20
    assert max(taken[1:-1]) < 0.4  # never older than one turn, however long it goes on


def test_a_stuck_camera_and_one_that_is_unplugged_do_not_stop_the_others():
    faults = {"cam1": Faults(stuck=((0.5, 60.0),)), "cam2": Faults(unplugged=((0.5, 1.2),))}
    simulation = Simulation(Board(3), RATE, 5.0, faults)
    names = []
    with LiveCapture(cameras(simulation), None, fake_pipeline(), SyncSettings(RATE), False) as capture:
        for each in capture:
            names.append(set(each.synced.frames))
            if len(names) >= 60:
                break
        statuses = {status.name: status for status in capture.statuses()}
        begun = time.monotonic()
    assert time.monotonic() - begun < 5  # leaving does not wait for the call that hangs
    assert {"cam0"} in names
    assert {"cam0", "cam2"} in names[12:]
    assert "cam1" not in set.union(*names[20:])
    assert statuses["cam1"].state == "no frames"
    assert any("cam2" in line and "lost" in line for line in capture.problems)


def test_cameras_come_and_go_while_running():
    simulation = Simulation(Board(2), RATE, 4.0)
    first, second = cameras(simulation)
    seen = []
    with LiveCapture([first], None, fake_pipeline(), SyncSettings(RATE), False) as capture:
        for each in capture:
            seen.append(len(each.synced.frames))
            if len(seen) == 10:
                capture.gatherer.add(second)
                with pytest.raises(InputError, match="cam1"):
                    capture.gatherer.add(second)
            if len(seen) == 40:
                capture.gatherer.remove("cam1")
            if len(seen) == 55:
                break
    assert set(seen[:10]) == {1}
    assert 2 in seen[10:40]
    assert set(seen[45:]) == {1}


def test_it_can_be_stopped_from_another_thread():
    simulation = Simulation(Board(1), RATE, 600.0)
    with LiveCapture(cameras(simulation), None, fake_pipeline(), SyncSettings(RATE), False) as capture:
        threading.Timer(0.5, capture.stop).start()
        assert sum(1 for _ in capture) < 100


def test_no_camera_that_opens_is_an_error():
    simulation = Simulation(Board(1), RATE, 5.0, {"cam0": Faults(unplugged=((-10.0, 100.0),))})
    with (
        pytest.raises(InputError, match=r"no camera could be opened .*cam0.*not connected"),
        Gatherer(cameras(simulation)),
    ):
        pass


def test_a_rig_that_does_not_fit_is_told_and_the_others_go_on():
    board, other = Board(2), Board(3, width=64)
    rig = Rig((board.rig["cam0"], other.rig["cam1"], other.rig["cam2"]))
    simulation = Simulation(board, RATE, 1.0)
    with LiveCapture(cameras(simulation), rig, fake_pipeline(), SyncSettings(RATE), False) as capture:
        sets = [each.synced for each in itertools.islice(capture, 8)]
    assert {name for synced in sets for name in synced.frames} == {"cam0"}
    assert any("cam1" in line and "calibrated" in line for line in capture.problems)
    assert any("cam2" in line and "no source" in line for line in capture.problems)


def test_every_frame_is_recorded_and_a_full_disk_is_told():
    class Recorder:
        def __init__(self, room):
            self.frames, self.room = [], room

        def write(self, frame):
            if len(self.frames) >= self.room:
                raise InputError("the disk is full")
            self.frames.append(frame.camera)

    for room, expected in ((1000, 40), (10, 10)):
        simulation, recorder = Simulation(Board(2), RATE, 1.0), Recorder(room)
        capture = LiveCapture(cameras(simulation), None, fake_pipeline(), SyncSettings(RATE), False)
        capture.gatherer.recorder = recorder
        with capture:
            assert sum(1 for _ in capture) > 5
        assert len(recorder.frames) in (expected, expected + 1)
        assert ("the disk is full" in capture.problems) == (room == 10)
