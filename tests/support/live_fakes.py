"""A capture's side of a live page: cameras' states, and controls that note what is asked."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from depthmocap.errors import InputError


@dataclasses.dataclass
class Status:
    """How a camera does."""

    name: str
    state: str = "running"
    rate_hz: float = 30.0
    counts: dict[str, int] = dataclasses.field(default_factory=dict)


class Controls:
    """Notes what is asked of a capture."""

    filters = ("none", "kalman", "one-euro")
    dropped, problems = 3, {"camera <b> was lost": 2}
    moved: tuple[str, ...] = ()

    def __init__(self) -> None:
        self.smoothing, self.people, self.poses = "kalman", 1, 0
        self.recording: Path | None = None
        self.asked: list[Any] = []

    def statuses(self) -> list[Status]:
        return [Status("cam0"), Status("cam1", rate_hz=12.0, counts={"late": 4}), Status("cam2", "was lost")]

    def apart_m(self) -> dict[str, float]:
        return {"cam0": 0.004}

    def record(self, name: str) -> None:
        if name == "bad":
            raise InputError("cannot be a file's name")
        self.recording = Path(f"{name}.mcap")

    def stop_recording(self) -> None:
        self.recording = None

    def smooth(self, name: str) -> None:
        self.smoothing = name

    def follow(self, people: int) -> None:
        self.people = people

    def learn_background(self) -> None:
        self.asked.append("background")

    def place_anew(self, name: str) -> str:
        self.asked.append(("place", name))
        return f"{name} is placed anew"

    def mark(self, text: str, timestamp_ns: int | None = None) -> None:
        self.asked.append((text, timestamp_ns))

    def stop(self) -> None:
        self.asked.append("stop")
