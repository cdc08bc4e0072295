"""Watches the rig while poses are made: cameras that do not fit each other, that were moved, and what is wrong."""

from __future__ import annotations

import collections
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import MIRROR
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.recording_check import check_tracks
from depthmocap.calibration.scene_watch import SceneWatch
from depthmocap.frames import FrameSet
from depthmocap.geometry import DepthCamera, transform_points
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.pose.extrinsics_check import SETS, ExtrinsicsCheck


class RigWatch:
    """Call it with every frame set and the followed person's cloud."""

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
        self._cameras: dict[str, DepthCamera] = {}
        self._pool: ThreadPoolExecutor | None = None
        self._explanation: Future[list[str]] | None = None
        self._told: set[str] = set()

    def __call__(self, frames: FrameSet, cloud: LabelledCloud) -> list[str]:
        """The problems that are found now, one line each."""
        problems = []
        for view in frames.views:
            share = self._scenes[view.camera.name](view, frames.timestamp_ns)
            if share is not None:
                problems.append(
                    f"camera {view.camera.name!r} was moved while it ran: {share:.0%} of what stood still before it is "
                    "elsewhere; depthmocap calibrate RECORDING --out rig.json"
                )
        misplaced = self._extrinsics_check(cloud)
        if self._explain:
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

    def distances_m(self) -> dict[str, float]:
        """How far apart the cameras see the person (metres), by the extrinsics check."""
        return self._extrinsics_check.distances_m()

    def _remember(self, cloud: LabelledCloud, now_s: float) -> None:
        """Keep the joints of each camera in its own frame. Sides are taken together, because they were exchanged where
        views did not agree about them."""
        seen = {}
        for camera, joints in zip(cloud.cameras, cloud.joints, strict=False):
            if joints is not None and np.isfinite(joints).all():
                own = np.concatenate([transform_points(camera.camera_from_world, joints[:, :3]), joints[:, 3:]], 1)
                seen[camera.name] = (own + own[MIRROR]) / 2
                self._cameras[camera.name] = camera
        self._joints.append((now_s, seen))

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
