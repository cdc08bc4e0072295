"""Status and statistics of a running motion capture, for the dashboard and the summary."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from depthmocap.offline.pipeline import STAGES
from depthmocap.realtime.ingest import FrameIngest
from depthmocap.realtime.meters import Meter


@dataclasses.dataclass(frozen=True)
class CameraStatus:
    """The current status of one camera.

    Attributes:
        state: what it does in a word, or why it does not run in a line.
        rate_hz: frames a second in the last second or so.
        drift_ppm: drift of its clock against the host's, in millionths.
        clock_restarts: jumps of its clock.
        counts: numbers of frames since the start, by outcome.
        opened_in_vain: number of failed attempts to open it, or to fit it to the rig.
    """

    name: str
    state: str
    rate_hz: float
    drift_ppm: float
    clock_restarts: int
    counts: dict[str, int]
    opened_in_vain: int = 0

    @property
    def lost(self) -> int:
        """Number of sets in which its frame is missing."""
        return self.counts["missing"]


class RunStatistics:
    """Statistics of the whole run and of its last seconds."""

    def __init__(self) -> None:
        self.poses = self.poses_with_people = 0
        self.latency, self.skew, self.frame = Meter(), Meter(), Meter()
        self.stages = {stage: Meter() for stage in STAGES}
        #: Number of sets with each person, by the person's number, and the people in the last set.
        self.people: dict[int, int] = {}
        self.present: tuple[int, ...] = ()

    def add(
        self,
        milliseconds: dict[str, float],
        latency_ms: float,
        skew_ms: float,
        visible: bool,
        present: tuple[int, ...] = (),
    ) -> None:
        """Add one pose.

        Args:
            milliseconds: time of each stage.
            skew_ms: time from the first to the last frame of the set.
            visible: whether a person was in view.
            present: numbers of the people in view.
        """
        self.poses += 1
        self.present = present
        for number in present:
            self.people[number] = self.people.get(number, 0) + 1
        self.poses_with_people += visible
        self.latency.add(latency_ms)
        self.skew.add(skew_ms)
        self.frame.add(sum(milliseconds.values()))
        for stage, value in milliseconds.items():
            self.stages[stage].add(value)

    def summary(self) -> dict[str, Any]:
        """Numbers of the whole run, by keys of ``exporting.summary.Summary``."""
        return {
            "frames": self.poses,
            "gaps": self.poses - self.poses_with_people,
            "frames_by_person": {str(number): count for number, count in sorted(self.people.items())},
            "latency_ms": self.latency.overall(),
            "skew_ms": self.skew.overall(),
            "ms_per_frame": self.frame.overall(),
            "ms_per_stage": {stage: meter.overall() for stage, meter in self.stages.items()},
        }


def camera_statuses(
    ingest: FrameIngest, states: dict[str, str], now_ns: int, failures: dict[str, int] | None = None
) -> list[CameraStatus]:
    """The status of all cameras, opened or not. ``failures``: number of failed attempts to open each."""
    statuses, failures = [], failures or {}
    for name, state in states.items():
        if name not in ingest.sync.names:
            counts = {"missing": 0, "late": 0, "frames": 0}
            statuses.append(CameraStatus(name, state, 0.0, math.nan, 0, counts, failures.get(name, 0)))
            continue
        clock, counts = ingest.sync.clock(name), dataclasses.asdict(ingest.sync.counts(name))
        rate_hz = ingest.sync.rate_hz(name, now_ns)
        if state == "running" and (fault := ingest.last_faults.get(name)):
            state = f"{fault}: left out"
        elif state == "running" and rate_hz == 0 and counts["frames"]:
            state = "no frames"
        counts |= dict(ingest.faults[name])
        drift_ppm, restarts = (clock.drift_ppm, clock.restarts) if clock else (math.nan, 0)
        statuses.append(CameraStatus(name, state, rate_hz, drift_ppm, restarts, counts, failures.get(name, 0)))
    return statuses
