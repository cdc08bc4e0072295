"""What a running motion capture tells of itself: for the dashboard, the summary and whoever asks."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from depthmocap.offline.pipeline import STAGES
from depthmocap.realtime.ingest import Intake
from depthmocap.realtime.meters import Meter


@dataclasses.dataclass(frozen=True)
class CameraStatus:
    """One camera now.

    Attributes:
        counts: of its frames since the start, by what became of them.
        opened_in_vain: how often it could not be opened, or did not fit the rig.
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
        """Places in sets that it should have filled and did not."""
        return self.counts["missing"]


class Books:
    """Numbers of the whole run and of its last seconds."""

    def __init__(self) -> None:
        self.poses = self.seen = 0
        self.latency, self.skew, self.frame = Meter(), Meter(), Meter()
        self.stages = {stage: Meter() for stage in STAGES}
        #: Sets in which each person was seen, by number, and who was seen in the last one.
        self.people: dict[int, int] = {}
        self.present: tuple[int, ...] = ()

    def add(
        self,
        milliseconds: dict[str, float],
        latency_ms: float,
        skew_ms: float,
        seen: bool,
        present: tuple[int, ...] = (),
    ) -> None:
        """Take one pose; ``seen``: somebody was in view; ``present``: their numbers."""
        self.poses += 1
        self.present = present
        for number in present:
            self.people[number] = self.people.get(number, 0) + 1
        self.seen += seen
        self.latency.add(latency_ms)
        self.skew.add(skew_ms)
        self.frame.add(sum(milliseconds.values()))
        for stage, value in milliseconds.items():
            self.stages[stage].add(value)

    def summary(self) -> dict[str, Any]:
        """Numbers of the whole run, by keys of ``export.summary.Summary``."""
        return {
            "frames": self.poses,
            "gaps": self.poses - self.seen,
            "frames_by_person": {str(number): count for number, count in sorted(self.people.items())},
            "latency_ms": self.latency.overall(),
            "skew_ms": self.skew.overall(),
            "ms_per_frame": self.frame.overall(),
            "ms_per_stage": {stage: meter.overall() for stage, meter in self.stages.items()},
        }


def camera_statuses(
    intake: Intake, states: dict[str, str], now_ns: int, failures: dict[str, int] | None = None
) -> list[CameraStatus]:
    """All cameras, opened or not. ``failures``: how often each was opened in vain."""
    found, failures = [], failures or {}
    for name, state in states.items():
        if name not in intake.sync.names:
            counts = {"missing": 0, "late": 0, "frames": 0}
            found.append(CameraStatus(name, state, 0.0, math.nan, 0, counts, failures.get(name, 0)))
            continue
        clock, counts = intake.sync.clock(name), dataclasses.asdict(intake.sync.counts(name))
        rate_hz = intake.sync.rate_hz(name, now_ns)
        if state == "running" and (fault := intake.ailing.get(name)):
            state = f"{fault}: left out"
        elif state == "running" and rate_hz == 0 and counts["frames"]:
            state = "no frames"
        counts |= dict(intake.faults[name])
        drift_ppm, restarts = (clock.drift_ppm, clock.restarts) if clock else (math.nan, 0)
        found.append(CameraStatus(name, state, rate_hz, drift_ppm, restarts, counts, failures.get(name, 0)))
    return found
