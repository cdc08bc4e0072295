"""What each camera saw of each part of the body, in few numbers; and the frame of the body they are put into.

Parts are the 43 regions, and behind them the 18 joints, of which a camera's part is where the network takes the joint
to be from what that camera saw.

Unlike the paper's statistics (``features``) these turn with the points: a person who turns gives the same numbers in
the frame of their own body, and a sample can be turned, mirrored or seen by fewer cameras without its points.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray

from depthmocap.body.regions import MIRROR, REGION, REGION_COUNT, REGION_NAMES
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.body.skeleton import MIRROR as MIRRORED_JOINTS
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.kernels.part_moments import part_moments
from depthmocap.pose.cloud import LabelledCloud

#: Columns of what a camera saw of a region: points, area seen (m²), mean label probability, share of it near the
#: centre, centre (3, m), covariance (xx, xy, xz, yy, yz, zz, m²), direction to the camera (3). Of a joint: 1, 0, the
#: share of expected errors that are larger, 0, place, covariance of the expected error, direction to the camera.
COUNT, AREA, PROBABILITY, NEAR, CENTRE, COVARIANCE, TOWARDS = 0, 1, 2, 3, slice(4, 7), slice(7, 13), slice(13, 16)
PART_COLUMNS = 16
PART_COUNT = REGION_COUNT + len(JOINTS)
#: Regions of a view with fewer points are taken as unseen.
MIN_POINTS = 6
#: Points this far from their region's centre count a quarter (metres): half a thigh.
_SCALE_M = 0.25

#: Where each column of a symmetric matrix's row stands in the columns of ``COVARIANCE``.
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_UPPER = np.triu_indices(3)


def _regions(*names: str) -> ndarray:
    return np.array([REGION[name] - 1 for name in names])


_TORSO = ("chest", "belly", "upper back", "lower back", "collar", "shoulder front", "shoulder back", "thigh")
_RIGHT = _regions(*(f"{name} R" for name in _TORSO))
_LEFT = _regions(*(f"{name} L" for name in _TORSO))
_FRONT = _regions(*(f"{name} {side}" for name in ("chest", "belly", "collar", "shoulder front") for side in "RL"))
_BACK = _regions(*(f"{name} {side}" for name in ("upper back", "lower back", "shoulder back") for side in "RL"))
#: ``parts[..., MIRRORED, :]`` exchanges the sides.
MIRRORED = np.concatenate([MIRROR[1:].astype(np.int64) - 1, REGION_COUNT + MIRRORED_JOINTS])
assert len(REGION_NAMES) == REGION_COUNT + 1


def _limb(regions: tuple[str, ...], joints: tuple[str, ...]) -> Bool[ndarray, "61"]:
    found = np.zeros(PART_COUNT, bool)
    found[_regions(*(f"{name} {side}" for name in regions for side in "RL"))] = True
    found[[REGION_COUNT + JOINT_INDEX[side + name] for name in joints for side in "RL"]] = True
    return found


#: The parts that a classifier takes for those of the other side together: of the arms, of the legs.
ARMS = _limb(("upper arm", "elbow", "forearm", "wrist", "hand"), ("Elbow", "Hand"))
LEGS = _limb(("thigh", "knee", "shin", "ankle", "forefoot"), ("Knee", "Foot"))
#: A joint with this error to expect has a probability of a half (metres).
_TYPICAL_ERROR_M = 0.1
#: A pair of regions of both sides is about so far apart (metres), to weigh it against what one side alone tells.
_PAIR_M = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class BodyFrame:
    """A place near the middle of the trunk and the direction it faces, of each sample: ``x`` forwards, ``y`` to the
    body's left, ``z`` up. ``point_body = turn @ (point - origin)``."""

    origin: Float[ndarray, "*n 3"]
    turn: Float[ndarray, "*n 3 3"]

    def from_world(self, points: Float[ndarray, "*n j 3"]) -> Float[ndarray, "*n j 3"]:
        """Points of the Z-up world in the body's frame."""
        return (points - self.origin[..., None, :]) @ np.swapaxes(self.turn, -1, -2)

    def to_world(self, points: Float[ndarray, "*n j 3"]) -> Float[ndarray, "*n j 3"]:
        """Points of the body's frame in the Z-up world."""
        return points @ self.turn + self.origin[..., None, :]


def part_statistics(cloud: LabelledCloud, up: str = "z") -> Float32[ndarray, "views 61 16"]:
    """What each camera saw of each part, in the world turned Z-up; rows of unseen parts are 0.

    Raises:
        InputError: for another ``up``, a cloud that does not know its cameras, a label outside 1–43 or a point that is
            not finite.
    """
    try:
        rotation = z_up_from(up)
    except ValueError as error:
        raise InputError(str(error)) from None
    if sum(cloud.view_sizes) != len(cloud) or len(cloud.view_sizes) != len(cloud.cameras):
        raise InputError("this cloud does not know which camera saw its points: make it with merge_views")
    if len(cloud) and not (
        cloud.labels.min() >= 1 and cloud.labels.max() <= REGION_COUNT and np.isfinite(cloud.points_world.sum())
    ):
        raise InputError(f"points have a label outside 1–{REGION_COUNT} or are not finite")
    parts = np.zeros((len(cloud.cameras), PART_COUNT, PART_COLUMNS), np.float32)
    for out, joints, camera in zip(parts, cloud.joints, cloud.cameras, strict=False):
        if joints is not None and np.isfinite(joints).all():
            out[REGION_COUNT:] = _joint_rows(joints, rotation, rotation @ camera.world_from_camera[:3, 3])
    end = 0
    for out, size, camera in zip(parts[:, :REGION_COUNT], cloud.view_sizes, cloud.cameras, strict=True):
        start, end = end, end + size
        moments = part_moments(
            cloud.points_world[start:end], cloud.labels[start:end], cloud.weights[start:end], rotation, REGION_COUNT,
            _SCALE_M,
        )  # fmt: skip
        seen = moments[:, 0] >= MIN_POINTS
        count, total, near = moments[seen, 0], moments[seen, 1], moments[seen, 2]
        centre = moments[seen, 3:6]
        towards = rotation @ camera.world_from_camera[:3, 3] - centre
        distance = np.linalg.norm(towards, axis=1)
        out[seen] = np.column_stack(
            [
                count,
                count * distance**2 / (camera.fx * camera.fy),
                total / count,
                near / total,
                centre,
                moments[seen, 6:],
                towards / distance[:, None],
            ]
        )
    return parts


def _joint_rows(
    joints: Float[ndarray, "18 4"], rotation: Float[ndarray, "3 3"], eye: Float[ndarray, "3"]
) -> Float[ndarray, "18 16"]:
    centre, expected_m = joints[:, :3] @ rotation.T, joints[:, 3]
    towards = eye - centre
    rows = np.zeros((len(joints), PART_COLUMNS))
    rows[:, COUNT] = 1
    rows[:, PROBABILITY] = 1 / (1 + expected_m / _TYPICAL_ERROR_M)
    rows[:, CENTRE] = centre
    rows[:, COVARIANCE] = expected_m[:, None] ** 2 * [1, 0, 0, 1, 0, 1]
    rows[:, TOWARDS] = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    return rows


def seen_parts(parts: Float32[ndarray, "*n 61 16"]) -> Bool[ndarray, "*n 61"]:
    """Where a camera saw a part."""
    return parts[..., COUNT] > 0


def body_frame(parts: Float32[ndarray, "*n views 61 16"]) -> BodyFrame:
    """The body's frame, from the trunk as far as it was seen.

    Its middle weighs the centres by area and probability. It faces where three hints point together: from the right
    regions to the left ones, from the cameras that see the back to those that see the front, and from those that see
    the right to those that see the left. Where nothing tells, it faces along the world's x.
    """
    parts = parts[..., :REGION_COUNT, :]
    weights = (parts[..., AREA] * parts[..., PROBABILITY]).astype(np.float64)
    trunk = np.zeros(REGION_COUNT)
    trunk[np.concatenate([_LEFT, _RIGHT])] = 1
    # All of the body stands in where no trunk was seen.
    weighted = weights * (trunk + 1e-4)
    total = weighted.sum((-1, -2))
    centres = parts[..., CENTRE].astype(np.float64)
    origin = np.einsum("...vr,...vrc->...c", weighted, centres) / np.maximum(total, 1e-12)[..., None]

    by_region = weights.sum(-2)
    middle = np.einsum("...vr,...vrc->...rc", weights, centres) / np.maximum(by_region, 1e-12)[..., None]
    both = np.minimum(by_region[..., _LEFT], by_region[..., _RIGHT]) / _PAIR_M
    left = np.einsum("...p,...pc->...c", both, middle[..., _LEFT, :] - middle[..., _RIGHT, :])
    facing = np.einsum("...vr,...vrc->...rc", weights, parts[..., TOWARDS].astype(np.float64))
    left = left + facing[..., _LEFT, :].sum(-2) - facing[..., _RIGHT, :].sum(-2)
    forward = facing[..., _FRONT, :].sum(-2) - facing[..., _BACK, :].sum(-2)
    x = forward[..., 0] + left[..., 1]
    y = forward[..., 1] - left[..., 0]
    length = np.hypot(x, y)
    told = length > 1e-9
    x, y = np.where(told, x, 1) / np.where(told, length, 1), np.where(told, y, 0) / np.where(told, length, 1)
    return BodyFrame(origin, yaw_matrix(x, -y))


def yaw_matrix(cosine: Float[ndarray, "*n"] | float, sine: Float[ndarray, "*n"] | float) -> Float[ndarray, "*n 3 3"]:
    """Turns about z."""
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    rows = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one], -1)
    return rows.reshape(*rows.shape[:-1], 3, 3)


def moved(
    parts: Float32[ndarray, "*n 61 16"], turn: Float[ndarray, "*n 3 3"], shift: Float[ndarray, "*n 3"]
) -> Float32[ndarray, "*n 61 16"]:
    """Parts of points that are turned about the origin, then shifted; unseen rows stay 0."""
    out = parts.copy()
    back = np.swapaxes(turn, -1, -2).astype(np.float32)
    out[..., CENTRE] = parts[..., CENTRE] @ back + shift[..., None, :].astype(np.float32)
    out[..., TOWARDS] = parts[..., TOWARDS] @ back
    full = parts[..., COVARIANCE][..., _SYMMETRIC]
    full = np.swapaxes(back, -1, -2)[..., None, :, :] @ full @ back[..., None, :, :]
    out[..., COVARIANCE] = full[..., _UPPER[0], _UPPER[1]]
    out[~seen_parts(parts)] = 0
    return out


def network_inputs(
    parts: Float32[ndarray, "*n views 61 16"], frame: BodyFrame
) -> tuple[Float32[ndarray, "*n views 61 16"], Bool[ndarray, "*n views 61"]]:
    """Parts in the body's frame with columns of about unit size, and which were seen."""
    turn = np.broadcast_to(frame.turn[..., None, :, :], (*parts.shape[:-2], 3, 3))
    shift = -np.einsum("...ij,...j->...i", frame.turn, frame.origin)
    out = moved(parts, turn, np.broadcast_to(shift[..., None, :], (*parts.shape[:-2], 3)))
    seen = seen_parts(parts)
    out[..., COUNT] = np.log1p(out[..., COUNT]) / 5
    out[..., AREA] = np.sqrt(out[..., AREA]) * 5
    cov = out[..., COVARIANCE]
    deviations = np.sqrt(np.maximum(cov[..., [0, 3, 5]], 1e-8))
    for column, (a, b) in zip((1, 2, 4), ((0, 1), (0, 2), (1, 2)), strict=True):
        cov[..., column] /= deviations[..., a] * deviations[..., b]
    cov[..., [0, 3, 5]] = deviations * 10
    out[~seen] = 0
    return out, seen
