"""Cameras of recordings as sources, played at their own speed or as fast as they are read."""

from __future__ import annotations

import time
from pathlib import Path

from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.cameras.modes import ModeRequest
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import BACK_ENDS
from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FrameTimeoutError
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording


def make_sources(spec: str, request: ModeRequest, playback_clock: PlaybackClock) -> list[DepthSource]:
    """The cameras of a recording that have frames (``PATH``), or one of them (``PATH#NAME``).

    Args:
        request: not used; a recording has only the mode in which it was made.

    Raises:
        InputError: when there is no such recording or camera.
    """
    path = Path(spec) if Path(spec).exists() else Path(spec.rpartition("#")[0] or spec)
    if not path.exists():
        recording = spec.rpartition("?")[0]
        if recording and (Path(recording).is_file() or Path(recording, "rig.json").exists()):
            raise InputError(f"{spec}: a recording has no other modes than it was made in: give {recording} alone")
        raise InputError(
            f"{spec} is neither a recording nor a camera: cameras are {', '.join(BACK_ENDS)}, with :SERIAL where "
            "there are several (depthmocap cameras lists them)"
        )
    recording = open_recording(path)
    with_frames = [name for name in recording.rig.names if recording.stamps(name)]
    names = with_frames if path == Path(spec) else [spec.rpartition("#")[2]]
    sources: list[DepthSource] = [RecordedCamera(recording, name, playback_clock) for name in names]
    sources[0].problems.extend(recording.problems)  # the file's problems, reported once
    return sources


class RecordedCamera(DepthSource):
    """One camera of a recording. It skips frames that cannot be read, as if they had been lost."""

    lost_after_s = float("inf")  # gaps are part of the recording
    reopens = False

    def __init__(self, recording: Recording, name: str, playback_clock: PlaybackClock | None = None) -> None:
        """Raises CameraError when the recording has no such camera, or no frame of it."""
        super().__init__(name)
        if name not in recording.rig.names:
            raise CameraError(f"{recording.path} has no camera {name!r}: it has {', '.join(recording.rig.names)}")
        self.up, self.area_m = recording.up, recording.area_m
        self._recording, self._playback_clock = recording, playback_clock or PlaybackClock()
        self._stamps = recording.stamps(name)
        if not self._stamps:
            raise CameraError(f"{recording.path} has no frames of camera {name!r}")
        self._next = 0

    @property
    def raw_background(self) -> UInt16[ndarray, "h w"] | None:
        return self._recording.raw_background(self.name)

    def _open(self) -> DepthCamera:
        self._next = 0
        return self._recording.rig[self.name]

    def _read(self, timeout_s: float) -> DepthFrame | None:
        while self._next < len(self._stamps):
            stamp = self._stamps[self._next]
            if not self._playback_clock.wait(stamp, timeout_s):
                raise FrameTimeoutError(f"camera {self.name!r}: the next frame is not due yet")
            number, self._next = self._next, self._next + 1
            try:
                raw = self._recording.raw(self.name, stamp)
            except InputError as error:
                self.problems.append(str(error))
                continue
            timestamp_ns, clock = self._recording.device_time(self.name, stamp)
            return DepthFrame(self.name, raw, timestamp_ns, clock, time.monotonic_ns(), number)
        return None

    def _close(self) -> None:
        """Do nothing: the recording stays open."""
