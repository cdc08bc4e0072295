"""Threads that read simulated cameras, in virtual time."""

import itertools

import pytest
from camera_simulator import Faults, SimulatedCamera, Simulation
from fakes import Board, fake_pipeline

from depthmocap.errors import InputError
from depthmocap.geometry import Rig
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.realtime.sync import SyncSettings
from depthmocap.realtime.synced_reader import SyncedReader

RATE = 20.0


def cameras(simulation, virtual):
    return [SimulatedCamera(simulation, name, virtual.monotonic_ns()) for name in simulation.scene.rig.names]


def capture_of(sources, rig=None, rate_hz=RATE):
    return LiveCapture(sources, rig, fake_pipeline(), SyncSettings(rate_hz), False)


def test_poses_come_until_the_cameras_end(virtual):
    simulation = Simulation(Board(2), RATE, 2.0)
    with LiveCapture(cameras(simulation, virtual), None, fake_pipeline()) as capture:
        poses = list(capture)
    # Threads take turns at one instant as they like: a frame may come just when its set leaves without it.
    assert all(39 <= status.counts["used"] <= 40 for status in capture.statuses())
    # Frames that waited while the rate was measured make sets that nobody could take in time.
    assert 39 <= len(poses) + capture.dropped <= 41
    assert len(poses) >= 30
    assert all(b.pose.timestamp_ns > a.pose.timestamp_ns for a, b in itertools.pairwise(poses))
    assert sum(len(each.synced.frames) != 2 for each in poses) <= 1
    assert {status.state for status in capture.statuses()} == {"at its end"}
    assert capture.reader.rate_hz == pytest.approx(RATE, rel=0.01)
    assert capture.statistics.summary()["frames"] == len(poses)
    assert not capture.problems
    delay_ns = (capture.recorded_minus_timestamp_ns or 0) - capture.unix_minus_monotonic_ns
    assert abs(delay_ns) < 20_000_000


def test_a_slow_consumer_gets_the_newest_set_and_the_rest_is_dropped(virtual):
    simulation = Simulation(Board(2), RATE, 20.0)
    ages_s = []
    with SyncedReader(cameras(simulation, virtual), sync=SyncSettings(RATE), measure_rate=False) as reader:
        for synced in reader.sets():
            ages_s.append((virtual.monotonic_ns() - max(f.arrival_ns for f in synced.frames.values())) * 1e-9)
            virtual.sleep(0.42)
    assert len(ages_s) == pytest.approx(20 / 0.42, abs=2)
    assert len(ages_s) + reader.dropped == 400
    assert max(ages_s[:-1]) <= 1 / RATE + 0.001  # never older than one period, however long it goes on


def test_a_stuck_camera_and_one_that_is_unplugged_do_not_stop_the_others(virtual):
    faults = {"cam1": Faults(stuck=((0.5, 60.0),)), "cam2": Faults(unplugged=((0.5, 2.2),))}
    simulation = Simulation(Board(3), RATE, 5.0, faults)
    poses = []
    with capture_of(cameras(simulation, virtual)) as capture:
        for each in capture:
            poses.append((each.synced.timestamp_ns, set(each.synced.frames)))
            if len(poses) >= 70:
                break
        statuses = {status.name: status for status in capture.statuses()}
        begun_s = virtual.monotonic()
    assert virtual.monotonic() - begun_s < 2  # leaving does not wait for the call that hangs
    zero_ns = 5_000_000_000
    within = {
        part: set.union(*(names for at, names in poses if begin <= (at - zero_ns) * 1e-9 < end))
        for part, begin, end in (("before", 0.0, 0.5), ("without", 0.6, 2.2), ("again", 2.7, 9.0))
    }
    assert within == {"before": {"cam0", "cam1", "cam2"}, "without": {"cam0"}, "again": {"cam0", "cam2"}}
    assert statuses["cam1"].state == "no frames"
    assert statuses["cam2"].opened_in_vain == pytest.approx(6, abs=1)
    assert dict(capture.problems) == {
        "camera 'cam2' is not connected": 1,
        "camera 'cam2': its clock went back, or its frames were held up for a second": 1,  # it began anew
    }


def test_cameras_come_and_go_while_running(virtual):
    simulation = Simulation(Board(2), RATE, 4.0)
    first, second = cameras(simulation, virtual)
    seen = []
    with capture_of([first]) as capture:
        for each in capture:
            seen.append(len(each.synced.frames))
            if len(seen) == 10:
                capture.reader.add(second)
                with pytest.raises(InputError, match="cam1"):
                    capture.reader.add(second)
            if len(seen) == 40:
                capture.reader.remove("cam1")
                with pytest.raises(InputError, match="no camera 'cam1': there are cam0"):
                    capture.reader.remove("cam1")
            if len(seen) == 55:
                break
    assert set(seen[:10]) == {1}
    assert set(seen[15:40]) == {2}
    assert set(seen[45:]) == {1}


def test_it_can_be_stopped_from_another_thread(virtual):
    with capture_of(cameras(Simulation(Board(1), RATE, 600.0), virtual)) as capture:

        def stop_later():
            virtual.sleep(0.5)
            capture.stop()

        virtual.Thread(target=stop_later).start()
        assert sum(1 for _ in capture) == pytest.approx(0.5 * RATE, abs=2)


def test_no_camera_that_opens_is_an_error(virtual):
    simulation = Simulation(Board(1), RATE, 5.0, {"cam0": Faults(unplugged=((-10.0, 100.0),))})
    with (
        pytest.raises(InputError, match=r"no camera could be opened .*cam0.*not connected"),
        SyncedReader(cameras(simulation, virtual)),
    ):
        pass


def test_a_rig_that_does_not_fit_is_told_once_and_the_others_go_on(virtual):
    board, other = Board(3), Board(4, width=64)
    rig = Rig((board.rig["cam0"], other.rig["cam1"], other.rig["cam3"]))
    with capture_of(cameras(Simulation(board, 5.0, 60.0), virtual), rig, 5.0) as capture:
        sets = [each.synced for each in itertools.islice(capture, 150)]
        statuses = {status.name: status for status in capture.statuses()}
    assert {name for synced in sets for name in synced.frames} == {"cam0"}
    assert sorted(capture.problems) == [
        "camera 'cam1' delivers 32×24 but was calibrated at 64×24: calibrate it again, or ask the device for "
        "?size=64x24",
        "the rig has a camera 'cam3', but no source of that name was given; going on without it",
        "the rig has no camera 'cam2': it has cam0, cam1, cam3",
    ]
    assert set(capture.problems.values()) == {1}
    assert statuses["cam1"].state.startswith("camera 'cam1' delivers 32×24")
    # At 0, 0.5, 1.5, 3.5 and 7.5 s, and from then on every 8 s: not a hundred times.
    assert {name: status.opened_in_vain for name, status in statuses.items()} == {"cam0": 0, "cam1": 7, "cam2": 7}


def test_a_camera_that_does_not_fit_does_not_keep_recordings_from_ending(virtual):
    board = Board(2)
    rig = Rig((board.rig["cam0"], Board(2, width=64).rig["cam1"]))
    begun_s = virtual.monotonic()
    with capture_of(cameras(Simulation(board, RATE, 2.0), virtual), rig) as capture:
        virtual.Timer(30.0, capture.stop).start()
        assert sum(1 for _ in capture) > 30
        assert virtual.monotonic() - begun_s < 3


def test_what_a_source_knows_to_be_wrong_is_told(virtual):
    (source,) = cameras(Simulation(Board(1), RATE, 1.0), virtual)
    source.problems.append("a frame is damaged")
    with capture_of([source]) as capture:
        assert sum(1 for _ in capture) > 5
    assert dict(capture.problems) == {"a frame is damaged": 1}


def test_every_frame_is_recorded_and_a_full_disk_is_told(virtual):
    class Recorder:
        def __init__(self, room):
            self.frames, self.room = [], room

        def write(self, frame):
            if len(self.frames) >= self.room:
                raise InputError("the disk is full")
            self.frames.append(frame.camera)

    for room, expected in ((1000, {40}), (10, {10, 11})):
        recorder = Recorder(room)
        capture = capture_of(cameras(Simulation(Board(2), RATE, 1.0), virtual))
        capture.reader.recorder = recorder
        with capture:
            assert sum(1 for _ in capture) > 5
        assert len(recorder.frames) in expected
        assert ("the disk is full" in capture.problems) == (room == 10)
