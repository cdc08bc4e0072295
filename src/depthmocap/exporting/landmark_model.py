"""Where surface landmarks are on the bones of a person, by the lengths of these.

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

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.body.skeleton import BONES, JOINT_INDEX
from depthmocap.core.reading.array_files import ArrayType, read_npz

_FILE = Path(__file__).with_name("weights") / "landmarks.npz"
#: Nobody is smaller: the sum of the lengths of all bones (m).
_SMALLEST_M = 0.1
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
