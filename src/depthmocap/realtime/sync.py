"""Groups the frames of several cameras into sets of one instant while they arrive.

A ``ClockTracker`` for each named clock converts timestamps to host time. Host time is divided into slots, one for each
frame period. The slots follow one reference camera, and every other camera has a phase to them, which is tracked. A
frame belongs to the slot nearest to its time minus its camera's phase. So free-running cameras never alternate between
two sets, whatever their phase and jitter, and an extra or missing frame of one camera does not move the others. A set
is released when all expected cameras have delivered, or when its waiting time is over. Sets are released in order, and
a frame that comes after its set is dropped.
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

#: Number of latest frames from which rates and strides are computed, and which are compared for duplicates.
RECENT = 30
#: Smallest share of the timing error by which slots and phases are corrected with each frame.
GAIN = 1 / 16
#: The rate may differ from the nominal one by this share.
RATE_RANGE = 0.02
#: Longest time offset of a camera (ns), because frames of the others wait for it.
LONGEST_OFFSET_NS = 2_000_000_000
#: A camera moves to the next slot if this brings the frames of a set closer together by at least this share of a
#: period. A smaller gain is ignored, so that the camera does not alternate.
MIN_MOVE_GAIN = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class SyncedSet:
    """Frames of one instant, by camera name.

    Attributes:
        timestamp_ns: host time of the instant: the median of the frames' times.
        times_ns: each frame's time of exposure on the host's clock.
        skew_ns: time from the first to the last of these times.
        missing: running cameras without a frame in this set.
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
        wait_ms: how long a set waits for missing frames after the last of them was due.
        lost_after_s: sets do not wait for a camera that is silent for longer, until it delivers again.
        max_skew_ms: frames further from the median of their set are left out; None means half a period.
        triggered: the cameras expose together, by a trigger wire. Constant differences between their times come from
            the transport, and are subtracted.
    """

    rate_hz: float = 30.0
    wait_ms: float = 40.0
    lost_after_s: float = 1.0
    max_skew_ms: float | None = None
    triggered: bool = False


@dataclasses.dataclass
class CameraCounts:
    """Numbers of a camera's frames so far, by outcome.

    Attributes:
        frames: received frames.
        used: frames in released sets.
        missing: sets released without a frame of this camera while it ran.
        late: frames that came after the release of their set.
        surplus: frames in a slot that already had one.
        duplicates: frames with the timestamp of an earlier one.
        reordered: frames that came after a later frame, but in time.
        unsure: frames that came while the clock seemed to jump.
        skewed: frames too far from the median of their set.
        outages: number of times that the camera fell silent.
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
    """The state of one camera."""

    def __init__(self, latency_ns: int, offset_ns: int) -> None:
        self.latency_ns, self.offset_ns, self.counts = latency_ns, offset_ns, CameraCounts()
        self.clock: ClockTracker | None = None
        self.arrivals: collections.deque[int] = collections.deque(maxlen=RECENT)
        self.timestamps: collections.deque[int] = collections.deque(maxlen=RECENT)
        self.silent = True
        self.reset_phase()

    def reset_phase(self) -> None:
        """Reset phase and stride, after a start, a silence, or a jump of the clock."""
        self.phase_ns, self.frame_count = 0.0, 0
        self.restarts = 0 if self.clock is None else self.clock.restarts
        self.last_slot: int | None = None
        self.steps: collections.deque[int] = collections.deque(maxlen=RECENT)

    @property
    def stride(self) -> int:
        """Number of slots from one frame to the next: the median, on which lost frames have no influence."""
        return statistics.median_low(self.steps) if self.steps else 1


class Synchroniser:
    """Takes frames and gives sets. For one thread only; the caller tells the time."""

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
        self._open_sets: dict[int, dict[str, tuple[int, DepthFrame]]] = {}
        self._anchor: tuple[int, float] | None = None  # a slot and its host time
        self._reference = ""
        self._last_released: int | None = None
        self._last_ns: int | None = None
        self._first_arrival_ns: int | None = None

    def add_camera(self, name: str, latency_ms: float = 0.0, offset_ns: int = 0) -> None:
        """Expect frames of a camera from now on.

        Args:
            latency_ms: least time from exposure to arrival, which the clocks do not tell. It matters if cameras
                differ in it.
            offset_ns: time offset, which is added to its timestamps. Sets wait for a camera whose offset is negative.

        Raises:
            InputError: when there is a camera of this name, or the offset is longer than sets can wait.
        """
        if abs(offset_ns) > LONGEST_OFFSET_NS:
            raise InputError(
                f"camera {name!r} has a time_offset_s of {offset_ns / 1e9:g}: sets of running cameras wait for at most "
                f"{LONGEST_OFFSET_NS / 1e9:g} s; run applies longer ones to recordings"
            )
        if name in self._cameras:
            raise InputError(f"camera {name!r} is there already: names must differ")
        self._cameras[name] = _Camera(round(latency_ms * 1e6), offset_ns)

    def remove_camera(self, name: str) -> None:
        """Ignore a camera from now on; frames that it has delivered stay in their sets."""
        self._cameras.pop(name, None)

    @property
    def names(self) -> tuple[str, ...]:
        """The cameras, in the order they were added."""
        return tuple(self._cameras)

    def counts(self, name: str) -> CameraCounts:
        """Numbers of a camera's frames by outcome."""
        return self._cameras[name].counts

    def clock(self, name: str) -> ClockTracker | None:
        """A camera's clock; None before its first frame."""
        return self._cameras[name].clock

    def rate_hz(self, name: str, now_ns: int) -> float:
        """Frames a second of a camera's last second or so; 0 while it is silent."""
        arrivals = self._cameras[name].arrivals
        if not self._is_running(self._cameras[name], now_ns) or len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
            return 0.0
        return (len(arrivals) - 1) * 1e9 / (arrivals[-1] - arrivals[0])

    def add(self, frame: DepthFrame) -> int | None:
        """Take a frame; frames of cameras that were not added are ignored.

        Returns:
            Its time of exposure on the host's clock; None for a duplicate, or while its clock is doubtful.
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
        if camera.silent or not self._is_running(camera, frame.arrival_ns):
            camera.reset_phase()
            camera.timestamps.clear()
            camera.arrivals.clear()
            camera.silent = False
        camera.arrivals.append(frame.arrival_ns)
        camera.timestamps.append(frame.timestamp_ns)
        camera.clock = self._clocks.setdefault(frame.clock, ClockTracker())
        host_ns = camera.clock.update(frame.timestamp_ns, frame.arrival_ns)
        if camera.restarts != camera.clock.restarts:
            camera.reset_phase()
        if host_ns is None:
            counts.unsure += 1
            return None
        host_ns += camera.offset_ns - camera.latency_ns
        self._assign(camera, frame, host_ns)
        return host_ns

    def poll(self, now_ns: int) -> list[SyncedSet]:
        """The sets that are complete or have waited long enough at this host time, in order."""
        for camera in self._cameras.values():
            if not camera.silent and not self._is_running(camera, now_ns):
                camera.silent = True
                camera.counts.outages += 1
        sets = []
        for slot in sorted(self._open_sets):
            if now_ns < self._deadline_ns(slot) and any(
                self._is_expected(name, camera, slot, now_ns) for name, camera in self._cameras.items()
            ):
                break
            sets.append(self._release_slot(slot))
        return [synced for synced in sets if synced is not None]

    def next_deadline_ns(self) -> int | None:
        """Host time at which ``poll`` releases a set even if no frame comes; None if no set is open."""
        return self._deadline_ns(min(self._open_sets)) if self._open_sets else None

    def flush(self) -> list[SyncedSet]:
        """Release all open sets, at the end of a recording."""
        return [synced for slot in sorted(self._open_sets) if (synced := self._release_slot(slot)) is not None]

    def _is_running(self, camera: _Camera, now_ns: int) -> bool:
        return bool(camera.arrivals) and now_ns - camera.arrivals[-1] <= self.settings.lost_after_s * 1e9

    def _slot_time_ns(self, slot: int) -> float:
        assert self._anchor is not None
        return self._anchor[1] + (slot - self._anchor[0]) * self._period_ns

    def _deadline_ns(self, slot: int) -> int:
        phases = [camera.phase_ns for camera in self._cameras.values() if not camera.silent]
        # A frame arrives later than its slot by what its timestamp was moved back.
        delays = [
            -camera.offset_ns for camera in self._cameras.values() if not (camera.silent and camera.counts.frames)
        ]
        due_ns = self._slot_time_ns(slot) + max(phases, default=0) + max(delays, default=0)
        return round(due_ns + self.settings.wait_ms * 1e6)

    def _is_expected(self, name: str, camera: _Camera, slot: int, now_ns: int) -> bool:
        """Whether a set should wait for a camera, which runs and whose next frame may belong to this slot.

        At the start, cameras that have not delivered yet count as running.
        """
        if not camera.counts.frames and self._first_arrival_ns is not None:
            return now_ns - self._first_arrival_ns <= self.settings.lost_after_s * 1e9
        if camera.silent or name in self._open_sets[slot]:
            return False
        return camera.last_slot is None or slot >= camera.last_slot + camera.stride

    def _assign(self, camera: _Camera, frame: DepthFrame, host_ns: int) -> None:
        if self._anchor is None:
            self._anchor, self._reference = (0, float(host_ns)), frame.camera
        slot = self._slot_of(camera, frame.camera, host_ns)
        if camera.last_slot is not None and slot > camera.last_slot:
            camera.steps.append(slot - camera.last_slot)
        reordered = camera.last_slot is not None and slot < camera.last_slot
        camera.last_slot = slot if camera.last_slot is None else max(slot, camera.last_slot)
        if self._last_released is not None and slot <= self._last_released:
            camera.counts.late += 1
            return
        camera.counts.reordered += reordered
        frames = self._open_sets.setdefault(slot, {})
        due_ns = self._slot_time_ns(slot) + camera.phase_ns
        if frame.camera in frames:
            camera.counts.surplus += 1
            if abs(frames[frame.camera][0] - due_ns) <= abs(host_ns - due_ns):
                return
        frames[frame.camera] = (host_ns, frame)

    def _slot_of(self, camera: _Camera, name: str, host_ns: int) -> int:
        """The slot of a frame. The slots follow the reference camera, and a camera's phase follows its frames."""
        assert self._anchor is not None
        reference = self._cameras.get(self._reference)
        if name != self._reference and (
            reference is None or reference.silent or reference.frame_count < camera.frame_count // 2
        ):
            self._reference, reference = name, camera
        elapsed = (host_ns - camera.phase_ns - self._anchor[1]) / self._period_ns
        slot = self._anchor[0] + round(elapsed)
        error_ns = host_ns - camera.phase_ns - self._slot_time_ns(slot)
        camera.frame_count += 1
        gain = max(1 / camera.frame_count, GAIN)
        if name == self._reference:
            if slot > self._anchor[0]:
                # The rate is corrected much less than the phase, which keeps the loop from oscillating.
                period_ns = self._period_ns + GAIN**2 / 4 * error_ns / (slot - self._anchor[0])
                low, high = (1 - RATE_RANGE) * self._nominal_ns, (1 + RATE_RANGE) * self._nominal_ns
                self._anchor = (slot, self._slot_time_ns(slot) + gain * error_ns)
                self._period_ns = min(max(period_ns, low), high)
        else:
            camera.phase_ns += gain * error_ns
        camera.phase_ns = self._nearest_phase(camera)
        return slot

    def _nearest_phase(self, camera: _Camera) -> float:
        """The camera's phase, or the phase one period away if it is much nearer to those of the others."""
        others = [other.phase_ns for other in self._cameras.values() if other is not camera and not other.silent]
        if not others:
            return camera.phase_ns
        low, high, phase = min(others), max(others), camera.phase_ns
        moved = phase - self._period_ns if phase > (low + high) / 2 else phase + self._period_ns
        gain = max(phase, high) - min(phase, low) - (max(moved, high) - min(moved, low))
        return moved if gain > MIN_MOVE_GAIN * self._period_ns else phase

    def _release_slot(self, slot: int) -> SyncedSet | None:
        self._last_released = slot
        entries = self._open_sets.pop(slot)
        phases = {name: self._cameras[name].phase_ns if name in self._cameras else 0.0 for name in entries}
        times = {
            name: host_ns - (round(phases[name]) if self.settings.triggered else 0)
            for name, (host_ns, _) in entries.items()
        }
        middle_ns = round(statistics.median(times.values()))
        limit_ns = self._period_ns / 2 if self.settings.max_skew_ms is None else self.settings.max_skew_ms * 1e6
        kept = {name for name, time_ns in times.items() if abs(time_ns - middle_ns) <= limit_ns}
        for name in entries.keys() & self._cameras.keys():
            counts = self._cameras[name].counts
            counts.used += name in kept
            counts.skewed += name not in kept
        missing = tuple(
            name
            for name, camera in self._cameras.items()
            if name not in entries
            and not camera.silent
            and camera.last_slot is not None
            and (slot - camera.last_slot) % camera.stride == 0
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
        frames = {name: entries[name][1] for name in times}
        return SyncedSet(timestamp_ns, frames, times, max(times.values()) - min(times.values()), missing)
