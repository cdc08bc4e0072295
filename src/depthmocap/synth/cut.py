"""People who are cut off: behind desks and beds, by the picture's edge, below the waist alone, half behind a door.

The hidden part lies behind a plane in the world, so that the cut follows the body and not the picture. Only the plane
of a picture's edge passes through the camera's eye.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import unit

#: Hidden part: below the knees, thighs, hips or chest; above the waist or the neck; to one side; or beyond an edge of
#: the picture.
Cut = Literal["knees", "thighs", "hips", "chest", "waist", "head", "side", "edge"]
CUTS: tuple[Cut, ...] = get_args(Cut)

#: Share of each in training. Furniture in front of people mostly hides their legs.
_SHARES: Mapping[Cut, float] = {
    "knees": 0.14, "thighs": 0.14, "hips": 0.2, "chest": 0.1, "waist": 0.08, "head": 0.08, "side": 0.1, "edge": 0.16,
}  # fmt: skip
#: Where the cuts across the body lie, in shares of the trunk from the hip's middle (0) to the neck (1).
_LEVELS: Mapping[Cut, tuple[float, float]] = {
    "knees": (-1.35, -0.7), "thighs": (-0.75, -0.25), "hips": (-0.3, 0.2), "chest": (0.2, 0.6),
    "waist": (-0.1, 0.5), "head": (0.75, 1.15),
}  # fmt: skip
#: Cuts that keep the part below the plane.
_KEEP_BELOW: tuple[Cut, ...] = ("waist", "head")
#: Least cosine of the trunk's tilt for a horizontal cut, as by a table's edge, in place of a cut across the trunk.
_UPRIGHT = 0.5
#: Approximate standard deviation of a cut's direction, radians.
_TILT = 0.12


class Plane(NamedTuple):
    """A plane in the world; the side that the normal points to stays visible."""

    point: Float[ndarray, "3"]
    normal: Float[ndarray, "3"]

    def keeps(self, depth_m: Float[ndarray, "h w"], camera: DepthCamera) -> Bool[ndarray, "h w"]:
        """Pixels (of a picture without distortion) that show something on the visible side.

        Args:
            depth_m: metres along z.
        """
        rotation, eye = camera.world_from_camera[:3, :3], camera.world_from_camera[:3, 3]
        across, down, forward = rotation.T @ self.normal
        u = (np.arange(camera.width) - camera.cx) / camera.fx
        v = (np.arange(camera.height) - camera.cy) / camera.fy
        along = across * u[None] + down * v[:, None] + forward  # of a ray of depth 1
        return along * depth_m > (self.point - eye) @ self.normal


def random_cut(rng: np.random.Generator) -> Cut:
    """A random kind of cut, with the shares of training."""
    shares = np.array([_SHARES[cut] for cut in CUTS])
    return CUTS[int(rng.choice(len(CUTS), p=shares / shares.sum()))]


def cut_plane(rng: np.random.Generator, cut: Cut, joints: Float[ndarray, "18 3"], camera: DepthCamera) -> Plane:
    """A random plane behind which the person is hidden.

    Args:
        joints: of the person, in the world.
    """
    hip, neck = joints[JOINT_INDEX["Hip"]].astype(np.float64), joints[JOINT_INDEX["Neck"]].astype(np.float64)
    if cut in _LEVELS:
        return _across(rng, cut, hip, neck)
    return {"side": _beside, "edge": _edge}[cut](rng, joints.astype(np.float64), camera)


def _across(rng: np.random.Generator, cut: Cut, hip: Float[ndarray, "3"], neck: Float[ndarray, "3"]) -> Plane:
    length = float(np.linalg.norm(neck - hip))
    trunk = (neck - hip) / length
    level = trunk[2] > _UPRIGHT and rng.random() < 0.5
    axis = unit((np.array([0.0, 0.0, 1.0]) if level else trunk) + rng.normal(0, _TILT, 3))
    point = hip + axis * length * rng.uniform(*_LEVELS[cut])
    return Plane(point, -axis if cut in _KEEP_BELOW else axis)


def _beside(rng: np.random.Generator, joints: Float[ndarray, "18 3"], camera: DepthCamera) -> Plane:
    """A vertical edge, as of a door or a pillar, hides one half of the body."""
    right = camera.world_from_camera[:3, 0] + rng.normal(0, _TILT, 3)
    normal = unit(right) * (1.0 if rng.random() < 0.5 else -1.0)
    return Plane(_within(rng, joints, normal, (0.15, 0.6)), normal)


def _edge(rng: np.random.Generator, joints: Float[ndarray, "18 3"], camera: DepthCamera) -> Plane:
    """An edge of the picture; the plane passes through the eye."""
    rotation, eye = camera.world_from_camera[:3, :3], camera.world_from_camera[:3, 3]
    side = int(rng.integers(4))
    across = rotation[:, side % 2] * (1.0 if side < 2 else -1.0)
    point = _within(rng, joints, across, (0.1, 0.6))
    along = rotation[:, 1 - side % 2]  # the edge's direction: the other axis of the picture
    normal = np.cross(along, point - eye)
    return Plane(point, unit(normal) * np.sign(normal @ across))


def _within(
    rng: np.random.Generator, joints: Float[ndarray, "18 3"], axis: Float[ndarray, "3"], hidden: tuple[float, float]
) -> Float[ndarray, "3"]:
    """A point such that a random share of the body's extent along the axis lies before it."""
    places = joints @ axis
    low, high = places.min() - 0.1, places.max() + 0.1
    middle = joints.mean(0)
    return middle + axis * (low + rng.uniform(*hidden) * (high - low) - middle @ axis)
