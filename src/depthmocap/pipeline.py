"""The pipeline: views of one instant in, the pose out, with the milliseconds of every stage.

Person mask → body-part labels → labelled world cloud → joints → smoothing. Each stage is a plain function of the one
before; replace one and keep the rest.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray

from depthmocap.classify.runtime import Classifier
from depthmocap.frames import FrameSet, Pose, View
from depthmocap.pose.cloud import LabelledCloud, LabelledView, merge_views
from depthmocap.pose.estimate import JointEstimator
from depthmocap.pose.filter import PoseFilter

STAGES = ("segment", "label", "merge", "joints", "smooth")


@dataclasses.dataclass(frozen=True, eq=False)
class Result:
    """The pose of a frame set and everything found on the way to it.

    A filter that waits for later frames makes the pose that of an earlier one: its timestamp tells which.
    """

    pose: Pose
    masks: tuple[Bool[ndarray, "_ _"], ...]
    labels: tuple[UInt8[ndarray, "_ _"], ...]
    cloud: LabelledCloud
    #: Milliseconds by stage.
    milliseconds: dict[str, float]


class Pipeline:
    """Depth views to joints. Keeps state only for smoothing; :meth:`reset` forgets it."""

    def __init__(
        self,
        classifier: Classifier,
        estimator: JointEstimator,
        segment: Callable[[View], Bool[ndarray, "_ _"]],
        up: str = "z",
        smoothing: PoseFilter | None = None,
    ) -> None:
        """
        Args:
            segment: gives the person's mask of a view, e.g. a ``PersonSegmenter``.
            up: the world's up axis.
            smoothing: a filter over time, of this pipeline alone (``pose.track.load_filter``); None for none.
        """
        self._classifier, self._estimator, self.segment, self._up = classifier, estimator, segment, up
        self.smoothing = smoothing
        self._pool = ThreadPoolExecutor(max_workers=4)

    def reset(self) -> None:
        """Forget past poses."""
        if self.smoothing is not None:
            self.smoothing.reset()

    def finish(self) -> list[Pose]:
        """The poses that a filter which waits has held back, at the end of a stream; forgets past poses."""
        return [] if self.smoothing is None else self.smoothing.finish()

    def __call__(self, frames: FrameSet) -> Result:
        """Process one frame set. Without a person (or a view) the joints are NaN and their confidence 0."""
        clock = [time.perf_counter()]
        masks = list(self._pool.map(self.segment, frames.views))
        clock.append(time.perf_counter())
        labelled = self._classifier.label_views(frames.views, masks)
        clock.append(time.perf_counter())
        parts = [LabelledView(view, *found) for view, found in zip(frames.views, labelled, strict=True)]
        cloud = merge_views(parts)
        clock.append(time.perf_counter())
        joints, confidence = self._estimator(cloud, self._up)
        clock.append(time.perf_counter())
        pose = Pose(frames.timestamp_ns, joints, confidence)
        if self.smoothing is not None:
            pose = self.smoothing(pose)
        clock.append(time.perf_counter())
        return Result(
            pose,
            tuple(masks),
            tuple(found.labels for found in labelled),
            cloud,
            dict(zip(STAGES, (np.diff(clock) * 1e3).tolist(), strict=True)),
        )
