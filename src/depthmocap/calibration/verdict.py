"""The quality of a calibration: the uncertainty of each pair of cameras, grades, and warnings."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.camera_placement import Placement, mean_joints
from depthmocap.calibration.pairs import AGREES_M, LEAST_JOINTS, align, usable_joints
from depthmocap.calibration.refine import RefinedPlacement
from depthmocap.geometry import transform_points
from depthmocap.text import camera_list

Grade = Literal["good", "fair", "poor"]
#: Largest uncertainty of a good pair: of the person's position (metres) and of the rotation (degrees).
GOOD = (0.010, 0.5)
#: The same of a fair pair.
FAIR = (0.030, 1.5)
#: Standard deviations in the stated uncertainty: two were too few in two of eight generated recordings.
_SIGMAS = 3.0
#: Systematic error of surfaces, which the bootstrap does not see: position (metres)
_LEAST_M = 0.001
#: and rotation (degrees).
_LEAST_DEG = 0.02
#: Fewer poses shared with its best partner cause a warning for a camera,
FEW_POSES = 60
#: and so does a smaller share of them that agrees.
FEW_AGREED = 0.6
#: If the person moves less than this (metres, standard deviation), rotations are poorly determined.
NARROW_M = 0.15
#: A time offset of a camera above this (seconds),
OFFSET_S = 0.008
#: and above this many standard errors, causes a warning.
OFFSET_SIGMAS = 3.0


@dataclasses.dataclass(frozen=True)
class PairVerdict:
    """The quality of the relative pose of two cameras.

    Attributes:
        shared_poses: number of frames in which both see the person.
        agreed_poses: number of these in which the skeletons agree.
        joints_apart_mm: median distance between the positions of a joint in both cameras.
        turned_deg: median rotation between the two skeletons of a frame. This and the distance are mostly errors of
            single views, not of the calibration.
        surface_points: number of corresponding points of walls, floor and person; None if too few, or not used.
        surfaces_apart_mm: their median distance; None as above.
        uncertainty_mm: of the person's position in one camera as seen by the other (three standard deviations).
        uncertainty_deg: of the rotation between the two cameras (three standard deviations).
        time_told: False if their timestamps are apart, but it cannot be told by how much: such a pair is poor.
    """

    cameras: tuple[str, str]
    shared_poses: int
    agreed_poses: int
    joints_apart_mm: float
    turned_deg: float
    surface_points: int | None
    surfaces_apart_mm: float | None
    uncertainty_mm: float
    uncertainty_deg: float
    time_told: bool = True

    @property
    def grade(self) -> Grade:
        """The grade of the pair's uncertainty."""
        if not self.time_told:
            return "poor"
        grades: tuple[tuple[Grade, tuple[float, float]], ...] = (("good", GOOD), ("fair", FAIR))
        for grade, (metres, degrees) in grades:
            if self.uncertainty_mm <= 1e3 * metres and self.uncertainty_deg <= degrees:
                return grade
        return "poor"


def judge_pairs(names: Sequence[str], placement: Placement, refined: RefinedPlacement) -> list[PairVerdict]:
    """The verdicts of all pairs of placed cameras, whose names are ``names``, in order."""
    skeletons, poses = placement.skeletons, refined.poses
    middle = np.nanmedian(mean_joints(poses, skeletons)[:, JOINT_INDEX["Hip"]], axis=0)
    positions = [transform_points(pose, joints) for pose, joints in zip(poses, skeletons.joints, strict=True)]
    known = usable_joints(skeletons.joints, skeletons.sigma_m)
    verdicts = []
    for a, b in itertools.combinations(range(len(names)), 2):
        common = known[a] & known[b]
        frames = np.flatnonzero(common.sum(1) >= LEAST_JOINTS)
        distances = np.where(common, np.linalg.norm(positions[a] - positions[b], axis=-1), np.nan)
        agreed = [frame for frame in frames if np.nanmedian(distances[frame]) < AGREES_M]
        turns = [
            _turn_deg(positions[a][frame][common[frame]], positions[b][frame][common[frame]])
            for frame in agreed[:: max(len(agreed) // 100, 1)]
        ]
        difference = refined.twist_samples[:, a] - refined.twist_samples[:, b]
        displacement = difference[:, 3:] + np.cross(difference[:, :3], middle)
        points = refined.shared_points.get((a, b)) if refined.surfaces_used else None
        verdicts.append(
            PairVerdict(
                (names[a], names[b]), len(frames), len(agreed),
                1e3 * float(np.nanmedian(distances[agreed])) if agreed else float("nan"),
                float(np.median(turns)) if turns else float("nan"),
                points, None if points is None else 1e3 * refined.distances_m[a, b][1],
                1e3 * _SIGMAS * float(np.hypot(_rms(displacement), _LEAST_M)),
                _SIGMAS * float(np.hypot(np.rad2deg(_rms(difference[:, :3])), _LEAST_DEG)),
                (a, b) not in placement.untold,
            )
        )  # fmt: skip
    return verdicts


def find_warnings(names: Sequence[str], placement: Placement, pairs: Sequence[PairVerdict]) -> list[str]:
    """What makes a calibration worse than it could be, one line each, with a remedy."""
    warnings = []
    best_of = {name: max((p for p in pairs if name in p.cameras), key=lambda pair: pair.agreed_poses) for name in names}
    few = [name for name, best in best_of.items() if best.agreed_poses < FEW_POSES]
    if few:
        most = max(best_of[name].agreed_poses for name in few)
        warnings.append(
            f"{camera_list(few)} {'share' if len(few) > 1 else 'shares'} at most {most} poses with any other: walk for "
            "longer where two see the whole body"
        )
    for name, best in best_of.items():
        other = best.cameras[best.cameras[0] == name]
        if name not in few and best.agreed_poses < FEW_AGREED * best.shared_poses:
            warnings.append(
                f"camera {name!r} agrees with {other!r} in only {best.agreed_poses} of {best.shared_poses} poses: let "
                "one person only be in view, and see that the camera did not move"
            )
    hips = mean_joints(placement.poses, placement.skeletons)[:, JOINT_INDEX["Hip"]]
    hips = hips[np.isfinite(hips).all(1)]
    if len(hips) > 1 and np.sqrt(np.linalg.eigvalsh(np.cov(hips.T))[1]) < NARROW_M:
        warnings.append("the person kept near to one place or line: walk over the whole floor that the cameras see")
    for a, b in placement.untold:
        warnings.append(
            f"cannot tell the time offset of {camera_list([names[a], names[b]])}: their clocks jump, or the person "
            "moved too evenly or too little to tell; put their clocks in step, and walk in turns and straight lines "
            "with the arms moving"
        )
    for name, offset_s in late_cameras(names, placement).items():
        error_s = placement.offset_sigma_s[names.index(name)]
        warnings.append(
            f"camera {name!r} looks {1e3 * abs(offset_s):.0f} ± {1e3 * error_s:.0f} ms "
            f"{'later' if offset_s > 0 else 'earlier'} than its timestamps say, against the mean of all; "
            "rig.json tells it as time_offset_s, and run, live and evaluate allow for it"
        )
    return warnings


def late_cameras(names: Sequence[str], placement: Placement) -> dict[str, float]:
    """Time offsets (seconds) that are significant, by camera; none if one of them cannot be told."""
    if placement.untold:
        return {}
    return {
        name: float(offset_s)
        for name, offset_s, error_s in zip(names, placement.offset_s, placement.offset_sigma_s, strict=True)
        if abs(offset_s) > max(OFFSET_S, OFFSET_SIGMAS * error_s)
    }


def _turn_deg(a: Float[ndarray, "n 3"], b: Float[ndarray, "n 3"]) -> float:
    rotation = align(a, b, np.ones(len(a)))[:3, :3]
    return float(np.rad2deg(Rotation.from_matrix(rotation).magnitude()))


def _rms(vectors: Float[ndarray, "n 3"]) -> float:
    return float(np.sqrt((vectors**2).sum(1).mean()))
