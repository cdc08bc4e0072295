"""Cameras of the synthetic generator as sources: the moving person of the packaged demo, made anew as it is read."""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Iterator

import numpy as np
from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.cameras.modes import Mode, ModeRequest
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FrameTimeoutError
from depthmocap.frames import FrameSet
from depthmocap.geometry import DepthCamera, Rig

#: Frames a second that can be asked for.
RATES = (5, 8, 10, 15, 20, 30)


class SyntheticScene:
    """The moving person of the packaged demo, made anew as it is read, for all its cameras. Needs the extra train.

    Attributes:
        rig: the cameras.
    """

    def __init__(self, seed: int = 0, sets: int | None = None, fps: int | None = None) -> None:
        """Load the body and make the first set, which takes long where nothing was compiled yet.

        ``sets``: number of frame sets; by default the motion's length. ``fps``: by default the demo's.
        """
        from depthmocap.synth.body.mesh import BodyModel
        from depthmocap.synth.demo_scene import FPS, demo_frames, demo_rig

        # Here, and not when a camera's thread asks for the first frame: torch, which it imports, must not be seen half
        # imported by another thread, and no camera is taken for a silent one while it is made.
        BodyModel.load()
        self.rig: Rig = demo_rig()
        self._sets: Iterator[tuple[dict[str, int], FrameSet]] = demo_frames(seed, sets, float(fps or FPS))
        self._ahead: dict[str, collections.deque[tuple[int, UInt16[ndarray, "_ _"]]]] = {
            name: collections.deque() for name in self.rig.names
        }
        self._lock = threading.Lock()
        self._make()

    def _make(self) -> None:
        """One more set, if there is one."""
        if (made := next(self._sets, None)) is None:
            return
        stamps, frame_set = made
        for view in frame_set.views:
            raw = np.round(view.depth_m / view.camera.depth_unit_m).astype(np.uint16)
            self._ahead[view.camera.name].append((stamps[view.camera.name], raw))

    def next_of(self, name: str) -> tuple[int, UInt16[ndarray, "_ _"]] | None:
        """A camera's next timestamp (ns) and raw depth; None at the end."""
        with self._lock:
            if not self._ahead[name]:
                self._make()
            return self._ahead[name].popleft() if self._ahead[name] else None


def make_sources(name: str, request: ModeRequest, playback_clock: PlaybackClock) -> list[DepthSource]:
    """The camera of this name of a new scene, or all its cameras.

    Raises:
        CameraError: when no camera has this name, or it lacks the requested mode.
    """
    from depthmocap.synth.demo_scene import FPS, demo_rig

    rig = demo_rig()
    names = [name] if name else rig.names
    if name and name not in rig.names:
        raise _no_camera(name, rig)
    rate = 0
    for camera in (rig[camera_name] for camera_name in names):
        modes = [Mode(camera.width, camera.height, fps) for fps in RATES]
        rate = modes[request.choose(camera.name, modes, default_fps=round(FPS))].fps
    scene = SyntheticScene(fps=rate)
    return [SyntheticCamera(scene, camera_name, playback_clock) for camera_name in names]


def _no_camera(name: str, rig: Rig) -> CameraError:
    return CameraError(f"the synthetic scene has no camera {name!r}: it has {', '.join(rig.names)}")


class SyntheticCamera(DepthSource):
    """One camera of a synthetic scene."""

    lost_after_s = float("inf")
    reopens = False

    def __init__(self, scene: SyntheticScene, name: str, playback_clock: PlaybackClock | None = None) -> None:
        """Raises CameraError when the scene has no such camera."""
        super().__init__(name)
        if name not in scene.rig.names:
            raise _no_camera(name, scene.rig)
        self.up = scene.rig.up
        self._scene, self._playback_clock, self._number = scene, playback_clock or PlaybackClock(), 0
        self._due: tuple[int, UInt16[ndarray, "_ _"]] | None = None

    def _open(self) -> DepthCamera:
        return self._scene.rig[self.name]

    def _read(self, timeout_s: float) -> DepthFrame | None:
        self._due = self._due or self._scene.next_of(self.name)
        if self._due is None:
            return None
        timestamp_ns, raw = self._due
        if not self._playback_clock.wait(timestamp_ns, timeout_s):
            raise FrameTimeoutError(f"camera {self.name!r}: the next frame is not due yet")
        self._due, number, self._number = None, self._number, self._number + 1
        return DepthFrame(self.name, raw, timestamp_ns, "recording", time.monotonic_ns(), number)

    def _close(self) -> None:
        """Nothing is held open."""
