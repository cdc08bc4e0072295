"""How good a calibration is, in numbers that a user can judge, and what would make it better."""

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
from depthmocap.calibration.pairs import AGREES_M, LEAST_JOINTS, align, usable
from depthmocap.calibration.refine import Refined
from depthmocap.geometry import transform_points
from depthmocap.text import cameras

Grade = Literal["good", "fair", "poor"]
#: Bounds of grades on the uncertainty of a pair: where it puts the person (metres), and its turn (degrees).
GOOD, FAIR = (0.010, 0.5), (0.030, 1.5)
#: Standard deviations that are told (two fell short in two of eight generated recordings), and errors of surfaces that
#: no repetition tells (metres, degrees).
_DEVIATIONS, _LEAST_M, _LEAST_DEG = 3.0, 0.001, 0.02
#: A camera that shares fewer poses than this with its best partner is warned of, or agrees in fewer of them.
FEW_POSES, FEW_AGREED = 60, 0.6
#: A person whose middle keeps within this tells little of turns (metres, standard deviation).
NARROW_M = 0.15
#: A camera is said to be out of step if it is by this (s), and by so many standard errors.
LATE_S, LATE_ERRORS = 0.008, 3.0


@dataclasses.dataclass(frozen=True)
class PairVerdict:
    """What is known of two cameras.

    Attributes:
        shared_poses: frames that show the person to both. ``agreed_poses``: in which the skeletons agree.
        joints_apart_mm: median distance of one joint as both see it. ``turned_deg``: median turn of one skeleton
            against the other, pose by pose. Both are mostly errors of single views, not of the calibration.
        surface_points: points of walls, floor and person that both see, and ``surfaces_apart_mm`` their median
            distance; None where there are too few, or they were not used.
        uncertainty_mm: where the person is to one camera as seen by the other, and ``uncertainty_deg`` the turn between
            the two: the true ones are hardly further away (three standard deviations).
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

    @property
    def grade(self) -> Grade:
        """In one word."""
        grades: tuple[tuple[Grade, tuple[float, float]], ...] = (("good", GOOD), ("fair", FAIR))
        for grade, (metres, degrees) in grades:
            if self.uncertainty_mm <= 1e3 * metres and self.uncertainty_deg <= degrees:
                return grade
        return "poor"


def judge_pairs(names: Sequence[str], placement: Placement, refined: Refined) -> list[PairVerdict]:
    """Every pair of placed cameras; ``names`` are theirs, in order."""
    seen, poses = placement.skeletons, refined.poses
    middle = np.nanmedian(mean_joints(poses, seen)[:, JOINT_INDEX["Hip"]], axis=0)
    places = [transform_points(pose, joints) for pose, joints in zip(poses, seen.joints, strict=True)]
    known = usable(seen.joints, seen.sigma_m)
    verdicts = []
    for a, b in itertools.combinations(range(len(names)), 2):
        both = known[a] & known[b]
        frames = np.flatnonzero(both.sum(1) >= LEAST_JOINTS)
        apart = np.where(both, np.linalg.norm(places[a] - places[b], axis=-1), np.nan)
        agreed = [frame for frame in frames if np.nanmedian(apart[frame]) < AGREES_M]
        turns = [
            _turn_deg(places[a][frame][both[frame]], places[b][frame][both[frame]])
            for frame in agreed[:: max(len(agreed) // 100, 1)]
        ]
        off = refined.spread[:, a] - refined.spread[:, b]
        moved = off[:, 3:] + np.cross(off[:, :3], middle)
        points = refined.shared.get((a, b)) if refined.kept else None
        verdicts.append(
            PairVerdict(
                (names[a], names[b]), len(frames), len(agreed),
                1e3 * float(np.nanmedian(apart[agreed])) if agreed else float("nan"),
                float(np.median(turns)) if turns else float("nan"),
                points, None if points is None else 1e3 * refined.apart_m[a, b][1],
                1e3 * _DEVIATIONS * float(np.hypot(_rms(moved), _LEAST_M)),
                _DEVIATIONS * float(np.hypot(np.rad2deg(_rms(off[:, :3])), _LEAST_DEG)),
            )
        )  # fmt: skip
    return verdicts


def warnings_of(names: Sequence[str], placement: Placement, pairs: Sequence[PairVerdict]) -> list[str]:
    """What makes a calibration worse than it could be, one line each, with the way out."""
    found = []
    best_of = {name: max((p for p in pairs if name in p.cameras), key=lambda pair: pair.agreed_poses) for name in names}
    few = [name for name, best in best_of.items() if best.agreed_poses < FEW_POSES]
    if few:
        most = max(best_of[name].agreed_poses for name in few)
        found.append(
            f"{cameras(few)} {'share' if len(few) > 1 else 'shares'} at most {most} poses with any other: walk for "
            "longer where two see the whole body"
        )
    for name, best in best_of.items():
        other = best.cameras[best.cameras[0] == name]
        if name not in few and best.agreed_poses < FEW_AGREED * best.shared_poses:
            found.append(
                f"camera {name!r} agrees with {other!r} in only {best.agreed_poses} of {best.shared_poses} poses: let "
                "one person only be in view, and see that the camera did not move"
            )
    hips = mean_joints(placement.poses, placement.skeletons)[:, JOINT_INDEX["Hip"]]
    hips = hips[np.isfinite(hips).all(1)]
    if np.sqrt(np.linalg.eigvalsh(np.cov(hips.T))[1]) < NARROW_M:
        found.append("the person kept near to one place or line: walk over the whole floor that the cameras see")
    for name, late_s, error_s in zip(names, placement.late_s, placement.late_sigma_s, strict=True):
        if abs(late_s) > max(LATE_S, LATE_ERRORS * error_s):
            found.append(
                f"camera {name!r} looks {1e3 * abs(late_s):.0f} ± {1e3 * error_s:.0f} ms "
                f"{'later' if late_s > 0 else 'earlier'} than its timestamps say, against the mean of all; the "
                "calibration allows for it, motion capture does not"
            )
    return found


def _turn_deg(a: Float[ndarray, "n 3"], b: Float[ndarray, "n 3"]) -> float:
    turn = align(a, b, np.ones(len(a)))[:3, :3]
    return float(np.rad2deg(Rotation.from_matrix(turn).magnitude()))


def _rms(vectors: Float[ndarray, "n 3"]) -> float:
    return float(np.sqrt((vectors**2).sum(1).mean()))
