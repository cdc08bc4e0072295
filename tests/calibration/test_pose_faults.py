"""Extrinsics that are wrong in a known way are told, with the pose that would be right; right ones are not."""

import dataclasses

import numpy as np
import pytest
from walker import stand, track

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.mending import mend_poses
from depthmocap.calibration.pose_faults import WAYS, PoseFault, find_pose_faults
from depthmocap.geometry import DepthCamera, Rig, rigid_inverse

TIMES_S = np.arange(0, 8, 0.4)
TRUE = [stand(azimuth, height) for azimuth, height in ((10, 1.4), (130, 1.9), (245, 1.6))]

#: What a program writes of a true pose.
WRITTEN = {
    "inverse": rigid_inverse,
    "opengl": lambda pose: pose @ np.diag([1.0, -1, -1, 1]),
    "inverse opengl": lambda pose: rigid_inverse(pose @ np.diag([1.0, -1, -1, 1])),
    "robotics": lambda pose: (
        pose @ rigid_inverse(np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]))
    ),
    "unity": lambda pose: np.diag([1.0, -1, 1, 1]) @ pose @ np.diag([1.0, -1, 1, 1]),
    "centimetres": lambda pose: np.vstack([np.hstack([pose[:3, :3], 100 * pose[:3, 3:]]), pose[3:]]),
    "millimetres": lambda pose: np.vstack([np.hstack([pose[:3, :3], 1000 * pose[:3, 3:]]), pose[3:]]),
    "turned 180": lambda pose: pose @ np.diag([-1.0, -1, 1, 1]),
    "turned 90": lambda pose: pose @ np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
}


def faults(told: list[np.ndarray], up: str = "z", scale: float = 1.0, seed: int = 0) -> list[PoseFault]:
    """Of cameras that stand where ``TRUE`` says, in a rig that tells other poses."""
    rng = np.random.default_rng(seed)
    cameras = [DepthCamera(f"cam{i}", 320, 288, 252.0, 252.0, 160.0, 144.0, pose) for i, pose in enumerate(told)]
    tracks = [track(pose, TIMES_S, rng) for pose in TRUE[: len(told)]]
    tracks = [JointTrack(one.times_s, one.joints * scale, one.sigma_m) for one in tracks]
    return find_pose_faults(cameras, tracks, up, rng)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("seed", [0, 1])
def test_right_extrinsics_have_no_fault(count: int, seed: int) -> None:
    assert faults(TRUE[:count], seed=seed) == []


@pytest.mark.parametrize("kind", WRITTEN)
def test_the_camera_that_is_wrong_is_told_with_its_true_pose(kind: str) -> None:
    (fault,) = faults([TRUE[0], WRITTEN[kind](TRUE[1]), TRUE[2]])
    assert (fault.kind, fault.cameras) == (kind, ("cam1",))
    assert np.allclose(fault.poses["cam1"], TRUE[1], atol=1e-6)
    assert "cam1" in fault.text and WAYS[kind][0] in fault.text


@pytest.mark.parametrize("kind", ["inverse", "opengl", "inverse opengl", "robotics", "unity"])
@pytest.mark.parametrize("count", [2, 3])
def test_a_convention_that_all_cameras_share_is_told(kind: str, count: int) -> None:
    (fault,) = faults([WRITTEN[kind](pose) for pose in TRUE[:count]])
    assert fault.kind == kind and len(fault.cameras) == count
    for i in range(count):  # the same against each other; the world of some conventions is another one
        between = rigid_inverse(fault.poses["cam0"]) @ fault.poses[f"cam{i}"]
        assert np.allclose(between, rigid_inverse(TRUE[0]) @ TRUE[i], atol=1e-6)


@pytest.mark.parametrize("kind", ["inverse", "opengl", "turned 180"])
def test_of_two_cameras_gravity_tells_which_or_both_are_named(kind: str) -> None:
    (fault,) = faults([TRUE[0], WRITTEN[kind](TRUE[1])])
    assert "cam1" in fault.cameras
    assert np.allclose(fault.poses["cam1"], TRUE[1], atol=1e-6)


def test_a_single_picture_upside_down_is_told_and_a_lying_world_by_its_up() -> None:
    (fault,) = faults([WRITTEN["turned 180"](TRUE[0])])
    assert fault.cameras == ("cam0",) and "180°" in fault.text
    y_up = np.eye(4)
    y_up[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    (fault,) = faults([y_up @ pose for pose in TRUE])
    assert fault.kind == "up" and '"up": "y"' in fault.text
    assert faults([y_up @ pose for pose in TRUE], "y") == []


def test_a_picture_that_is_turned_while_its_intrinsics_are_not_is_told() -> None:
    rng = np.random.default_rng(0)
    camera = DepthCamera("cam1", 320, 288, 252.0, 252.0, 160.7, 165.8, TRUE[1])
    tracks = [track(pose, TIMES_S, rng) for pose in TRUE]
    points = tracks[1].joints
    seen = np.stack(  # u and v are counted from the other end
        [
            points[..., 2] * (319 - 2 * camera.cx) / camera.fx - points[..., 0],
            points[..., 2] * (287 - 2 * camera.cy) / camera.fy - points[..., 1],
            points[..., 2],
        ],
        -1,
    )
    tracks[1] = dataclasses.replace(tracks[1], joints=seen)
    cameras = [dataclasses.replace(camera, name=f"cam{i}", world_from_camera=pose) for i, pose in enumerate(TRUE)]
    (fault,) = find_pose_faults(cameras, tracks, "z", rng)
    assert (fault.kind, fault.cameras) == ("picture turned 180", ("cam1",))
    assert "turned by 180° against its intrinsics" in fault.text


@pytest.mark.parametrize("scale", [0.25, 0.5, 0.7, 2.0])
def test_a_unit_that_all_cameras_share_is_told_by_the_places_of_the_rig(scale: float) -> None:
    (fault,) = faults(TRUE, scale=scale)
    assert fault.kind == "unit" and fault.cameras == ("cam0", "cam1", "cam2")
    assert fault.factor == pytest.approx(1 / scale, rel=0.05)


def test_a_camera_that_was_turned_is_named_alone() -> None:
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(0.26), 0, np.sin(0.26)], [0, 1, 0], [-np.sin(0.26), 0, np.cos(0.26)]]
    (fault,) = faults([TRUE[0], TRUE[1] @ turn, TRUE[2]])
    assert (fault.kind, fault.cameras) == ("elsewhere", ("cam1",))
    assert "by 15°" in fault.text
    assert np.allclose(fault.poses["cam1"], TRUE[1], atol=0.05)


@pytest.mark.parametrize("kind", ["inverse", "opengl", "unity", "turned 90"])
def test_what_is_told_is_mended(kind: str) -> None:
    poses = [TRUE[0], WRITTEN[kind](TRUE[1]), TRUE[2]]
    rng = np.random.default_rng(0)
    tracks = [track(pose, TIMES_S, rng) for pose in TRUE]
    cameras = tuple(DepthCamera(f"cam{i}", 320, 288, 252.0, 252.0, 160.0, 144.0, pose) for i, pose in enumerate(poses))
    rig, mended, left = mend_poses(Rig(cameras), tracks, rng)
    assert len(mended) == 1 and not left
    assert np.allclose(rig["cam1"].world_from_camera, TRUE[1], atol=1e-6)


def test_an_axis_is_mended_and_a_camera_that_stands_elsewhere_is_left() -> None:
    rng = np.random.default_rng(0)
    y_up = np.eye(4)
    y_up[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    tracks = [track(pose, TIMES_S, rng) for pose in TRUE]

    def mend(poses: list[np.ndarray]) -> tuple[Rig, list[str], list[str]]:
        cameras = (DepthCamera(f"cam{i}", 320, 288, 252.0, 252.0, 160.0, 144.0, pose) for i, pose in enumerate(poses))
        return mend_poses(Rig(tuple(cameras)), tracks, rng)

    rig, mended, left = mend([y_up @ pose for pose in TRUE])
    assert rig.up == "y" and len(mended) == 1 and not left
    aside = np.eye(4)
    aside[0, 3] = 0.5
    rig, mended, left = mend([TRUE[0], aside @ TRUE[1], TRUE[2]])
    assert np.array_equal(rig["cam1"].world_from_camera, aside @ TRUE[1]) and not mended and len(left) == 1
    _, mended, left = mend([np.eye(4)] * 3)
    assert not mended and "have the same place" in left[0]


def test_what_cannot_be_told_is_not() -> None:
    rng = np.random.default_rng(0)
    camera = DepthCamera("cam0", 320, 288, 252.0, 252.0, 160.0, 144.0, TRUE[0])
    nobody = JointTrack(np.empty(0), np.empty((0, 18, 3)), np.empty((0, 18)))
    assert find_pose_faults([camera], [nobody], "z", rng) == []
    still = track(TRUE[0], np.zeros(len(TIMES_S)), rng)  # somebody who does not walk, and may lie
    still = dataclasses.replace(still, times_s=TIMES_S)
    sideways = dataclasses.replace(camera, world_from_camera=WRITTEN["turned 90"](TRUE[0]))
    assert find_pose_faults([sideways], [still], "z", rng) == []
