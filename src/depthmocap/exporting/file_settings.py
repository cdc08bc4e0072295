"""What files of a take are written, and how: one set of options of ``run``, ``live`` and ``export``."""

from __future__ import annotations

import dataclasses
from typing import Literal

from depthmocap.core.settings import check_at_least
from depthmocap.errors import InputError
from depthmocap.exporting.target_skeleton import RestPose, SkeletonName
from depthmocap.exporting.timeline import LEAST_CONFIDENCE

BvhUnit = Literal["cm", "m"]
FormatName = Literal["csv", "trc", "bvh", "npz", "osim", "mot", "c3d", "glb", "usd", "fbx"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class FileSettings:
    """The files of a take.

    Attributes:
        formats: of files besides pose.csv, which is always there: trc, bvh, npz, osim (OpenSim's model) and mot (its
            inverse kinematics) for every person, c3d, glb, usd and fbx with everybody in one file; csv adds the
            bones' rotations to pose.csv.
        skeleton: names of the bones in bvh, glb, usd and fbx.
        rest: the pose at rest in bvh, glb, usd and fbx: T, or A with arms 45 degrees down.
        bvh_unit: of lengths in bvh; Blender takes numbers for metres.
        least_confidence: joints below it are gaps in trc, c3d and npz, and are held in bvh, glb, usd and fbx;
            pose.csv has all.
        fill_s: gaps of a joint up to so long (s) are filled by interpolation over time.
        landmarks: surface landmarks (crown, toes, finger tips, iliac spines, epicondyles, malleoli …) as virtual
            markers in csv, trc, c3d, osim and mot, beside the joints; npz always has them.
    """

    formats: tuple[FormatName, ...] = ("trc", "bvh")
    skeleton: SkeletonName = "depthmocap"
    rest: RestPose = "t"
    bvh_unit: BvhUnit = "cm"
    least_confidence: float = LEAST_CONFIDENCE
    fill_s: float = 0.0
    landmarks: bool = False

    def check(self) -> None:
        """
        Raises:
            InputError: when a setting is out of range.
        """
        if not 0 <= self.least_confidence <= 1:
            raise InputError(f"--least-confidence must be from 0 to 1, got {self.least_confidence}")
        check_at_least(0, {"--fill-s": self.fill_s})
