"""Surface landmarks of a moving skeleton, as virtual markers.

A landmark keeps its place in the frame of a bone. Where that is follows from the lengths of the person's bones, by a
linear regression that learnt it from bodies of many builds (``train landmarks``): nobody is measured.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARK_NAMES, LANDMARKS
from depthmocap.body.skeleton import BONES, JOINT_INDEX
from depthmocap.core.reading.array_files import ArrayType, read_npz
from depthmocap.exporting.body_motion import BodyMotion
from depthmocap.exporting.bone_rotations import CHILDREN
from depthmocap.frames import expected_error_m

_FILE = Path(__file__).with_name("weights") / "landmarks.npz"
#: Nobody is smaller: the sum of the lengths of all bones (m).
_SMALLEST_M = 0.1
_JOINT = np.array([JOINT_INDEX[landmark.joint] for landmark in LANDMARKS])
_BONE = np.array([JOINT_INDEX[landmark.bone] for landmark in LANDMARKS])
#: Of each landmark, the joints that it takes: its own, and those that turn its bone.
_NEEDS = np.array(
    [
        [name in (landmark.joint, landmark.bone, *CHILDREN[landmark.bone]) for name in JOINT_INDEX]
        for landmark in LANDMARKS
    ]
)
#: Segments whose lengths tell a person's build, each as joints of which the offsets are added, both sides' mean.
_SEGMENTS = (
    ("Spine", "Spine1", "Spine2", "Neck"), ("Head",), ("RElbow", "LElbow"), ("RHand", "LHand"), ("RKnee", "LKnee"),
    ("RFoot", "LFoot"), ("RHip", "LHip"), ("RShoulder", "LShoulder"),
)  # fmt: skip
_ENDS = np.array([JOINT_INDEX[child] for _, child in BONES])
#: Numbers that tell a build: the lengths of segments, the widths of hips and shoulders, and 1.
BUILD = len(_SEGMENTS) + 3

_ARRAYS = {
    "coefficients": ArrayType(f"{len(LANDMARK_NAMES)} {BUILD} 3", "f"),
    "error": ArrayType(f"{len(LANDMARK_NAMES)}", "f"),
}


def person_size_m(offsets: Float[ndarray, "18 3"]) -> float:
    """The sum of the lengths of all bones (m)."""
    return max(float(np.linalg.norm(offsets[_ENDS], axis=-1).sum()), _SMALLEST_M)


def build_of(offsets: Float[ndarray, "18 3"]) -> Float[ndarray, " b"]:
    """What the regression takes, in units of the person's size."""
    lengths = [sum(float(np.linalg.norm(offsets[JOINT_INDEX[name]])) for name in segment) for segment in _SEGMENTS]
    widths = [
        float(np.linalg.norm(offsets[JOINT_INDEX[f"L{name}"]] - offsets[JOINT_INDEX[f"R{name}"]]))
        for name in ("Hip", "Shoulder")
    ]
    return np.array([1.0, *(np.array([*lengths, *widths]) / person_size_m(offsets))])


@dataclasses.dataclass(frozen=True, eq=False)
class LandmarkModel:
    """Where landmarks are on a skeleton.

    Attributes:
        coefficients: of :func:`build_of`, for each landmark's offset from its joint, in units of the person's size.
        error: mean distance from the truth on bodies that the regression has not seen, in units of the person's size,
            if the skeleton is true.
    """

    coefficients: Float[ndarray, "m b 3"]
    error: Float[ndarray, " m"]

    @classmethod
    @functools.cache
    def load(cls, path: Path = _FILE) -> LandmarkModel:
        """The packaged one, or one that ``train landmarks`` wrote.

        Raises:
            InputError: when the file cannot be read, or is of other landmarks.
        """
        arrays = read_npz(path, _ARRAYS)
        return cls(arrays["coefficients"].astype(np.float64), arrays["error"].astype(np.float64))

    def offsets_m(self, offsets: Float[ndarray, "18 3"]) -> Float[ndarray, "m 3"]:
        """Of each landmark from its joint, in the frame of its bone (m)."""
        return np.einsum("b,mbi->mi", build_of(offsets), self.coefficients) * person_size_m(offsets)

    def errors_m(self, offsets: Float[ndarray, "18 3"]) -> Float[ndarray, " m"]:
        """How far landmarks of a person are from the truth on average, if the skeleton is true (m)."""
        return self.error * person_size_m(offsets)


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
    own = (model or LandmarkModel.load()).errors_m(offsets)
    return np.hypot(expected_error_m(landmark_confidence(confidence)), own)
