"""Frames of several cameras into sets of one instant, as they arrive.

Timestamps become host time by a ``ClockTracker`` for each clock that frames name. Host time is cut into places, one a
frame period, which follow one of the cameras; the others keep a phase to them, followed as well. A frame belongs to the
place nearest to its time less its camera's phase, so that free-running cameras never flutter between two sets, whatever
their phase and jitter, and a frame more or less of one camera moves no other. A set leaves when all cameras it can
expect have delivered, or when its wait is over; sets leave in order, and a frame that comes later than its set is
dropped.
"""

from __future__ import annotations

import collections
import dataclasses
import statistics
from collections.abc import Mapping

from depthmocap.cameras.source import DepthFrame
from depthmocap.core.settings import check_above_0, check_at_least
from depthmocap.errors import InputError
from depthmocap.realtime.clock import ClockTracker

#: The last so many frames count for rates and strides, and are compared for duplicates.
RECENT = 30
#: Places and phases follow a camera's times by at least this share of the error a frame.
GAIN = 1 / 16
#: The rate may differ from the nominal one by this share.
RATE_RANGE = 0.02
#: A camera moves on to the next place when that brings the frames of a set nearer to each other by this share of a
#: period; not for less, so that it does not flutter there.
WORTH_MOVING = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class SyncedSet:
    """Frames of one instant, by camera name.

    Attributes:
        timestamp_ns: host time of the instant: the median of the frames' times.
        times_ns: each frame's time of exposure on the host's clock.
        skew_ns: from the first to the last of these times.
        missing: cameras that run but have no frame here.
    """

    timestamp_ns: int
    frames: Mapping[str, DepthFrame]
    times_ns: Mapping[str, int]
    skew_ns: int
    missing: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class SyncSettings:
    """How frames become sets.

    Attributes:
        rate_hz: sets a second: the rate of the fastest camera.
        wait_ms: how long a set waits for frames after the last of them should have come.
        lost_after_s: a camera silent for so long is not waited for until it delivers again.
        max_skew_ms: frames further from the median of their set are left out; None for half a period.
        triggered: the cameras expose together, by a wire: constant differences between them are of the transport, and
            are taken off.
    """

    rate_hz: float = 30.0
    wait_ms: float = 40.0
    lost_after_s: float = 1.0
    max_skew_ms: float | None = None
    triggered: bool = False


@dataclasses.dataclass
class CameraCounts:
    """What became of a camera's frames so far.

    Attributes:
        frames: received. ``used``: in sets that left. ``missing``: sets that left without this camera while it ran.
        late: after their set had left. ``surplus``: more than one a place. ``duplicates``: of one timestamp.
        reordered: after a later frame, yet in time. ``unsure``: while the clock seemed to jump. ``skewed``: too far
            from their set. ``outages``: times that the camera fell silent.
    """

    frames: int = 0
    used: int = 0
    missing: int = 0
    late: int = 0
    surplus: int = 0
    duplicates: int = 0
    reordered: int = 0
    unsure: int = 0
    skewed: int = 0
    outages: int = 0


class _Camera:
    """What is known of one camera."""

    def __init__(self, latency_ns: int) -> None:
        self.latency_ns, self.counts = latency_ns, CameraCounts()
        self.clock: ClockTracker | None = None
        self.arrivals: collections.deque[int] = collections.deque(maxlen=RECENT)
        self.timestamps: collections.deque[int] = collections.deque(maxlen=RECENT)
        self.silent = True
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget phase and stride: after a start, a silence, or a jump of the clock."""
        self.phase_ns, self.seen = 0.0, 0
        self.restarts = 0 if self.clock is None else self.clock.restarts
        self.last_place: int | None = None
        self.steps: collections.deque[int] = collections.deque(maxlen=RECENT)

    @property
    def stride(self) -> int:
        """Places from one frame to the next; the median, so that losses do not count."""
        return statistics.median_low(self.steps) if self.steps else 1


class Synchroniser:
    """Takes arrivals and gives sets. Single-threaded; time is what the caller says it is."""

    def __init__(self, settings: SyncSettings | None = None) -> None:
        """
        Raises:
            InputError: for a setting that cannot be.
        """
        self.settings = settings or SyncSettings()
        s = self.settings
        check_above_0({"rate_hz": s.rate_hz})
        check_at_least(0, {"wait_ms": s.wait_ms})
        for name in ("lost_after_s", "max_skew_ms"):
            if (value := getattr(s, name)) is not None and not value > 0:
                raise InputError(f"{name} must be above 0, got {value}")
        self._nominal_ns = self._period_ns = 1e9 / s.rate_hz
        self._cameras: dict[str, _Camera] = {}
        self._clocks: dict[str, ClockTracker] = {}
        self._open: dict[int, dict[str, tuple[int, DepthFrame]]] = {}
        self._anchor: tuple[int, float] | None = None  # a place and its host time
        self._reference = ""
        self._released: int | None = None
        self._last_ns: int | None = None
        self._first_arrival_ns: int | None = None

    def add_camera(self, name: str, latency_ms: float = 0.0) -> None:
        """Expect frames of a camera from now on.

        Args:
            latency_ms: least time from exposure to arrival, which no clock tells. It matters where makes differ in it.

        Raises:
            InputError: when the camera is there already.
        """
        if name in self._cameras:
            raise InputError(f"camera {name!r} is there already: names must differ")
        self._cameras[name] = _Camera(round(latency_ms * 1e6))

    def remove_camera(self, name: str) -> None:
        """Neither expect nor take frames of a camera any more; what it delivered goes with its sets."""
        self._cameras.pop(name, None)

    @property
    def names(self) -> tuple[str, ...]:
        """The cameras, in the order they were added."""
        return tuple(self._cameras)

    def counts(self, name: str) -> CameraCounts:
        """What became of a camera's frames."""
        return self._cameras[name].counts

    def clock(self, name: str) -> ClockTracker | None:
        """A camera's clock; None before its first frame."""
        return self._cameras[name].clock

    def rate_hz(self, name: str, now_ns: int) -> float:
        """Frames a second of a camera's last second or so; 0 while it is silent."""
        arrivals = self._cameras[name].arrivals
        if not self._runs(self._cameras[name], now_ns) or len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
            return 0.0
        return (len(arrivals) - 1) * 1e9 / (arrivals[-1] - arrivals[0])

    def add(self, frame: DepthFrame) -> int | None:
        """Take one frame; frames of cameras that were not added are ignored.

        Returns:
            Its time of exposure on the host's clock; None where it is a duplicate or its clock cannot be believed.
        """
        camera = self._cameras.get(frame.camera)
        if camera is None:
            return None
        if self._first_arrival_ns is None:
            self._first_arrival_ns = frame.arrival_ns
        counts = camera.counts
        counts.frames += 1
        if frame.timestamp_ns in camera.timestamps:
            counts.duplicates += 1
            return None
        if camera.silent or not self._runs(camera, frame.arrival_ns):
            camera.begin_anew()
            camera.timestamps.clear()
            camera.arrivals.clear()
            camera.silent = False
        camera.arrivals.append(frame.arrival_ns)
        camera.timestamps.append(frame.timestamp_ns)
        camera.clock = self._clocks.setdefault(frame.clock, ClockTracker())
        host_ns = camera.clock.update(frame.timestamp_ns, frame.arrival_ns)
        if camera.restarts != camera.clock.restarts:
            camera.begin_anew()
        if host_ns is None:
            counts.unsure += 1
            return None
        host_ns -= camera.latency_ns
        self._put(camera, frame, host_ns)
        return host_ns

    def poll(self, now_ns: int) -> list[SyncedSet]:
        """The sets that are complete, or have waited long enough, at a host time; in order."""
        for camera in self._cameras.values():
            if not camera.silent and not self._runs(camera, now_ns):
                camera.silent = True
                camera.counts.outages += 1
        sets = []
        for place in sorted(self._open):
            if now_ns < self._deadline_ns(place) and any(
                self._may_come(name, camera, place, now_ns) for name, camera in self._cameras.items()
            ):
                break
            sets.append(self._release(place))
        return [left for left in sets if left is not None]

    def next_deadline_ns(self) -> int | None:
        """Host time at which ``poll`` has something to give even if no frame comes; None if nothing is open."""
        return self._deadline_ns(min(self._open)) if self._open else None

    def flush(self) -> list[SyncedSet]:
        """All sets that are still open: at the end of a recording."""
        return [left for place in sorted(self._open) if (left := self._release(place)) is not None]

    def _runs(self, camera: _Camera, now_ns: int) -> bool:
        return bool(camera.arrivals) and now_ns - camera.arrivals[-1] <= self.settings.lost_after_s * 1e9

    def _place_ns(self, place: int) -> float:
        assert self._anchor is not None
        return self._anchor[1] + (place - self._anchor[0]) * self._period_ns

    def _deadline_ns(self, place: int) -> int:
        phases = [camera.phase_ns for camera in self._cameras.values() if not camera.silent]
        return round(self._place_ns(place) + max(phases, default=0) + self.settings.wait_ms * 1e6)

    def _may_come(self, name: str, camera: _Camera, place: int, now_ns: int) -> bool:
        """Whether a set should wait for a camera: it runs, has not delivered, and its next frame may belong here.

        At the start, cameras that have not delivered yet count as running.
        """
        if not camera.counts.frames and self._first_arrival_ns is not None:
            return now_ns - self._first_arrival_ns <= self.settings.lost_after_s * 1e9
        if camera.silent or name in self._open[place]:
            return False
        return camera.last_place is None or place >= camera.last_place + camera.stride

    def _put(self, camera: _Camera, frame: DepthFrame, host_ns: int) -> None:
        if self._anchor is None:
            self._anchor, self._reference = (0, float(host_ns)), frame.camera
        place = self._follow(camera, frame.camera, host_ns)
        if camera.last_place is not None and place > camera.last_place:
            camera.steps.append(place - camera.last_place)
        reordered = camera.last_place is not None and place < camera.last_place
        camera.last_place = place if camera.last_place is None else max(place, camera.last_place)
        if self._released is not None and place <= self._released:
            camera.counts.late += 1
            return
        camera.counts.reordered += reordered
        frames = self._open.setdefault(place, {})
        due_ns = self._place_ns(place) + camera.phase_ns
        if frame.camera in frames:
            camera.counts.surplus += 1
            if abs(frames[frame.camera][0] - due_ns) <= abs(host_ns - due_ns):
                return
        frames[frame.camera] = (host_ns, frame)

    def _follow(self, camera: _Camera, name: str, host_ns: int) -> int:
        """The place of a frame; the places follow the reference camera, and a camera's phase follows its frames."""
        assert self._anchor is not None
        reference = self._cameras.get(self._reference)
        if name != self._reference and (reference is None or reference.silent or reference.seen < camera.seen // 2):
            self._reference, reference = name, camera
        elapsed = (host_ns - camera.phase_ns - self._anchor[1]) / self._period_ns
        place = self._anchor[0] + round(elapsed)
        error_ns = host_ns - camera.phase_ns - self._place_ns(place)
        camera.seen += 1
        gain = max(1 / camera.seen, GAIN)
        if name == self._reference:
            if place > self._anchor[0]:
                # The rate is trimmed by much less than the phase, which keeps the loop from swinging.
                period_ns = self._period_ns + GAIN**2 / 4 * error_ns / (place - self._anchor[0])
                low, high = (1 - RATE_RANGE) * self._nominal_ns, (1 + RATE_RANGE) * self._nominal_ns
                self._anchor = (place, self._place_ns(place) + gain * error_ns)
                self._period_ns = min(max(period_ns, low), high)
        else:
            camera.phase_ns += gain * error_ns
        camera.phase_ns = self._nearest_phase(camera)
        return place

    def _nearest_phase(self, camera: _Camera) -> float:
        """The camera's phase, or the same a period away if that is much nearer to the others'."""
        others = [other.phase_ns for other in self._cameras.values() if other is not camera and not other.silent]
        if not others:
            return camera.phase_ns
        low, high, phase = min(others), max(others), camera.phase_ns
        moved = phase - self._period_ns if phase > (low + high) / 2 else phase + self._period_ns
        gain = max(phase, high) - min(phase, low) - (max(moved, high) - min(moved, low))
        return moved if gain > WORTH_MOVING * self._period_ns else phase

    def _release(self, place: int) -> SyncedSet | None:
        self._released = place
        found = self._open.pop(place)
        phases = {name: self._cameras[name].phase_ns if name in self._cameras else 0.0 for name in found}
        times = {
            name: host_ns - (round(phases[name]) if self.settings.triggered else 0)
            for name, (host_ns, _) in found.items()
        }
        middle_ns = round(statistics.median(times.values()))
        limit_ns = self._period_ns / 2 if self.settings.max_skew_ms is None else self.settings.max_skew_ms * 1e6
        kept = {name for name, time_ns in times.items() if abs(time_ns - middle_ns) <= limit_ns}
        for name in found.keys() & self._cameras.keys():
            counts = self._cameras[name].counts
            counts.used += name in kept
            counts.skewed += name not in kept
        missing = tuple(
            name
            for name, camera in self._cameras.items()
            if name not in found
            and not camera.silent
            and camera.last_place is not None
            and (place - camera.last_place) % camera.stride == 0
        )
        for name in missing:
            self._cameras[name].counts.missing += 1
        if not kept:
            return None
        times = {name: time_ns for name, time_ns in times.items() if name in kept}
        timestamp_ns = round(statistics.median(times.values()))
        if self._last_ns is not None:  # time advances even when a clock was corrected backwards
            timestamp_ns = max(timestamp_ns, self._last_ns + 1)
        self._last_ns = timestamp_ns
        frames = {name: found[name][1] for name in times}
        return SyncedSet(timestamp_ns, frames, times, max(times.values()) - min(times.values()), missing)
