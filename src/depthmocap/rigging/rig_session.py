"""Cameras that are being set up: they are read and looked at, and placed anew again and again from what was seen.

Three kinds of threads: those of the cameras only hand frames on, one looks at the newest set, and one places the
cameras. A set that comes while the last is looked at is left out, so that nothing waits and nothing piles up.
"""

from __future__ import annotations

import collections
import dataclasses
import threading
import time
from collections.abc import Mapping, Sequence

import numpy as np

from depthmocap.calibration.calibrate import Calibration, solve_rig
from depthmocap.calibration.verdict import FEW_POSES
from depthmocap.cameras.source import DepthSource
from depthmocap.classify.classifier import Classifier
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera
from depthmocap.realtime.status import CameraStatus
from depthmocap.realtime.sync import SyncedSet, SyncSettings
from depthmocap.realtime.synced_reader import SyncedReader
from depthmocap.rigging.floor_map import FloorMap, advice, draw_map
from depthmocap.rigging.rig_faults import camera_faults, same_pictures, same_views
from depthmocap.rigging.walk_observer import Sight, WalkObserver

#: Most sets a second that are looked at, as by ``calibrate``.
RATE_HZ = 10.0
#: How long a set waits for a camera (milliseconds): nothing is shown with it, and a set without a camera is lost for
#: all its pairs, as on a machine that is busy with placing.
WAIT_MS = 300.0
#: Seconds from the end of one placing to the beginning of the next,
PAUSE_S = 2.0
#: which waits for this growth of the number of sets.
GROWTH = 1.15
#: So many placings in a row must be good.
GOOD_IN_A_ROW = 2


@dataclasses.dataclass(frozen=True, eq=False)
class RigState:
    """What is known of the rig so far; nothing in it changes.

    Attributes:
        statuses: of the cameras.
        cameras: that were opened, by name.
        sights: the last frame of each.
        seen: by camera, frames that show the person, and all that were looked at.
        faults: what is wrong, by camera.
        problems: what is wrong besides, one line each.
        calibration: the last one; None until two cameras could be placed.
        drawn: the map of the floor by it.
        advice: where to walk next, in a line.
        placings: calibrations so far.
        good: the rig is good, and all cameras are in it.
        ended: no more frames come, and everything was looked at.
    """

    statuses: tuple[CameraStatus, ...]
    cameras: Mapping[str, DepthCamera]
    sights: Mapping[str, Sight]
    seen: Mapping[str, tuple[int, int]]
    faults: Mapping[str, str]
    problems: tuple[str, ...]
    calibration: Calibration | None
    drawn: FloorMap | None
    advice: str
    placings: int
    good: bool
    ended: bool

    def pair_lines(self) -> list[tuple[str, str]]:
        """Every pair of cameras by name, and how well it is known."""
        if self.calibration is None:
            return []
        return [
            (
                " – ".join(pair.cameras),
                f"± {pair.uncertainty_mm:.1f} mm, {pair.uncertainty_deg:.2f}°: {pair.grade}",
            )
            for pair in self.calibration.pairs
        ]


def seen_enough(calibration: Calibration) -> bool:
    """Whether every camera shares so many poses with another that ``calibrate`` would not ask for more."""
    most = collections.Counter[str]()
    for pair in calibration.pairs:
        for name in pair.cameras:
            most[name] = max(most[name], pair.shared_poses)
    return min(most.values(), default=0) >= FEW_POSES


class RigSession:
    """Cameras that are being set up; a context manager."""

    def __init__(self, sources: Sequence[DepthSource], classifier: Classifier, seed: int = 0) -> None:
        self._sources, self._classifier, self._seed = list(sources), classifier, seed
        self.reader = SyncedReader(sources, sync=SyncSettings(wait_ms=WAIT_MS))
        self._walk: WalkObserver | None = None
        self._lock = threading.Lock()
        self._calibration: Calibration | None = None
        self._drawn: FloorMap | None = None
        self._lack = ""
        self._problems: tuple[str, ...] = ()
        self._placings = self._good_in_a_row = 0
        self._failure: BaseException | None = None
        self._ended = self._placed_all = False
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self._guarded, args=(run,), name=name, daemon=True)
            for name, run in (("walk", self._look), ("placing", self._place))
        ]

    def __enter__(self) -> RigSession:
        """Open the cameras and begin.

        Raises:
            InputError: when no camera can be opened.
        """
        self.reader.start()
        known = {}
        for source in self._sources:
            camera, raw = self.reader.camera(source.name), source.raw_background
            if camera is not None and raw is not None:
                known[source.name] = camera.to_metres(raw)
        self._walk = WalkObserver(self._classifier, known)
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End reading; what was placed so far stays."""
        self._stop.set()
        self.reader.stop()
        for thread in self._threads:
            if thread.is_alive() and thread is not threading.current_thread():
                thread.join()

    def state(self) -> RigState:
        """What is known so far.

        Raises:
            BaseException: what a thread has failed with.
        """
        if self._failure is not None:
            raise self._failure
        assert self._walk is not None
        statuses, sights, seen = tuple(self.reader.statuses()), self._walk.sights, self._walk.seen
        with self._lock:
            calibration, drawn, lack = self._calibration, self._drawn, self._lack
            placings, row, ended = self._placings, self._good_in_a_row, self._placed_all
            problems = self._problems
        names = [status.name for status in statuses]
        return RigState(
            statuses, self.reader.cameras, sights, seen, camera_faults(statuses, sights, seen),
            (*same_pictures(sights), *problems), calibration, drawn, advice(names, seen, calibration, drawn, lack),
            placings, row >= GOOD_IN_A_ROW, ended,
        )  # fmt: skip

    def place_now(self) -> None:
        """Place the cameras from everything seen so far, in this thread; the last placing stays where that fails."""
        self._place_once()

    def _guarded(self, run: object) -> None:
        try:
            assert callable(run)
            run()
        except BaseException as error:  # ``state`` raises it again
            self._failure = error

    def _look(self) -> None:
        last_ns = -(1 << 62)
        for synced in self.reader.sets():
            if self._stop.is_set():
                break
            # A little less than the period, or every second set of cameras at this very rate would be left out.
            if synced.timestamp_ns - last_ns >= 0.8e9 / RATE_HZ:
                last_ns = synced.timestamp_ns
                self._take(synced)
        self._ended = True

    def _take(self, synced: SyncedSet) -> None:
        assert self._walk is not None
        for name, camera in self.reader.cameras.items():
            if name in synced.frames:
                self._walk.add(camera, synced.frames[name].raw, synced.times_ns[name] * 1e-9)

    def _place(self) -> None:
        assert self._walk is not None
        placed, next_s = 0, 0.0
        while not self._stop.is_set():
            ended = self._ended
            count = sum(seen for seen, _ in self._walk.seen.values())
            if count and (ended or (count >= GROWTH * placed + 8 and time.monotonic() >= next_s)):
                self._place_once()
                placed, next_s = count, time.monotonic() + PAUSE_S
            if ended:
                break
            self._stop.wait(0.1)
        self._placed_all = self._ended

    def _place_once(self) -> None:
        assert self._walk is not None
        observations = self._walk.observations()
        if len(observations) < 2:
            with self._lock:
                self._lack = "two cameras or more are needed"
            return
        try:
            calibration = solve_rig("so far", observations, [], np.random.default_rng(self._seed))
        except InputError as error:
            with self._lock:
                self._lack = str(error).removeprefix("so far: ")
                self._good_in_a_row = 0
            return
        drawn = draw_map(calibration, observations)
        good = calibration.grade == "good" and not calibration.unplaced
        good = good and len(calibration.rig.cameras) == len(self.reader.cameras) and seen_enough(calibration)
        with self._lock:
            self._calibration, self._drawn = calibration, drawn
            self._problems = tuple([*same_views(calibration.rig), *calibration.warnings])
            self._placings += 1
            self._good_in_a_row = self._good_in_a_row + 1 if good else 0
