"""The contract of a camera: a context manager that yields raw depth frames with their own time.

    with open_camera("realsense:012345") as source:
        for frame in source:                        # every frame, in order
            ...
        frame = source.read_latest(max_age_ms=100)  # or the newest, skipping what was missed

A back end subclasses ``DepthSource`` with three functions: open, read one frame, close. Recordings and the synthetic
generator are sources like any other.
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

from depthmocap.cameras.time_limit import HangsError, within
from depthmocap.core.names import check_camera_name
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.text import cameras

#: How long the reading thread waits for a frame before it looks whether it shall stop.
_POLL_S = 0.5
#: Calls that open and close a device are waited for so long; an SDK that hangs must not hang the program.
OPEN_S, CLOSE_S = 10.0, 3.0

_Result = TypeVar("_Result")


class CameraError(InputError):
    """A camera cannot be used, or was lost. The message says why, and what to do."""


class _StuckError(CameraError):
    """A call of an SDK does not return."""


class MisfitError(CameraError):
    """A camera is not the one that was calibrated. It will not change by itself."""


class NoFrame(CameraError):  # noqa: N818 - nothing is wrong yet
    """No frame came in time; the camera may still deliver."""


@dataclasses.dataclass(frozen=True, eq=False)
class DepthFrame:
    """One raw depth picture.

    Attributes:
        camera: the camera's name.
        raw: depth in the device's own units (the camera's ``depth_unit_m``), 0 where invalid.
        timestamp_ns: when it was taken, by the clock named in ``clock``.
        clock: equal names are one clock; a device's own clock has the device in its name.
        arrival_ns: host time (``time.monotonic_ns``) at which it arrived, taken before anything else was done.
        number: the device's count of frames, whose gaps are lost frames; None where it does not count.
    """

    camera: str
    raw: UInt16[ndarray, "h w"]
    timestamp_ns: int
    clock: str
    arrival_ns: int
    number: int | None = None


@dataclasses.dataclass(frozen=True)
class FoundCamera:
    """A device that is connected. ``spec`` opens it; ``problem`` says why it would not open, if that is known."""

    spec: str
    model: str
    serial: str
    problem: str = ""


class DepthSource(abc.ABC):
    """One depth camera. Read it from one thread, either frame by frame or with ``read_latest``, not both.

    Attributes:
        name: of the camera in the rig and in recordings.
        up: the world's up axis. A device does not know where it stands: at the origin, upright, if no rig says better.
        patience_s: a camera that gives nothing for longer than this is lost, because SDKs do not tell of a pulled plug.
        reopens: one that was lost goes on when it is opened again; a file would begin anew.
        problems: what a user should know and does not end the reading, one line each; who tells them takes them out.
    """

    up: str = "-y"
    patience_s: float = 5.0
    reopens: bool = True

    def __init__(self, name: str) -> None:
        """Raises InputError when the name cannot be a camera's."""
        check_camera_name(name)
        self.name = name
        self.problems: collections.deque[str] = collections.deque()
        self._camera: DepthCamera | None = None
        self._pump: _Pump | None = None
        self._stuck: threading.Thread | None = None
        self._silent_s = 0.0

    @abc.abstractmethod
    def _open(self) -> DepthCamera:
        """Start the device; gives its intrinsics and depth scale. Raises CameraError and leaves nothing open."""

    @abc.abstractmethod
    def _read(self, timeout_s: float) -> DepthFrame | None:
        """The next frame; None at the end. Raises NoFrame after ``timeout_s``, CameraError when it is lost."""

    @abc.abstractmethod
    def _close(self) -> None:
        """Stop the device. Called once after a successful ``_open``."""

    @property
    def camera(self) -> DepthCamera:
        """Intrinsics and depth scale as the device tells them; only a rig knows where it stands.

        Raises:
            CameraError: before it is opened.
        """
        if self._camera is None:
            raise CameraError(f"camera {self.name!r} is not open: use it in a with statement")
        return self._camera

    @property
    def raw_background(self) -> UInt16[ndarray, "h w"] | None:
        """Raw depth of the empty scene; only recordings know it."""
        return None

    def __enter__(self) -> DepthSource:
        if self._camera is not None:
            raise CameraError(f"camera {self.name!r} is open already: close it first")
        if self._stuck is not None and self._stuck.is_alive():
            raise CameraError(f"camera {self.name!r} is stuck in a call of its SDK: unplug it and plug it in again")
        self._camera = self._within(OPEN_S, self._open, self._close)
        self._silent_s = 0.0
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pump is not None:
            self._pump.stop()
            self._pump = None
        if self._camera is not None:
            self._camera = None
            with contextlib.suppress(_StuckError):  # left behind: it is told when the camera is opened again
                self._within(CLOSE_S, self._close)

    def _within(self, limit_s: float, call: Callable[[], _Result], undo: Callable[[], None] | None = None) -> _Result:
        try:
            return within(limit_s, call, undo)
        except HangsError as error:
            self._stuck = error.thread
            raise _StuckError(
                f"camera {self.name!r} hangs in a call of its SDK ({limit_s:.0f} s): unplug it and plug it in again"
            ) from None

    def _patiently(self, timeout_s: float) -> DepthFrame | None:
        """What ``_read`` gives; a camera that was silent for longer than its patience is lost."""
        begun_s = time.monotonic()
        try:
            frame = self._read(timeout_s)
        except NoFrame as error:
            self._silent_s += time.monotonic() - begun_s  # only while somebody listened
            if self._silent_s > self.patience_s:
                raise CameraError(
                    f"camera {self.name!r} gave no frame for {self._silent_s:.0f} s: was it unplugged?"
                ) from error
            raise
        self._silent_s = 0.0
        return frame

    def read(self, timeout_s: float = 2.0) -> DepthFrame | None:
        """The next frame, or None at the end of a recording.

        Raises:
            NoFrame: when none came in time.
            CameraError: when the camera is not open, or was lost.
        """
        _ = self.camera
        if self._pump is not None:
            raise CameraError(f"camera {self.name!r} is read by read_latest: do not iterate over it as well")
        return self._patiently(timeout_s)

    def __iter__(self) -> Iterator[DepthFrame]:
        while (frame := self.read()) is not None:
            yield frame

    def read_latest(self, max_age_ms: float = 100.0) -> DepthFrame:
        """The newest frame that arrived, at once; where there is none so young, the next if it comes within that time.

        A thread empties the device from the first call on, so that no old frame queues up anywhere.

        Raises:
            NoFrame: when there is no frame so young; the message tells the age of the last.
            CameraError: when the camera is not open, was lost, or its recording is at its end.
        """
        _ = self.camera
        if self._pump is None:
            self._pump = _Pump(self)
        return self._pump.latest(max_age_ms)


class _Pump:
    """The thread that keeps a source's newest frame."""

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
                frame = self._source._patiently(_POLL_S)
            except NoFrame:
                continue
            except CameraError as error:
                self._end(error)
                return
            except Exception as error:  # whatever an SDK raises is told where the frames are asked for
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
            raise NoFrame(f"camera {self._source.name!r} gave nothing for {max_age_ms:.0f} ms: {last}")

    def stop(self) -> None:
        self._stopping = True
        self._thread.join(2 * _POLL_S)


def unsourced(rig: Rig, names: Collection[str]) -> list[str]:
    """A line about the cameras of the rig that are not among the sources of these names, if there are any."""
    missing = [name for name in rig.names if name not in names]
    if len(missing) > 1:
        return [f"the rig has {cameras(missing)}, but no sources of those names were given; going on without them"]
    return [
        f"the rig has a camera {name!r}, but no source of that name was given; going on without it" for name in missing
    ]


def place(camera: DepthCamera, rig: Rig) -> DepthCamera:
    """The rig's camera of the same name, which a device delivers for; the device's own depth scale is kept.

    Raises:
        MisfitError: when the rig does not have it, or calibrated it at another resolution.
    """
    if camera.name not in rig.names:
        raise MisfitError(f"the rig has no camera {camera.name!r}: it has {', '.join(rig.names)}")
    placed = rig[camera.name]
    if (placed.width, placed.height) != (camera.width, camera.height):
        raise MisfitError(
            f"camera {camera.name!r} delivers {camera.width}×{camera.height} but was calibrated at "
            f"{placed.width}×{placed.height}: calibrate it again, or ask the device for "
            f"?size={placed.width}x{placed.height}"
        )
    return dataclasses.replace(placed, depth_unit_m=camera.depth_unit_m)
