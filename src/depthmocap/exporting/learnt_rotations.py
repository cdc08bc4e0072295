"""Rotations of all bones from joints, by a small network that learnt them from motion capture on generated bodies.

It tells what positions alone leave open: the twist about limbs, and how head, hands and feet are turned. ``train
rotations`` makes it. Input are the joints now and a little before, from the middle of the hips, in axes of the trunk,
in units of the person's size, and the direction that is up; output are rotation matrices in those axes.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.core.reading.array_files import ArrayType, read_npz
from depthmocap.geometry.transforms import cross
from depthmocap.kernels.nearest_rotation import nearest_rotations

_FILE = Path(__file__).with_name("weights") / "rotations.npz"
#: How long before the present the joints are looked at (s).
LOOKED_BACK_S = (0.0, 1 / 15, 2 / 15)
#: Nobody is smaller (m): where all joints are in one place, nothing can be told, and nothing fails.
_SMALLEST_M = 0.1
#: Numbers that the network takes.
FEATURES = 3 * len(JOINTS) * len(LOOKED_BACK_S) + 3
_SIDES = f"f h g {9 * len(JOINTS)}".split()
_ARRAYS = {"mean": ArrayType("f", "f"), "scale": ArrayType("f", "f")}
for _i, (_before, _after) in enumerate(itertools.pairwise(_SIDES)):
    _ARRAYS |= {f"weight{_i}": ArrayType(f"{_after} {_before}", "f"), f"bias{_i}": ArrayType(_after, "f")}
_HIPS = [JOINT_INDEX["RHip"], JOINT_INDEX["LHip"]]
_SHOULDERS = [JOINT_INDEX["RShoulder"], JOINT_INDEX["LShoulder"]]


def trunk_axes(joints_y_up: Float[ndarray, "t 18 3"]) -> Float[ndarray, "t 3 3"]:
    """Columns: left, up and forward of the trunk, from its hips and shoulders."""
    hips, shoulders = joints_y_up[:, _HIPS], joints_y_up[:, _SHOULDERS]
    up = shoulders.mean(1) - hips.mean(1)
    left = hips[:, 1] - hips[:, 0] + shoulders[:, 1] - shoulders[:, 0]
    up = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9)
    left = left - (left * up).sum(-1, keepdims=True) * up
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    axes = np.stack([left, up, cross(left, up)], -1)
    flat = np.linalg.det(axes) < 0.5  # hips and shoulders at one place, or on one line
    return np.where(flat[:, None, None], np.eye(3), axes)


def rotation_features(
    window: Float[ndarray, "w t 18 3"], axes: Float[ndarray, "t 3 3"], size_m: Float[ndarray, " t"] | float
) -> Float[ndarray, "t f"]:
    """What the network takes.

    Args:
        window: joints (Y up) now and at :data:`LOOKED_BACK_S`.
        axes: of the trunk, now.
        size_m: the sum of the lengths of the person's bones.
    """
    centred = window - window[:, :, _HIPS].mean(2, keepdims=True)
    inside = np.einsum("wtni,tij->tnwj", centred, axes) / np.maximum(np.reshape(size_m, (-1, 1, 1, 1)), _SMALLEST_M)
    return np.concatenate([inside.reshape(len(axes), -1), axes[:, 1]], 1)


@dataclasses.dataclass(frozen=True, eq=False)
class RotationNetwork:
    """Fully connected layers with rectifiers between them.

    Attributes:
        layers: weights (out, in) and biases (out).
        mean, scale: of the features.
    """

    layers: tuple[tuple[ndarray, ndarray], ...]
    mean: Float[ndarray, " f"]
    scale: Float[ndarray, " f"]

    @classmethod
    @functools.cache
    def load(cls, path: Path = _FILE) -> RotationNetwork:
        """The packaged network, or one that ``train rotations`` wrote.

        Raises:
            InputError: when the file cannot be read.
        """
        arrays = read_npz(path, _ARRAYS)
        arrays = {name: array.astype(np.float32) for name, array in arrays.items()}
        layers = tuple((arrays[f"weight{i}"], arrays[f"bias{i}"]) for i in range(3))
        return cls(layers, arrays["mean"], arrays["scale"])

    def __call__(
        self, window: Float[ndarray, "w t 18 3"], size_m: Float[ndarray, " t"] | float
    ) -> Float[ndarray, "t 18 3 3"]:
        """Rotations in the world (Y up), away from the T pose; arguments as :func:`rotation_features`."""
        axes = trunk_axes(window[0])
        values = (rotation_features(window, axes, size_m).astype(np.float32) - self.mean) / self.scale
        for i, (weights, biases) in enumerate(self.layers):
            values = values @ weights.T + biases
            if i + 1 < len(self.layers):
                values = np.maximum(values, 0)
        return axes[:, None] @ nearest_rotations(values.reshape(-1, len(JOINTS), 3, 3))
