"""OpenUSD files, read by usd-core."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from two_people_take import FRAMES, LONG, LOST, SECOND, write_take

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.exporting.export_command import ExportSettings, export
from depthmocap.exporting.target_skeleton import bones_of
from depthmocap.geometry import z_up_from


def pxr(name: str) -> Any:
    """A module of usd-core; the test is skipped without it."""
    return pytest.importorskip(f"pxr.{name}", reason="no usd-core: the extra export brings it")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, np.ndarray]:
    usd = pxr("Usd")
    folder = tmp_path_factory.mktemp("usd")
    truth = write_take(folder / "take")
    export(ExportSettings(folder / "take", folder, formats=("usd",), skeleton="unity", rest="a"))
    return usd.Stage.Open(str(folder / "pose.usd")), truth @ z_up_from("y")


def test_the_stage_is_upright_in_metres(made: tuple[Any, np.ndarray]) -> None:
    geometry = pxr("UsdGeom")
    stage = made[0]
    assert geometry.GetStageUpAxis(stage) == "Y" and geometry.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetTimeCodesPerSecond() == pytest.approx(30, abs=1e-3)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)
    assert stage.GetDefaultPrim().GetCustomData()["start_s"] == 0
    held = stage.GetPrimAtPath("/take/person_1").GetCustomData()["held"]
    assert str([LONG[0], LONG[-1]]) in held["RHand"] and held["Hip"] == str([[LOST[0], LOST[-1]]])


@pytest.mark.parametrize("person", [0, 1])
def test_joints_and_skin(made: tuple[Any, np.ndarray], person: int) -> None:
    geometry, skel = pxr("UsdGeom"), pxr("UsdSkel")
    stage, truth = made
    root = skel.Root(stage.GetPrimAtPath(f"/take/person_{person + 1}"))
    cache = skel.Cache()
    assert cache.Populate(root, pxr("Usd").PrimDefaultPredicate)
    query = cache.GetSkelQuery(skel.Skeleton(root.GetPrim().GetChild(f"person_{person + 1}_skeleton")))
    mesh = geometry.Mesh(root.GetPrim().GetChild(f"person_{person + 1}_body"))
    skinning = cache.GetSkinningQuery(mesh.GetPrim())
    bone_joints = [bone.joint for bone in bones_of("unity")]
    for frame in (SECOND[0], SECOND[3], SECOND[-1]):
        at = np.array([matrix.ExtractTranslation() for matrix in query.ComputeJointSkelTransforms(frame)])
        own = [bone_joints.index(joint) for joint in JOINTS]
        seen = [i for i in range(len(JOINTS)) if person or frame not in LONG or i != JOINT_INDEX["RHand"]]
        np.testing.assert_allclose(at[own][seen], truth[person, frame][seen], atol=1e-3)
        points = mesh.GetPointsAttr().Get()
        assert skinning.ComputeSkinnedPoints(query.ComputeSkinningTransforms(frame), points, frame)
        skin = np.array(points)
        away = np.linalg.norm(
            skin[:, None] - truth[person, frame, [JOINT_INDEX["LKnee"], JOINT_INDEX["Head"]]], axis=-1
        )
        assert (away.min(0) < 0.1).all() and (away.min(0) > 0.01).all()  # a knee and a skull have a thickness
    shown = [geometry.Imageable(root).ComputeVisibility(frame) for frame in (0, SECOND[2], FRAMES - 1)]
    assert shown == (["inherited"] * 3 if person == 0 else ["invisible", "inherited", "invisible"])
