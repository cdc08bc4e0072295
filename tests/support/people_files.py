"""People before a depth camera, and what the packaged pipeline finds in them: material for sets of any layout.

Truths are made from the pipeline's own estimates, moved by known distances, so that its errors are known.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.classify.classifier import Classifier
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import load_estimator
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import render_body


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """Depth (metres) of a person alone, and our joints in it as the pipeline finds them, in the camera's frame."""

    depth_m: ndarray
    joints: ndarray


def scenes(body: Body, camera: DepthCamera, count: int, dtype: type = np.float32, seed: int = 0) -> list[Scene]:
    """Bodies in random postures before a level camera; depth is rounded to ``dtype`` as a file would."""
    rng = np.random.default_rng(seed)
    prior, classifier, estimator = PosturePrior.load(simple=True), Classifier(), load_estimator()
    level = dataclasses.replace(
        camera, world_from_camera=look_at(np.array([0.0, -2.6, 0.0]), np.array([0.0, 0.0, 0.0]))
    )
    own = dataclasses.replace(camera, world_from_camera=np.eye(4))
    found = []
    for _ in range(count):
        posture, _ = prior.sample(rng)
        depth_m, _ = render_body(body.pose(posture), level)
        depth_m = depth_m.astype(dtype).astype(np.float32)
        view = View(own, depth_m, depth_m > 0)
        (labelled,) = classifier.label_views([view], [depth_m > 0])
        joints, _ = estimator(merge_views([LabelledView(view, *labelled)]), "-y")
        found.append(Scene(depth_m, joints))
    return found


def picked(joints: ndarray, ours: dict[str, str], names: tuple[str, ...]) -> ndarray:
    """Our joints in the order of a set's."""
    return joints[..., [JOINT_INDEX[ours[name]] for name in names], :]
