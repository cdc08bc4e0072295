"""Statistics of each body part in each camera, and the body's frame, in which the votes network reads them.

In the body's frame the trunk points up, whether the person stands, lies or hangs upside down.

The parts are the 43 regions, then the 18 joints. A joint's statistics are the position that the network estimates from
that camera alone.

Unlike the paper's statistics (``features``) these rotate with the points: a person who turns gives the same numbers in
the frame of their body. A sample can be rotated, mirrored or reduced to fewer cameras without its points.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.regions import MIRROR, REGION, REGION_COUNT, REGION_NAMES
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.body.skeleton import MIRROR as MIRRORED_JOINTS
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.geometry.transforms import rotation_between
from depthmocap.kernels.part_moments import part_moments
from depthmocap.pose.cloud import LabelledCloud

#: Columns of a part's statistics in one camera. For a region: number of points, visible area (m²), mean label
#: probability, share of it near the centre, centre (3, m), covariance (xx, xy, xz, yy, yz, zz, m²) and direction to the
#: camera (3). For a joint: 1, 0, a confidence that falls with the expected error, 0, position, covariance of the
#: expected error and direction to the camera.
COUNT, AREA, PROBABILITY, CENTRAL, CENTRE, COVARIANCE, TO_CAMERA = 0, 1, 2, 3, slice(4, 7), slice(7, 13), slice(13, 16)
PART_COLUMNS = 16
PART_COUNT = REGION_COUNT + len(JOINTS)
#: A region with fewer points in a view counts as unobserved there.
MIN_POINTS = 6
#: Distance from a region's centre at which a point counts a quarter (metres): half a thigh.
_SCALE_M = 0.25

#: Column in ``COVARIANCE`` of each element of the symmetric matrix.
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_UPPER = np.triu_indices(3)


def _regions(*names: str) -> ndarray:
    return np.array([REGION[name] - 1 for name in names])


_TORSO = ("chest", "belly", "upper back", "lower back", "collar", "shoulder front", "shoulder back", "thigh")
_RIGHT = _regions(*(f"{name} R" for name in _TORSO))
_LEFT = _regions(*(f"{name} L" for name in _TORSO))
_FRONT = _regions(*(f"{name} {side}" for name in ("chest", "belly", "collar", "shoulder front") for side in "RL"))
_BACK = _regions(*(f"{name} {side}" for name in ("upper back", "lower back", "shoulder back") for side in "RL"))
#: Regions near the two ends of the trunk.
_UPPER_TRUNK = _regions(
    *(
        f"{name} {side}"
        for name in ("chest", "upper back", "collar", "shoulder front", "shoulder back")
        for side in "RL"
    )
)
_LOWER_TRUNK = _regions(*(f"{name} {side}" for name in ("belly", "lower back", "thigh") for side in "RL"))
#: A trunk that leans by less than this is taken as upright (radians): heights tell of limbs then.
_UPRIGHT_RAD = 0.35
#: From here on the frame leans with the trunk (radians), in between by a part of it.
_LEANING_RAD = 0.7
#: A trunk shorter than this has no direction (metres).
_LEAST_TRUNK_M = 0.02
#: ``parts[..., MIRRORED, :]`` exchanges the sides.
MIRRORED = np.concatenate([MIRROR[1:].astype(np.int64) - 1, REGION_COUNT + MIRRORED_JOINTS])
assert len(REGION_NAMES) == REGION_COUNT + 1


def _limb(regions: tuple[str, ...], joints: tuple[str, ...]) -> Bool[ndarray, "61"]:
    members = np.zeros(PART_COUNT, bool)
    members[_regions(*(f"{name} {side}" for name in regions for side in "RL"))] = True
    members[[REGION_COUNT + JOINT_INDEX[side + name] for name in joints for side in "RL"]] = True
    return members


#: The parts of the arms, and those of the legs: a classifier mistakes them for the other side's together.
ARMS = _limb(("upper arm", "elbow", "forearm", "wrist", "hand"), ("Elbow", "Hand"))
LEGS = _limb(("thigh", "knee", "shin", "ankle", "forefoot"), ("Knee", "Foot"))
#: Expected error of a joint with a probability of a half (metres).
_TYPICAL_ERROR_M = 0.1
#: Typical distance of the left and right regions of a pair (metres): weighs pairs against single regions.
_PAIR_M = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class BodyFrame:
    """The body's frame of each sample: origin near the middle of the trunk (metres), ``x`` forwards, ``y`` to the
    body's left, ``z`` up, along the trunk of people who lean. ``point_body = rotation @ (point - origin)``."""

    origin: Float[ndarray, "*n 3"]
    rotation: Float[ndarray, "*n 3 3"]

    def from_world(self, points: Float[ndarray, "*n j 3"]) -> Float[ndarray, "*n j 3"]:
        """Points of the Z-up world in the body's frame."""
        return (points - self.origin[..., None, :]) @ np.swapaxes(self.rotation, -1, -2)

    def to_world(self, points: Float[ndarray, "*n j 3"]) -> Float[ndarray, "*n j 3"]:
        """Points of the body's frame in the Z-up world."""
        return points @ self.rotation + self.origin[..., None, :]


def part_statistics(cloud: LabelledCloud, up: str = "z") -> Float32[ndarray, "views 61 16"]:
    """Statistics of each part in each camera, in the world rotated Z-up; rows of unobserved parts are 0.

    Raises:
        InputError: for another ``up``, a cloud without cameras, a label outside 1–43 or a point that is not finite.
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
    for rows, joints, camera in zip(parts, cloud.joints, cloud.cameras, strict=False):
        if joints is not None and np.isfinite(joints).all():
            rows[REGION_COUNT:] = _joint_rows(joints, rotation, rotation @ camera.world_from_camera[:3, 3])
    end = 0
    for rows, size, camera in zip(parts[:, :REGION_COUNT], cloud.view_sizes, cloud.cameras, strict=True):
        start, end = end, end + size
        if not size:
            continue
        moments = part_moments(
            cloud.points_world[start:end], cloud.labels[start:end], cloud.weights[start:end], rotation, REGION_COUNT,
            _SCALE_M,
        )  # fmt: skip
        observed = moments[:, 0] >= MIN_POINTS
        count, total, near = moments[observed, 0], moments[observed, 1], moments[observed, 2]
        centre = moments[observed, 3:6]
        to_camera = rotation @ camera.world_from_camera[:3, 3] - centre
        distance = np.linalg.norm(to_camera, axis=1)
        rows[observed] = np.column_stack(
            [
                count,
                count * distance**2 / (camera.fx * camera.fy),
                total / count,
                near / total,
                centre,
                moments[observed, 6:],
                to_camera / distance[:, None],
            ]
        )
    return parts


def _joint_rows(
    joints: Float[ndarray, "18 4"], rotation: Float[ndarray, "3 3"], eye: Float[ndarray, "3"]
) -> Float[ndarray, "18 16"]:
    centre, expected_m = joints[:, :3] @ rotation.T, joints[:, 3]
    to_camera = eye - centre
    rows = np.zeros((len(joints), PART_COLUMNS))
    rows[:, COUNT] = 1
    rows[:, PROBABILITY] = 1 / (1 + expected_m / _TYPICAL_ERROR_M)
    rows[:, CENTRE] = centre
    rows[:, COVARIANCE] = expected_m[:, None] ** 2 * [1, 0, 0, 1, 0, 1]
    rows[:, TO_CAMERA] = to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True)
    return rows


def observed_parts(parts: Float32[ndarray, "*n 61 16"]) -> Bool[ndarray, "*n 61"]:
    """Whether each camera observed each part."""
    return parts[..., COUNT] > 0


def body_frame(parts: Float32[ndarray, "*n views 61 16"]) -> BodyFrame:
    """The body's frame, in which the trunk of people who lean points up: the more so the more they lean.

    Where the trunk points is told by the joints of the cameras, and without these by the regions of the trunk. People
    who stand have the frame of their heading (:func:`heading_frame`).
    """
    turns = _turns_up(_trunk_direction(parts))
    if not turns.any():
        return heading_frame(parts)
    turn = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(*turns.shape, 3)
    of_views = np.broadcast_to(turn[..., None, :, :], (*parts.shape[:-2], 3, 3))
    turned = heading_frame(transform_parts(parts, of_views, np.zeros((*parts.shape[:-2], 3))))
    return BodyFrame(np.einsum("...ji,...j->...i", turn, turned.origin), turned.rotation @ turn)


def _trunk_direction(parts: Float32[ndarray, "*n views 61 16"]) -> Float[ndarray, "*n 3"]:
    """Unit vector from the hips to the neck; up where neither joints nor regions of the trunk are known."""
    hips, neck = (parts[..., REGION_COUNT + JOINT_INDEX[name], :] for name in ("Hip", "Neck"))
    sure = (hips[..., PROBABILITY] * neck[..., PROBABILITY]).astype(np.float64)
    of_joints = np.einsum("...v,...vc->...c", sure, (neck - hips)[..., CENTRE].astype(np.float64))

    regions = parts[..., :REGION_COUNT, :]
    weights = (regions[..., AREA] * regions[..., PROBABILITY]).astype(np.float64)
    shares = []
    for ends in (_UPPER_TRUNK, _LOWER_TRUNK):
        of_end = weights[..., ends]
        total = of_end.sum((-1, -2))[..., None]
        centres = np.einsum("...vr,...vrc->...c", of_end, regions[..., ends, CENTRE].astype(np.float64))
        shares.append(np.where(total > 0, centres / np.maximum(total, 1e-12), np.nan))
    upper, lower = shares
    direction = np.where(sure.any(-1, keepdims=True), of_joints, upper - lower)
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    known = length > _LEAST_TRUNK_M  # not NaN
    return np.where(known, direction / np.where(known, length, 1), [0.0, 0.0, 1.0])


def _turns_up(trunk: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
    """Rotation vectors that turn leaning trunks (unit vectors) up the shortest way; 0 for those that hardly lean."""
    trunks = trunk.reshape(-1, 3)
    whole = Rotation.from_matrix(rotation_between(trunks, np.broadcast_to([0.0, 0.0, 1.0], trunks.shape))).as_rotvec()
    lean = np.linalg.norm(whole, axis=1, keepdims=True)
    share = np.clip((lean - _UPRIGHT_RAD) / (_LEANING_RAD - _UPRIGHT_RAD), 0, 1)
    return (share * whole).reshape(trunk.shape)


def heading_frame(parts: Float32[ndarray, "*n views 61 16"]) -> BodyFrame:
    """The frame of the body's heading, with the world's vertical, from the observed regions of the trunk.

    Its origin is the mean of the centres, weighted by area and probability. Its direction is the sum of three cues:
    from the right regions to the left ones, from the cameras that see the back to those that see the front, and from
    those that see the right to those that see the left. Without any of them it faces along the world's x.
    """
    parts = parts[..., :REGION_COUNT, :]
    weights = (parts[..., AREA] * parts[..., PROBABILITY]).astype(np.float64)
    trunk = np.zeros(REGION_COUNT)
    trunk[np.concatenate([_LEFT, _RIGHT])] = 1
    # Where no trunk was observed, the whole body replaces it.
    weighted = weights * (trunk + 1e-4)
    total = weighted.sum((-1, -2))
    centres = parts[..., CENTRE].astype(np.float64)
    origin = np.einsum("...vr,...vrc->...c", weighted, centres) / np.maximum(total, 1e-12)[..., None]

    by_region = weights.sum(-2)
    middle = np.einsum("...vr,...vrc->...rc", weights, centres) / np.maximum(by_region, 1e-12)[..., None]
    both = np.minimum(by_region[..., _LEFT], by_region[..., _RIGHT]) / _PAIR_M
    left = np.einsum("...p,...pc->...c", both, middle[..., _LEFT, :] - middle[..., _RIGHT, :])
    facing = np.einsum("...vr,...vrc->...rc", weights, parts[..., TO_CAMERA].astype(np.float64))
    left = left + facing[..., _LEFT, :].sum(-2) - facing[..., _RIGHT, :].sum(-2)
    forward = facing[..., _FRONT, :].sum(-2) - facing[..., _BACK, :].sum(-2)
    x = forward[..., 0] + left[..., 1]
    y = forward[..., 1] - left[..., 0]
    length = np.hypot(x, y)
    known = length > 1e-9
    x, y = np.where(known, x, 1) / np.where(known, length, 1), np.where(known, y, 0) / np.where(known, length, 1)
    return BodyFrame(origin, yaw_matrix(x, -y))


def yaw_matrix(cosine: Float[ndarray, "*n"] | float, sine: Float[ndarray, "*n"] | float) -> Float[ndarray, "*n 3 3"]:
    """Rotations about z."""
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    rows = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one], -1)
    return rows.reshape(*rows.shape[:-1], 3, 3)


def transform_parts(
    parts: Float32[ndarray, "*n 61 16"], rotation: Float[ndarray, "*n 3 3"], shift: Float[ndarray, "*n 3"]
) -> Float32[ndarray, "*n 61 16"]:
    """Statistics of the points rotated about the origin, then shifted; rows of unobserved parts stay 0."""
    rows = parts.copy()
    back = np.swapaxes(rotation, -1, -2).astype(np.float32)
    rows[..., CENTRE] = parts[..., CENTRE] @ back + shift[..., None, :].astype(np.float32)
    rows[..., TO_CAMERA] = parts[..., TO_CAMERA] @ back
    full = parts[..., COVARIANCE][..., _SYMMETRIC]
    full = np.swapaxes(back, -1, -2)[..., None, :, :] @ full @ back[..., None, :, :]
    rows[..., COVARIANCE] = full[..., _UPPER[0], _UPPER[1]]
    rows[~observed_parts(parts)] = 0
    return rows


def network_inputs(
    parts: Float32[ndarray, "*n views 61 16"], frame: BodyFrame
) -> tuple[Float32[ndarray, "*n views 61 16"], Bool[ndarray, "*n views 61"]]:
    """Statistics in the body's frame, scaled to about unit size, and the mask of observed parts."""
    rotation = np.broadcast_to(frame.rotation[..., None, :, :], (*parts.shape[:-2], 3, 3))
    shift = -np.einsum("...ij,...j->...i", frame.rotation, frame.origin)
    rows = transform_parts(parts, rotation, np.broadcast_to(shift[..., None, :], (*parts.shape[:-2], 3)))
    observed = observed_parts(parts)
    rows[..., COUNT] = np.log1p(rows[..., COUNT]) / 5
    rows[..., AREA] = np.sqrt(rows[..., AREA]) * 5
    cov = rows[..., COVARIANCE]
    deviations = np.sqrt(np.maximum(cov[..., [0, 3, 5]], 1e-8))
    for column, (a, b) in zip((1, 2, 4), ((0, 1), (0, 2), (1, 2)), strict=True):
        cov[..., column] /= deviations[..., a] * deviations[..., b]
    cov[..., [0, 3, 5]] = deviations * 10
    rows[~observed] = 0
    return rows, observed
