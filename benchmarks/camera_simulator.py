"""Simulated depth cameras with the faults of real ones, in virtual or in real time.

``Simulation`` gives all deliveries of the cameras in order of arrival, with their ground truth, without waiting.
``SimulatedCamera`` is one of them as a source that delivers in real time.
"""

from __future__ import annotations

import dataclasses
import functools
import heapq
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, UInt16
from numpy import ndarray

from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FrameTimeoutError
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet
from depthmocap.geometry import DepthCamera, Rig

#: Stretches of time (from, to) in seconds since the start.
Stretches = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class Faults:
    """Faults of one camera. Shares are of frames; stretches are (from, to) in seconds since the start.

    Attributes:
        offset_s, drift_ppm: offset of the camera's clock from the host's at the start, and its drift.
        jumps: (at, by) in seconds: jumps of the clock.
        delay_ms, jitter_ms: arrivals are late by delay + jitter ± jitter, uniformly distributed.
        exposure_jitter_ms: largest jitter of the exposures; timestamps contain it.
        loss, duplicate: share of frames that never arrive, or arrive twice.
        reorder: share of frames that arrive right after the next one.
        frozen, garbage, dark: stretches with a constant picture, with noise, without valid depth.
        stuck: a call does not return; the last frame of the stretch arrives at its end, the others never.
        unplugged: no frames; afterwards the camera's clock starts at zero.
    """

    offset_s: float = 0.0
    drift_ppm: float = 0.0
    jumps: tuple[tuple[float, float], ...] = ()
    delay_ms: float = 5.0
    jitter_ms: float = 0.0
    exposure_jitter_ms: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    frozen: Stretches = ()
    garbage: Stretches = ()
    dark: Stretches = ()
    stuck: Stretches = ()
    unplugged: Stretches = ()

    def __post_init__(self) -> None:
        if not all(0 <= share <= 1 for share in (self.loss, self.duplicate, self.reorder)):
            raise InputError(f"loss, duplicate and reorder are shares from 0 to 1, got {self}")
        if min(self.delay_ms, self.jitter_ms, self.exposure_jitter_ms) < 0:
            raise InputError(f"delay_ms, jitter_ms and exposure_jitter_ms must not be negative, got {self}")


@runtime_checkable
class Scene(Protocol):
    """The cameras' scene: raw depth of a camera at a time in seconds."""

    @property
    def rig(self) -> Rig: ...

    def depth(self, camera: str, time_s: float) -> UInt16[ndarray, "h w"]: ...


@dataclasses.dataclass(frozen=True, eq=False)
class Event:
    """One delivery: the camera's timestamp, the time of arrival on the host, and the true time of exposure."""

    camera: str
    timestamp_ns: int
    arrival_ns: int
    exposure_ns: int
    load: Callable[[], UInt16[ndarray, "h w"]]

    def frame(self, arrival_ns: int | None = None) -> DepthFrame:
        """The frame as the host gets it, at its time of arrival or at another."""
        clock = f"clock of {self.camera}"
        arrival_ns = self.arrival_ns if arrival_ns is None else arrival_ns
        return DepthFrame(self.camera, self.load(), self.timestamp_ns, clock, arrival_ns)


class RecordedScene:
    """A recording played forwards and backwards without end, so that it has no jump; held in memory."""

    def __init__(self, source: Iterable[FrameSet], rig: Rig, rate_hz: float, sets: int | None = None) -> None:
        """Read the first ``sets`` sets, all by default; a missing frame of a camera repeats the one before.

        Raises:
            InputError: when a camera of the rig has no frame.
        """
        self.rig, self._rate_hz = rig, rate_hz
        self._frames: dict[str, list[ndarray]] = {name: [] for name in rig.names}
        for i, frames in enumerate(source):
            if sets is not None and i >= sets:
                break
            for view in frames.views:
                raw = np.round(view.depth_m / view.camera.depth_unit_m).astype(np.uint16)
                camera_frames = self._frames[view.camera.name]
                camera_frames.extend([raw] * (i + 1 - len(camera_frames)))
        for name, camera_frames in self._frames.items():
            if not camera_frames:
                raise InputError(f"camera {name!r} has no frames to simulate it with: take it out of the rig")

    def depth(self, camera: str, time_s: float) -> UInt16[ndarray, "h w"]:
        """The recorded frame of a time (seconds, not negative)."""
        frames = self._frames[camera]
        around = round(time_s * self._rate_hz) % max(2 * len(frames) - 2, 1)
        return frames[min(around, 2 * len(frames) - 2 - around)] if around >= len(frames) else frames[around]


@dataclasses.dataclass(frozen=True, eq=False)
class Simulation:
    """Simulated cameras of a scene.

    Attributes:
        faults: by camera; none for cameras that are not named.
        phases: phase of each camera's exposures, as a share of the period; by default they expose together.
        start_ns: host time at the start.
    """

    scene: Scene
    rate_hz: float
    seconds: float
    faults: Mapping[str, Faults] = dataclasses.field(default_factory=dict)
    phases: Sequence[float] | None = None
    seed: int = 0
    start_ns: int = 1_000_000_000

    def __post_init__(self) -> None:
        names = self.scene.rig.names
        if unknown := set(self.faults) - set(names):
            raise InputError(f"faults of cameras {sorted(unknown)}, but the cameras are {', '.join(names)}")
        if self.phases is not None and len(self.phases) != len(names):
            raise InputError(f"{len(self.phases)} phases for {len(names)} cameras")

    def events(self) -> Iterator[Event]:
        """All deliveries of all cameras, in order of arrival."""
        streams = [self.camera_events(name) for name in self.scene.rig.names]
        return heapq.merge(*streams, key=lambda event: event.arrival_ns)

    def camera_events(self, name: str) -> Iterator[Event]:
        """The deliveries of one camera, in order of arrival."""
        faults, index = self.faults.get(name, Faults()), self.scene.rig.names.index(name)
        rng = np.random.default_rng([self.seed, index])
        count = int(self.seconds * self.rate_hz)
        jitter_s = faults.exposure_jitter_ms * 1e-3
        exposure_s = (np.arange(count) + (self.phases[index] if self.phases is not None else 0)) / self.rate_hz
        exposure_s += rng.uniform(-jitter_s, jitter_s, count)
        arrival_s, kept = _deliveries(exposure_s, faults, rng)
        device_s = _device_time(exposure_s, faults)
        twice = rng.random(count) < faults.duplicate
        for i in np.argsort(arrival_s, kind="stable").tolist():
            if not kept[i]:
                continue
            event = Event(
                name,
                round(float(device_s[i]) * 1e9),
                self.start_ns + round(float(arrival_s[i]) * 1e9),
                self.start_ns + round(float(exposure_s[i]) * 1e9),
                functools.partial(self._picture, name, float(exposure_s[i]), (self.seed, index, i)),
            )
            yield event
            if twice[i]:
                yield event

    def _picture(self, name: str, time_s: float, seed: tuple[int, ...]) -> UInt16[ndarray, "h w"]:
        faults, camera = self.faults.get(name, Faults()), self.scene.rig[name]
        if _within(time_s, faults.dark):
            return np.zeros((camera.height, camera.width), np.uint16)
        if _within(time_s, faults.garbage):
            return np.random.default_rng(seed).integers(0, 2**16, (camera.height, camera.width), dtype=np.uint16)
        for from_s, to_s in faults.frozen:
            if from_s <= time_s < to_s:
                time_s = from_s
        return self.scene.depth(name, max(time_s, 0.0))


def _deliveries(
    exposure_s: Float[ndarray, " n"], faults: Faults, rng: np.random.Generator
) -> tuple[Float[ndarray, " n"], Bool[ndarray, " n"]]:
    """Time of arrival of each frame, and whether it arrives."""
    count = len(exposure_s)
    arrival_s = exposure_s + (faults.delay_ms + rng.uniform(0, 2, count) * faults.jitter_ms) * 1e-3
    kept = (rng.random(count) >= faults.loss) & ~_within(exposure_s, faults.unplugged)
    for from_s, to_s in faults.stuck:
        blocked = np.flatnonzero((exposure_s >= from_s) & (exposure_s < to_s) & kept)
        kept[blocked[:-1]] = False
        arrival_s[blocked[-1:]] = to_s
    late = np.flatnonzero(rng.random(count - 1) < faults.reorder)
    arrival_s[late] = arrival_s[late + 1] + 1e-4
    return arrival_s, kept


def _device_time(exposure_s: Float[ndarray, " n"], faults: Faults) -> Float[ndarray, " n"]:
    """The camera's own clock at each exposure, seconds."""
    rate = 1 + faults.drift_ppm * 1e-6
    device_s = exposure_s * rate + faults.offset_s
    for _, back_s in faults.unplugged:
        again = exposure_s >= back_s
        device_s[again] = (exposure_s[again] - back_s) * rate
    for at_s, by_s in faults.jumps:
        until_s = min((back_s for _, back_s in faults.unplugged if back_s > at_s), default=np.inf)
        device_s[(exposure_s >= at_s) & (exposure_s < until_s)] += by_s
    return device_s


def _within(times_s: Any, stretches: Stretches) -> Any:
    """Whether a time, or each of an array of them, is in a stretch."""
    inside = np.zeros(np.shape(times_s), bool)
    for from_s, to_s in stretches:
        inside |= (times_s >= from_s) & (times_s < to_s)
    return inside


class SimulatedCamera(DepthSource):
    """One camera of a simulation as a source, in real time from ``zero_ns`` (``time.monotonic_ns``) on.

    An unplugged camera is lost and cannot be opened. A stuck call returns only at the end of the stretch.
    """

    def __init__(self, simulation: Simulation, name: str, zero_ns: int) -> None:
        super().__init__(name)
        self.up = simulation.scene.rig.up
        self._simulation, self._zero_ns = simulation, zero_ns
        self._faults = simulation.faults.get(name, Faults())
        self._events = simulation.camera_events(name)
        self._next: Event | None = next(self._events, None)
        self._lost = False

    def _now_s(self) -> float:
        return (time.monotonic_ns() - self._zero_ns) * 1e-9

    def _check(self) -> None:
        if _within(self._now_s(), self._faults.unplugged):
            self._lost = True
            raise CameraError(f"camera {self.name!r} is not connected")

    def _due_s(self, event: Event) -> float:
        return (event.arrival_ns - self._simulation.start_ns) * 1e-9

    def _open(self) -> DepthCamera:
        self._check()
        # Frames that were not read before the loss are gone.
        while self._lost and self._next is not None and self._due_s(self._next) < self._now_s():
            self._next = next(self._events, None)
        self._lost = False
        return self._simulation.scene.rig[self.name]

    def _read(self, timeout_s: float) -> DepthFrame | None:
        give_up_s = self._now_s() + timeout_s
        while (event := self._next) is not None:
            self._check()
            due_s = self._due_s(event)
            for from_s, to_s in self._faults.stuck:
                if from_s <= self._now_s() < to_s:
                    time.sleep(to_s - self._now_s())
            if (now_s := self._now_s()) >= due_s:
                self._next = next(self._events, None)
                return event.frame(time.monotonic_ns())
            if now_s >= give_up_s:
                raise FrameTimeoutError(f"camera {self.name!r} gave nothing for {timeout_s:.1f} s")
            time.sleep(max(min(due_s, give_up_s, now_s + 0.1) - now_s, 0))
        return None

    def _close(self) -> None:
        """Nothing is held open."""
