"""Sets from simulated cameras, whose true exposures are known, through everything that goes wrong."""

import collections
import dataclasses
import itertools

import numpy as np
import pytest
from camera_simulator import Faults, Simulation
from ramp_scene import Ramp

from depthmocap.cameras.source import DepthFrame
from depthmocap.errors import InputError
from depthmocap.realtime.sync import Synchroniser, SyncSettings

RATE, SECONDS = 30.0, 8.0
PERIOD_NS = 1e9 / RATE


@dataclasses.dataclass
class Outcome:
    sync: Synchroniser
    #: For each set, the true exposure (ns) of each camera's frame, and the wait (ns) after its last arrival.
    sets: list
    exposures: list
    waits: list
    delivered: collections.Counter

    def spread_ms(self):
        """True time between the first and the last frame of each set."""
        return np.array([max(own.values()) - min(own.values()) for own in self.exposures]) * 1e-6


def run(faults, phases=None, settings=None, count=4, rate=RATE, seconds=SECONDS, seed=0):
    """All events through a synchroniser, in virtual time: it is polled at every arrival and at every deadline."""
    scene = Ramp(count)
    sync = Synchroniser(settings or SyncSettings(rate))
    for name in scene.rig.names:
        sync.add_camera(name)
    by_name = {name: faults for name in scene.rig.names} if isinstance(faults, Faults) else faults
    outcome = Outcome(sync, [], [], [], collections.Counter())
    true = {}

    def take(now_ns):
        for left in sync.poll(now_ns):
            outcome.sets.append(left)
            outcome.exposures.append({name: true[name, f.timestamp_ns] for name, f in left.frames.items()})
            outcome.waits.append(now_ns - max(f.arrival_ns for f in left.frames.values()))

    for event in Simulation(scene, rate, seconds, by_name, phases, seed).events():
        while (due := sync.next_deadline_ns()) is not None and due < event.arrival_ns:
            take(due)
        true[event.camera, event.timestamp_ns] = event.exposure_ns
        outcome.delivered[round((event.exposure_ns - 1_000_000_000) / PERIOD_NS)] += 1
        sync.add(event.frame())
        take(event.arrival_ns)
    return outcome


def drifting(**more):
    """Four cameras with different clocks: offsets of seconds, ± 200 ppm."""
    clocks = ((0.0, 200.0), (5.0, -200.0), (-3.0, 50.0), (1e6, 0.0))
    return {f"cam{i}": Faults(offset_s=o, drift_ppm=d, **more) for i, (o, d) in enumerate(clocks)}


def test_sets_under_loss_and_jitter_of_arrivals():
    outcome = run(drifting(loss=0.05, jitter_ms=10.0), seconds=20.0)
    # A set is whole if it holds every frame that came of its instant, and none of another.
    whole = sum(
        len(own) == outcome.delivered[round((own.popitem()[1] - 1e9) / PERIOD_NS)]
        for own, spread in zip([dict(e) for e in outcome.exposures], outcome.spread_ms(), strict=True)
        if spread < 1
    )
    assert whole >= 0.99 * len(outcome.delivered)


def test_sets_under_jitter_of_exposures():
    outcome = run(drifting(loss=0.05, exposure_jitter_ms=10.0, jitter_ms=3.0))
    assert np.mean(outcome.spread_ms() <= 20.0) >= 0.99
    complete = sum(count == 4 for count in outcome.delivered.values())
    assert sum(len(s.frames) == 4 for s in outcome.sets) >= 0.97 * complete


def test_skew_is_the_true_spread_of_free_running_cameras():
    outcome = run(drifting(jitter_ms=5.0), phases=[0.0, 0.2, 0.45, -0.45])
    settled = slice(30, None)
    assert all(len(s.frames) == 4 for s in outcome.sets[30:-2])
    np.testing.assert_allclose([s.skew_ns * 1e-6 for s in outcome.sets[settled]], outcome.spread_ms()[settled], atol=3)
    # The largest gap between the phases parts the sets: 0.55 to 1.
    np.testing.assert_allclose(outcome.spread_ms()[30:-2], 0.55 * PERIOD_NS * 1e-6, atol=0.01)


def test_a_set_leaves_with_its_last_frame_or_when_its_wait_is_over():
    outcome = run(drifting(loss=0.05, jitter_ms=2.0))
    waits_ms = np.array(outcome.waits) * 1e-6
    full = np.array([len(s.frames) == 4 for s in outcome.sets])
    assert waits_ms[full][60:].max() == 0
    assert waits_ms.max() < 80
    assert all(b.timestamp_ns > a.timestamp_ns for a, b in itertools.pairwise(outcome.sets))


def test_the_first_set_is_whole_and_a_camera_that_never_comes_is_not_waited_for():
    outcome = run({"cam2": Faults(loss=1.0)}, phases=[0.0, 0.1, 0.2], count=3)
    assert [set(s.frames) for s in outcome.sets[:3]] == [{"cam0", "cam1"}] * 3
    assert max(outcome.waits[:20]) < 60e6
    assert max(outcome.waits[60:]) == 0


def test_duplicates_and_reordered_frames():
    outcome = run({"cam0": Faults(duplicate=0.2), "cam1": Faults(reorder=0.1)}, count=2)
    assert 20 < outcome.sync.counts("cam0").duplicates < 80
    counts = outcome.sync.counts("cam1")
    assert 10 < counts.reordered + counts.late < 45
    # A frame that comes after its successor misses its set at most; it never gets into another.
    assert outcome.spread_ms()[10:].max() < 1
    assert len(outcome.sets) >= 0.99 * SECONDS * RATE


def test_an_unplugged_camera_is_not_waited_for_and_comes_back_at_once():
    outcome = run({"cam1": Faults(unplugged=((3.0, 5.0),), offset_s=100.0)}, count=3)
    time_s = np.array([(s.timestamp_ns - 1_000_000_000) * 1e-9 for s in outcome.sets])
    has = np.array(["cam1" in s.frames for s in outcome.sets])
    assert has[(time_s > 1) & (time_s < 2.9)].all()
    assert not has[(time_s > 3.0) & (time_s < 5.0)].any()
    assert has[time_s > 5.4].all()
    waits_ms = np.array(outcome.waits) * 1e-6
    assert waits_ms[(time_s > 4.2) & (time_s < 4.9)].max() == 0
    assert outcome.sync.counts("cam1").outages == 1
    assert len(outcome.sets) >= 0.99 * SECONDS * RATE


def test_a_stuck_camera_holds_nobody_up():
    outcome = run({"cam0": Faults(stuck=((3.0, 5.0),))}, count=3)
    assert len(outcome.sets) >= 0.99 * SECONDS * RATE
    assert max(outcome.waits) < 80e6
    assert outcome.sync.counts("cam0").late == 1  # what the stuck call gave in the end
    assert outcome.spread_ms()[10:].max() < 1


@pytest.mark.parametrize("jump_s", [-100.0, -0.41, 1000.0])
def test_a_clock_that_jumps_is_back_soon(jump_s):
    outcome = run({"cam2": Faults(jumps=((3.0, jump_s),), jitter_ms=5.0)}, count=3)
    time_s = np.array([(s.timestamp_ns - 1_000_000_000) * 1e-9 for s in outcome.sets])
    has = np.array(["cam2" in s.frames for s in outcome.sets])
    assert has[time_s > 4.3].mean() > 0.99
    assert outcome.spread_ms()[10:].max() < 1
    clock = outcome.sync.clock("cam2")
    assert clock is not None and clock.restarts == 1


def test_the_reference_camera_may_die():
    outcome = run({"cam0": Faults(unplugged=((3.0, 100.0),))}, phases=[0.0, 0.3, 0.45], count=3)
    time_s = np.array([(s.timestamp_ns - 1_000_000_000) * 1e-9 for s in outcome.sets])
    after = (time_s > 3.2) & (time_s < 7.8)
    assert all(set(s.frames) == {"cam1", "cam2"} for s, late in zip(outcome.sets, after, strict=True) if late)
    assert after.sum() >= 0.99 * 4.6 * RATE


def test_cameras_are_added_and_removed_while_running():
    scene, sync, sizes = Ramp(2), Synchroniser(SyncSettings(RATE)), []
    sync.add_camera("cam0")
    for event in Simulation(scene, RATE, 9.0).events():
        second = (event.arrival_ns - 1_000_000_000) / 1e9
        if second > 3 and "cam1" not in sync.names and second < 6:
            sync.add_camera("cam1")
        if second > 6:
            sync.remove_camera("cam1")
        sync.add(event.frame())
        sizes += [(second, len(left.frames)) for left in sync.poll(event.arrival_ns)]
    assert {size for second, size in sizes if second < 3} == {1}
    assert {size for second, size in sizes if 3.1 < second < 6} == {2}
    assert {size for second, size in sizes if second > 6.1} == {1}
    with pytest.raises(InputError, match="already"):
        sync.add_camera("cam0")


def test_a_slow_camera_is_in_every_second_set_and_not_waited_for_in_the_others():
    sync, sets = Synchroniser(SyncSettings(RATE)), []
    for name in ("fast", "slow"):
        sync.add_camera(name)
    depth = np.zeros((1, 1), np.uint16)
    for i in range(300):
        now = round(i * PERIOD_NS) + 1_000_000_000
        sync.add(DepthFrame("fast", depth, now, "host", now))
        if i % 2 == 0:
            sync.add(DepthFrame("slow", depth, now, "host", now))
        sets += [(now, left) for left in sync.poll(now)]
    assert [len(left.frames) for _, left in sets[10:20]] == [2, 1] * 5
    assert all(now == left.frames["fast"].arrival_ns for now, left in sets[10:])
    assert sync.counts("slow").missing <= 2


def test_triggered_cameras_of_different_transport_have_no_skew():
    faults = {"cam0": Faults(delay_ms=2.0), "cam1": Faults(delay_ms=14.0)}
    free, wired = (run(faults, count=2, settings=SyncSettings(RATE, triggered=t)) for t in (False, True))
    assert free.sets[-10].skew_ns == pytest.approx(12e6, abs=1e6)
    assert max(s.skew_ns for s in wired.sets[100:]) < 1e6


def test_frames_too_far_from_their_set_are_left_out():
    outcome = run({}, phases=[0.0, 0.0, 0.4], count=3, settings=SyncSettings(RATE, max_skew_ms=5.0))
    assert all(set(s.frames) == {"cam0", "cam1"} for s in outcome.sets[10:-2])
    assert outcome.sync.counts("cam2").skewed > 200


def test_cameras_of_one_clock_share_its_estimate():
    depth = np.zeros((1, 1), np.uint16)
    skews = {}
    for clocks in (("ptp", "ptp"), ("a", "b")):
        sync = Synchroniser(SyncSettings(RATE))
        sync.add_camera("a")
        sync.add_camera("b")
        for i in range(30):
            now = round(i * PERIOD_NS)
            sync.add(DepthFrame("a", depth, now, clocks[0], now + 1_000_000))
            sync.add(DepthFrame("b", depth, now, clocks[1], now + 12_000_000))
        skews[clocks] = {left.skew_ns for left in sync.flush()}
    assert skews == {("ptp", "ptp"): {0}, ("a", "b"): {11_000_000}}


def test_a_known_latency_is_taken_off():
    faults = {"cam0": Faults(delay_ms=2.0), "cam1": Faults(delay_ms=14.0)}
    sync = Synchroniser(SyncSettings(RATE))
    sync.add_camera("cam0", latency_ms=2.0)
    sync.add_camera("cam1", latency_ms=14.0)
    for event in Simulation(Ramp(2), RATE, 1.0, faults).events():
        assert sync.add(event.frame()) == event.exposure_ns
    assert {left.skew_ns for left in sync.flush()} == {0}


def test_time_offsets_bring_late_and_early_cameras_into_one_set():
    sync, late_ns = Synchroniser(SyncSettings(RATE)), 250_000_000
    sync.add_camera("early", offset_ns=late_ns // 2)
    sync.add_camera("late", offset_ns=-late_ns // 2)
    frames = [
        DepthFrame(name, np.zeros((1, 1), np.uint16), number, name, round(number * PERIOD_NS) + shift_ns + 10**12)
        for number in range(60)
        for name, shift_ns in (("early", 0), ("late", late_ns))
    ]
    frames = [dataclasses.replace(frame, timestamp_ns=frame.arrival_ns) for frame in frames]
    sets = []
    for frame in sorted(frames, key=lambda frame: frame.arrival_ns):
        while (due_ns := sync.next_deadline_ns()) is not None and due_ns < frame.arrival_ns:
            sets += sync.poll(due_ns)
        sync.add(frame)
        sets += sync.poll(frame.arrival_ns)
    sets += sync.flush()
    assert len(sets) == 60
    assert {synced.skew_ns for synced in sets} == {0}
    assert all(set(synced.frames) == {"early", "late"} for synced in sets)
    with pytest.raises(InputError, match="time_offset_s of 3: sets of running cameras wait for at most 2 s"):
        sync.add_camera("other", offset_ns=3 * 10**9)


def test_frames_of_unknown_cameras_are_ignored():
    sync = Synchroniser()
    assert sync.add(DepthFrame("stranger", np.zeros((1, 1), np.uint16), 0, "host", 0)) is None
    assert sync.poll(10**12) == []
    assert sync.next_deadline_ns() is None


@pytest.mark.parametrize(
    ("name", "value", "limit"),
    [
        *(("rate_hz", value, "finite and above 0") for value in (0.0, -3.0, np.nan, np.inf)),
        *(("wait_ms", value, "finite and at least 0") for value in (-5.0, np.nan, np.inf)),
        *((name, value, "above 0") for name in ("lost_after_s", "max_skew_ms") for value in (0.0, np.nan)),
    ],
)
def test_bad_settings(name, value, limit):
    with pytest.raises(InputError, match=f"^{name} must be {limit}, got {value}$"):
        Synchroniser(SyncSettings(**{name: value}))
