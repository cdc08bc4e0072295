"""Frames on their way into sets: health checks, the synchroniser, and counts of both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from depthmocap.cameras.health import FAULTS, Fault, HealthCheck
from depthmocap.cameras.source import DepthFrame
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera
from depthmocap.realtime.problems import Problems
from depthmocap.realtime.sync import SyncedSet, Synchroniser, SyncSettings
from depthmocap.recordings.recording import Recording


class FrameIngest:
    """Takes frames and gives sets. For one thread only; the caller tells the time.

    Attributes:
        cameras: cameras by name, with their poses in the rig.
        faults: numbers of frames that were left out, by camera and fault.
        last_faults: the fault of each camera's last frame.
        problems: messages for the user, one line each, and how often each occurred.
    """

    def __init__(self, settings: SyncSettings, problems: Problems | None = None) -> None:
        self.sync = Synchroniser(settings)
        self.cameras: dict[str, DepthCamera] = {}
        self.faults: dict[str, dict[Fault, int]] = {}
        self.last_faults: dict[str, Fault] = {}
        self.problems = problems or Problems()
        self._checks: dict[str, HealthCheck] = {}
        self._restarts: dict[str, int] = {}

    def add_camera(self, camera: DepthCamera) -> None:
        """Expect frames of a camera; a camera that was there before continues."""
        if camera.name not in self.cameras:
            self.sync.add_camera(camera.name, offset_ns=camera.time_offset_ns)
            self.faults[camera.name] = {}
        self.cameras[camera.name] = camera
        self._checks[camera.name] = HealthCheck(camera)

    def remove_camera(self, name: str) -> None:
        """Expect no more frames of a camera."""
        for table in (self.cameras, self.faults, self.last_faults, self._checks, self._restarts):
            table.pop(name, None)
        self.sync.remove_camera(name)

    def add(self, frame: DepthFrame) -> None:
        """Take a frame; a faulty one is left out, counted and reported."""
        name = frame.camera
        if name not in self.cameras:
            return
        fault = self.last_faults[name] = self._checks[name](frame.raw, frame.timestamp_ns)
        if fault:
            self.faults[name][fault] = self.faults[name].get(fault, 0) + 1
            self.problems.add(f"camera {name!r}: {FAULTS[fault]}")
            return
        self.sync.add(frame)
        clock = self.sync.clock(name)
        if clock is not None and clock.restarts > self._restarts.setdefault(name, clock.restarts):
            self._restarts[name] = clock.restarts
            # Times alone cannot tell which of the two it is.
            what = "went back, or its frames were held up for a second" if clock.went_back else "jumped ahead"
            self.problems.add(f"camera {name!r}: its clock {what}")

    def run(self, frames: Iterable[DepthFrame]) -> Iterator[SyncedSet]:
        """All sets of frames that come in order of arrival. The caller's speed has no influence."""
        for frame in frames:
            while (due_ns := self.sync.next_deadline_ns()) is not None and due_ns < frame.arrival_ns:
                yield from self.sync.poll(due_ns)
            self.add(frame)
            yield from self.sync.poll(frame.arrival_ns)
        yield from self.sync.flush()


def frame_set(synced: SyncedSet, cameras: dict[str, DepthCamera]) -> FrameSet:
    """The set in metres, with its cameras, in the order of ``cameras``, which does not depend on arrival."""
    views = tuple(
        View(camera, camera.to_metres(synced.frames[name].raw))
        for name, camera in cameras.items()
        if name in synced.frames
    )
    return FrameSet(synced.timestamp_ns, views)


def recorded_frames(recording: Recording, problems: Problems) -> Iterator[DepthFrame]:
    """The frames of a recording in order of time, as if each had arrived at its recorded time.

    Frames that cannot be read are left out, and reported in ``problems``.
    """
    order = sorted((stamp, name) for name in recording.rig.names for stamp in recording.stamps(name))
    for stamp, camera in order:
        try:
            raw = recording.raw(camera, stamp)
        except InputError as error:
            problems.add(str(error))
            continue
        timestamp_ns, clock = recording.device_time(camera, stamp)
        yield DepthFrame(camera, raw, timestamp_ns, clock, stamp)
