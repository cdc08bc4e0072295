"""An existing rig against one found from a recording: the camera that was bumped is named."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from walker import stand

from depthmocap.calibration.rig_check import RigCheck, check_rig
from depthmocap.calibration.verdict import PairVerdict
from depthmocap.geometry import DepthCamera, Rig

RIG = Rig(tuple(DepthCamera(f"cam{i}", 320, 288, 252.0, 252.0, 160.0, 144.0, stand(120.0 * i)) for i in range(3)))
PATH = np.array([[0.1, 0.0, 1.0], [-0.1, 0.2, 1.0], [0.0, -0.1, 1.0]])


def check(count: int = 3, uncertainty_mm: float = 8.0, cm: float = 0.0, degrees: float = 0.0) -> RigCheck:
    """Of a rig that is found in another world, in which cam1 was moved."""
    world = np.eye(4)
    world[:3, :3] = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    world[:3, 3] = 1, 2, 0
    bump = np.eye(4)
    bump[:3, :3] = Rotation.from_rotvec(np.deg2rad([0, degrees, 0])).as_matrix()
    bump[0, 3] = cm / 100
    cameras = tuple(
        dataclasses.replace(each, world_from_camera=world @ each.world_from_camera @ (bump if i == 1 else np.eye(4)))
        for i, each in enumerate(RIG.cameras[:count])
    )
    pairs = [
        PairVerdict((f"cam{a}", f"cam{b}"), 90, 90, 20.0, 2.0, 100, 2.0, uncertainty_mm, 0.3)
        for a in range(count)
        for b in range(a + 1, count)
    ]
    trajectory = PATH @ world[:3, :3].T + world[:3, 3]
    return check_rig(RIG, Rig(cameras), pairs, trajectory, {"cam9": "it has no frames"}, ["walk"])


def test_a_rig_that_is_right_is_good() -> None:
    found = check()
    assert [camera.state for camera in found.cameras] == ["good", "good", "good", "unknown"]
    assert max(pair.cm for pair in found.pairs) < 0.01
    assert found.cameras[3].reason == "it has no frames"


@pytest.mark.parametrize(("cm", "degrees"), [(4.0, 0.0), (0.0, 2.5), (30.0, 15.0)])
def test_the_bumped_camera_is_named_with_how_far(cm: float, degrees: float) -> None:
    found = check(cm=cm, degrees=degrees)
    assert [camera.state for camera in found.cameras[:3]] == ["good", "bumped", "good"]
    assert found.cameras[1].degrees == pytest.approx(degrees, abs=0.01)
    if not degrees:
        assert found.cameras[1].cm == pytest.approx(cm, abs=0.01)


def test_of_two_cameras_both_are_named() -> None:
    found = check(2, cm=5.0)
    assert [camera.state for camera in found.cameras[:2]] == ["bumped", "bumped"]
    assert found.cameras[0].reason == "or camera 'cam1': it cannot be told which"


def test_what_is_not_known_well_enough_is_neither_good_nor_bumped() -> None:
    assert {camera.state for camera in check(uncertainty_mm=60.0, cm=4.0).cameras} == {"unknown"}
