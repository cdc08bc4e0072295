"""The contract of a camera: a context manager that yields raw depth frames with their own time.

    with open_camera("realsense:012345") as source:
        for frame in source:                        # every frame, in order
            ...
        frame = source.read_latest(max_age_ms=100)  # or the newest, skipping older ones

A back end subclasses ``DepthSource`` with three functions: open, read one frame, close. Recordings and the synthetic
generator are sources, too.
"""

from __future__ import annotations

import abc
import collections
import contextlib
import dataclasses
import threading
import time
from collections.abc import Callable, Collection, Iterator
from types import TracebackType
from typing import TypeVar

import numpy as np
from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.cameras.time_limit import CallTimeoutError, call_with_timeout
from depthmocap.core.camera_names import check_camera_name
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.geometry.floor_area import FloorArea
from depthmocap.text import camera_list

#: Seconds that the reading thread waits for a frame before it checks whether it shall stop.
_POLL_S = 0.5
#: Time limit (seconds) of the call that opens a device: an SDK that hangs must not hang the program.
OPEN_S = 10.0
#: Time limit (seconds) of the call that closes a device.
CLOSE_S = 3.0

_Result = TypeVar("_Result")


class CameraError(InputError):
    """A camera cannot be used, or was lost. The message says why, and what to do."""


class _StuckError(CameraError):
    """A call of an SDK does not return."""


class CameraMismatchError(CameraError):
    """A camera differs from the one that was calibrated. Trying again does not help."""


class FrameTimeoutError(CameraError):
    """No frame came in time; the camera may still deliver."""


@dataclasses.dataclass(frozen=True, eq=False)
class DepthFrame:
    """One raw depth picture.

    Attributes:
        camera: the camera's name.
        raw: depth in the device's own units (the camera's ``depth_unit_m``), 0 where invalid.
        timestamp_ns: when it was taken, by the clock named in ``clock``.
        clock: name of the clock; equal names mean the same clock. A device's own clock has the device in its name.
        arrival_ns: host time (``time.monotonic_ns``) of its arrival, taken before anything else.
        number: the device's frame counter, whose gaps are lost frames; None if the device does not count.
    """

    camera: str
    raw: UInt16[ndarray, "h w"]
    timestamp_ns: int
    clock: str
    arrival_ns: int
    number: int | None = None


@dataclasses.dataclass(frozen=True)
class ConnectedCamera:
    """A connected device. ``spec`` opens it; ``problem`` says why it cannot be opened, and is empty otherwise."""

    spec: str
    model: str
    serial: str
    problem: str = ""


class DepthSource(abc.ABC):
    """One depth camera. Read it from one thread, either frame by frame or with ``read_latest``, not both.

    Attributes:
        name: the camera's name in the rig and in recordings.
        up: the world's up axis. A device does not know its pose: without a rig it stands upright at the origin.
        area_m: corners of the area of the floor in which people are followed; empty for everywhere.
        lost_after_s: a camera that is silent for longer counts as lost, because SDKs do not report a pulled plug.
        reopens: a lost camera continues when it is opened again; False for files, which would start from the beginning.
        problems: messages for the user that do not end the reading, one line each. The reader removes what it shows.
    """

    up: str = "-y"
    area_m: FloorArea = ()
    lost_after_s: float = 5.0
    reopens: bool = True

    def __init__(self, name: str) -> None:
        """Raises InputError when the name cannot be a camera's."""
        check_camera_name(name)
        self.name = name
        self.problems: collections.deque[str] = collections.deque()
        self._camera: DepthCamera | None = None
        self._latest_thread: _LatestFrameThread | None = None
        self._stuck_thread: threading.Thread | None = None
        self._silence_s = 0.0

    @abc.abstractmethod
    def _open(self) -> DepthCamera:
        """Start the device; returns intrinsics and depth scale. Raises CameraError, and then leaves nothing open."""

    @abc.abstractmethod
    def _read(self, timeout_s: float) -> DepthFrame | None:
        """The next frame; None at the end. Raises FrameTimeoutError after ``timeout_s``, and CameraError on a loss."""

    @abc.abstractmethod
    def _close(self) -> None:
        """Stop the device. Called once after a successful ``_open``."""

    def _frame_timeout(self, timeout_s: float) -> FrameTimeoutError:
        return FrameTimeoutError(f"camera {self.name!r} gave no frame for {timeout_s:.1f} s: is it still connected?")

    @property
    def camera(self) -> DepthCamera:
        """Intrinsics and depth scale that the device reports; the pose comes from a rig.

        Raises:
            CameraError: when the source is not open.
        """
        if self._camera is None:
            raise CameraError(f"camera {self.name!r} is not open: use it in a with statement")
        return self._camera

    @property
    def raw_background(self) -> UInt16[ndarray, "h w"] | None:
        """Raw depth of the empty scene; None except for recordings that have it."""
        return None

    def __enter__(self) -> DepthSource:
        if self._camera is not None:
            raise CameraError(f"camera {self.name!r} is open already: close it first")
        if self._stuck_thread is not None and self._stuck_thread.is_alive():
            raise CameraError(f"camera {self.name!r} is stuck in a call of its SDK: unplug it and plug it in again")
        self._camera = self._call_sdk(OPEN_S, self._open, self._close)
        self._silence_s = 0.0
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._latest_thread is not None:
            self._latest_thread.stop()
            self._latest_thread = None
        if self._camera is not None:
            self._camera = None
            with contextlib.suppress(_StuckError):  # opening the camera again reports it
                self._call_sdk(CLOSE_S, self._close)

    def _call_sdk(self, limit_s: float, call: Callable[[], _Result], undo: Callable[[], None] | None = None) -> _Result:
        try:
            return call_with_timeout(limit_s, call, undo)
        except CallTimeoutError as error:
            self._stuck_thread = error.thread
            raise _StuckError(
                f"camera {self.name!r} hangs in a call of its SDK ({limit_s:.0f} s): unplug it and plug it in again"
            ) from None

    def _read_unless_lost(self, timeout_s: float) -> DepthFrame | None:
        """Read a frame. Raises CameraError when the camera was silent for longer than ``lost_after_s``."""
        start_s = time.monotonic()
        try:
            frame = self._read(timeout_s)
        except FrameTimeoutError as error:
            self._silence_s += time.monotonic() - start_s  # counts only the time spent reading
            if self._silence_s > self.lost_after_s:
                raise CameraError(
                    f"camera {self.name!r} gave no frame for {self._silence_s:.0f} s: was it unplugged?"
                ) from error
            raise
        self._silence_s = 0.0
        return frame

    def read(self, timeout_s: float = 2.0) -> DepthFrame | None:
        """The next frame, or None at the end of a recording.

        Raises:
            FrameTimeoutError: when none came in time.
            CameraError: when the camera is not open, or was lost.
        """
        _ = self.camera
        if self._latest_thread is not None:
            raise CameraError(f"camera {self.name!r} is read by read_latest: do not iterate over it as well")
        return self._read_unless_lost(timeout_s)

    def __iter__(self) -> Iterator[DepthFrame]:
        while (frame := self.read()) is not None:
            yield frame

    def read_latest(self, max_age_ms: float = 100.0) -> DepthFrame:
        """The newest frame, if it is at most this old; otherwise the next frame, if it comes within this time.

        From the first call on, a thread reads all frames, so that no old frame waits in a queue.

        Raises:
            FrameTimeoutError: when no frame is young enough; the message tells the age of the last one.
            CameraError: when the camera is not open, was lost, or its recording is at its end.
        """
        _ = self.camera
        if self._latest_thread is None:
            self._latest_thread = _LatestFrameThread(self)
        return self._latest_thread.latest(max_age_ms)


class _LatestFrameThread:
    """A thread that reads a source and keeps its newest frame."""

    def __init__(self, source: DepthSource) -> None:
        self._source = source
        self._changed = threading.Condition()
        self._newest: DepthFrame | None = None
        self._failure: CameraError | None = None
        self._stopping = False
        # A daemon, because a call of an SDK that never returns must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name=f"camera {source.name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stopping:
            try:
                frame = self._source._read_unless_lost(_POLL_S)
            except FrameTimeoutError:
                continue
            except CameraError as error:
                self._end(error)
                return
            except Exception as error:  # SDKs raise anything; ``latest`` raises it again
                self._end(CameraError(f"camera {self._source.name!r} was lost: {error}"))
                return
            if frame is None:
                self._end(CameraError(f"{self._source.name!r} is at its end"))
                return
            with self._changed:
                self._newest = frame
                self._changed.notify_all()

    def _end(self, error: CameraError) -> None:
        with self._changed:
            self._failure = error
            self._changed.notify_all()

    def latest(self, max_age_ms: float) -> DepthFrame:
        def age_ms() -> float:
            return np.inf if self._newest is None else (time.monotonic_ns() - self._newest.arrival_ns) / 1e6

        with self._changed:
            self._changed.wait_for(lambda: self._failure or age_ms() <= max_age_ms, max_age_ms / 1e3)
            if self._newest is not None and age_ms() <= max_age_ms:
                return self._newest
            if self._failure is not None:
                raise self._failure
            last = "no frame yet" if self._newest is None else f"the last frame is {age_ms():.0f} ms old"
            raise FrameTimeoutError(f"camera {self._source.name!r} gave nothing for {max_age_ms:.0f} ms: {last}")

    def stop(self) -> None:
        self._stopping = True
        self._thread.join(2 * _POLL_S)


def missing_source_problems(rig: Rig, names: Collection[str]) -> list[str]:
    """A line about the cameras of the rig for which no source of their name was given; empty if there are none."""
    missing = [name for name in rig.names if name not in names]
    if len(missing) > 1:
        return [f"the rig has {camera_list(missing)}, but no sources of those names were given; going on without them"]
    return [
        f"the rig has a camera {name!r}, but no source of that name was given; going on without it" for name in missing
    ]


def place_in_rig(camera: DepthCamera, rig: Rig) -> DepthCamera:
    """The rig's camera of the same name, with the depth scale that the device reports.

    Raises:
        CameraMismatchError: when the rig lacks the camera, or has it at another resolution.
    """
    if camera.name not in rig.names:
        raise CameraMismatchError(f"the rig has no camera {camera.name!r}: it has {', '.join(rig.names)}")
    placed = rig[camera.name]
    if (placed.width, placed.height) != (camera.width, camera.height):
        raise CameraMismatchError(
            f"camera {camera.name!r} delivers {camera.width}×{camera.height} but was calibrated at "
            f"{placed.width}×{placed.height}: calibrate it again, or ask the device for "
            f"?size={placed.width}x{placed.height}"
        )
    return dataclasses.replace(placed, depth_unit_m=camera.depth_unit_m)
