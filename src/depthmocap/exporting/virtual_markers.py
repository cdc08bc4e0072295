"""Surface landmarks of a moving skeleton, as virtual markers: each keeps its place in the frame of a bone
(:class:`LandmarkModel`)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARKS
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.body_motion import BodyMotion
from depthmocap.exporting.bone_rotations import CHILDREN
from depthmocap.exporting.landmark_model import LandmarkModel
from depthmocap.frames import expected_error_m

_JOINT = np.array([JOINT_INDEX[landmark.joint] for landmark in LANDMARKS])
_BONE = np.array([JOINT_INDEX[landmark.bone] for landmark in LANDMARKS])
#: Of each landmark, the joints that it takes: its own, and those that turn its bone.
_NEEDS = np.array(
    [
        [name in (landmark.joint, landmark.bone, *CHILDREN[landmark.bone]) for name in JOINT_INDEX]
        for landmark in LANDMARKS
    ]
)


def landmark_positions(motion: BodyMotion, model: LandmarkModel | None = None) -> Float[ndarray, "t m 3"]:
    """Landmarks (m, Y up); NaN where the joint is not known, or the bone's rotation is not."""
    model = model or LandmarkModel.load()
    turned = motion.world_rotations()[:, _BONE] @ model.offsets_m(motion.offsets)[:, :, None]
    unknown = np.asarray(np.isnan(motion.joints).any(-1))[:, _JOINT] | motion.rotation_held[:, _BONE]
    return np.where(unknown[..., None], np.nan, motion.positions()[:, _JOINT] + turned[..., 0])


def landmark_confidence(confidence: Float[ndarray, "t 18"]) -> Float[ndarray, "t m"]:
    """The least of the confidences of the joints that a landmark takes."""
    return np.where(_NEEDS, confidence[:, None, :], 1.0).min(-1)


def landmark_errors_m(
    confidence: Float[ndarray, "t 18"], offsets: Float[ndarray, "18 3"], model: LandmarkModel | None = None
) -> Float[ndarray, "t m"]:
    """Expected distance of landmarks from the truth (m): of joints of such a confidence, and their own, as the root of
    the sum of squares."""
    errors_m = (model or LandmarkModel.load()).errors_m(offsets)
    return np.hypot(expected_error_m(landmark_confidence(confidence)), errors_m)
