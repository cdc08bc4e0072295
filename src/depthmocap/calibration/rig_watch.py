"""Watches the rig while poses are made: cameras that do not fit each other, that were moved, and what is wrong."""

from __future__ import annotations

import collections
import threading
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import MIRROR
from depthmocap.calibration.camera_replacement import Moment
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.recording_check import check_tracks
from depthmocap.calibration.scene_watch import WINDOW_NS, SceneWatch
from depthmocap.frames import FrameSet
from depthmocap.geometry import DepthCamera, transform_points
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.pose.extrinsics_check import SETS, ExtrinsicsCheck

#: Joints are kept for this long (seconds), so that a camera can be placed anew by them,
KEPT_S = 60.0
#: once in so many seconds.
_EVERY_S = 0.1
#: When a camera is told to have moved, it has stood where it stands now for this long at least (seconds).
_SINCE_S = 1.5e-9 * WINDOW_NS


class RigWatch:
    """Call it with every frame set and the followed person's cloud, or None where not all views were labelled: then the
    rooms alone are watched."""

    def __init__(self, up: str, explain: bool = False) -> None:
        """
        Args:
            up: the world's up axis.
            explain: whether to tell, by the joints of the last sets, what is wrong with cameras that do not fit. It
                takes a second of another thread.
        """
        self._up, self._explain = up, explain
        self._extrinsics_check = ExtrinsicsCheck()
        self._scenes: collections.defaultdict[str, SceneWatch] = collections.defaultdict(SceneWatch)
        self._joints: collections.deque[tuple[float, dict[str, Float[ndarray, "18 4"]]]] = collections.deque(
            maxlen=SETS
        )
        self._kept: collections.deque[Moment] = collections.deque()
        self._kept_lock = threading.Lock()
        self._moved_s: dict[str, float] = {}
        self._cameras: dict[str, DepthCamera] = {}
        self._pool: ThreadPoolExecutor | None = None
        self._explanation: Future[list[str]] | None = None
        self._told: set[str] = set()

    def __call__(self, frames: FrameSet, cloud: LabelledCloud | None) -> list[str]:
        """The problems that are found now, one line each."""
        problems = []
        # One camera whose place nobody knows may be carried.
        carried = len(frames.views) == 1 and np.array_equal(frames.views[0].camera.world_from_camera, np.eye(4))
        for view in () if carried else frames.views:
            share = self._scenes[view.camera.name](view, frames.timestamp_ns)
            if share is not None:
                self._moved_s[view.camera.name] = frames.timestamp_ns / 1e9 - _SINCE_S
                way = "place it anew on the page of --view, or " if self._explain else ""
                problems.append(
                    f"camera {view.camera.name!r} was moved while it ran: {share:.0%} of what stood still before it is "
                    f"elsewhere; {way}depthmocap calibrate RECORDING --out rig.json"
                )
        misplaced = [] if cloud is None else self._extrinsics_check(cloud)
        if self._explain:
            if cloud is not None:
                self._remember(cloud, frames.timestamp_ns / 1e9)
            if misplaced and self._explanation is None:
                self._start()
            problems += self._explained(wait=False)
        return [*problems, *misplaced]

    def finish(self) -> list[str]:
        """The problems of the last sets, one line each."""
        misplaced = self._extrinsics_check.finish()
        if self._explain and misplaced and self._explanation is None:
            self._start()
        problems = self._explained(wait=True)
        if self._pool is not None:
            self._pool.shutdown()
        return [*problems, *misplaced]

    @property
    def moved(self) -> tuple[str, ...]:
        """Cameras that were moved and not placed anew, the last one first."""
        return tuple(sorted(self._moved_s, key=lambda name: -self._moved_s[name]))

    def moments(self, name: str) -> list[Moment]:
        """What cameras have seen of the followed person in the last minute, since a camera was moved; any thread may
        ask."""
        since_s = self._moved_s.get(name, -float("inf"))
        with self._kept_lock:
            return [(now_s, seen) for now_s, seen in self._kept if now_s >= since_s]

    def placed_anew(self, name: str) -> None:
        """Judge all cameras from now on alone, because one of them was placed anew."""
        self._extrinsics_check = ExtrinsicsCheck()
        self._joints.clear()
        self._told.clear()
        self._moved_s.pop(name, None)

    def distances_m(self) -> dict[str, float]:
        """How far apart the cameras see the person (metres), by the extrinsics check."""
        return self._extrinsics_check.distances_m()

    def _remember(self, cloud: LabelledCloud, now_s: float) -> None:
        """Keep the joints of each camera in its own frame. Sides are taken together, because they were exchanged where
        views did not agree about them."""
        seen = {}
        for camera, joints in zip(cloud.cameras, cloud.joints, strict=False):
            if joints is not None and np.isfinite(joints).all():
                local = np.concatenate([transform_points(camera.camera_from_world, joints[:, :3]), joints[:, 3:]], 1)
                seen[camera.name] = (local + local[MIRROR]) / 2
                self._cameras[camera.name] = camera
        self._joints.append((now_s, seen))
        if not seen:
            return
        with self._kept_lock:
            if self._kept and not _EVERY_S <= now_s - self._kept[-1][0] < KEPT_S:
                if 0 <= now_s - self._kept[-1][0] < _EVERY_S:
                    return
                self._kept.clear()  # time went back, or nobody was there for long
            self._kept.append((now_s, seen))
            while now_s - self._kept[0][0] > KEPT_S:
                self._kept.popleft()

    def _start(self) -> None:
        cameras, tracks = list(self._cameras.values()), []
        for camera in cameras:
            mine = [(now_s, seen[camera.name]) for now_s, seen in self._joints if camera.name in seen]
            joints = np.stack([each for _, each in mine]) if mine else np.empty((0, 18, 4))
            tracks.append(JointTrack(np.array([now_s for now_s, _ in mine]), joints[..., :3], joints[..., 3]))
        self._pool = self._pool or ThreadPoolExecutor(1)
        self._explanation = self._pool.submit(check_tracks, cameras, tracks, self._up)

    def _explained(self, wait: bool) -> list[str]:
        """Explanations that are new."""
        if self._explanation is None or not (wait or self._explanation.done()):
            return []
        lines = [line for line in self._explanation.result() if line not in self._told]
        self._explanation = None
        self._told.update(lines)
        return lines
