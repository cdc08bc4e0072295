"""Wrong depth units and mirrored pictures are told of the camera that is wrong, and never of right ones."""

import dataclasses

import numpy as np
import pytest
from walker import stand, track

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.picture_faults import PictureFault, find_picture_faults, mirrored, scaled
from depthmocap.geometry import DepthCamera

TIMES_S = np.arange(0, 8, 0.4)
POSES = [stand(azimuth, height) for azimuth, height in ((10, 1.4), (130, 1.9), (245, 1.6), (310, 1.2))]
CAMERAS = [DepthCamera(f"cam{i}", 320, 288, 252.0, 252.0, 163.0, 144.0, pose) for i, pose in enumerate(POSES)]


def faults(count: int, seed: int = 0, size: float = 1.0, **changes) -> list[PictureFault]:
    """Of so many cameras; ``cam1=0.5`` has its lengths halved, ``cam1="mirror"`` is mirrored."""
    rng = np.random.default_rng(seed)
    tracks = [scaled(track(pose, TIMES_S, rng), size) for pose in POSES[:count]]
    for name, change in changes.items():
        i = int(name[-1])
        tracks[i] = mirrored(CAMERAS[i], tracks[i]) if change == "mirror" else scaled(tracks[i], change)
    return find_picture_faults(CAMERAS[:count], tracks, rng)


@pytest.mark.parametrize(("count", "size"), [(1, 0.55), (2, 1.2), (3, 0.55), (4, 1.0)])
def test_right_pictures_have_no_fault_of_a_child_either(count: int, size: float) -> None:
    assert faults(count, size=size) == []


@pytest.mark.parametrize("factor", [0.1, 0.7, 2.0])
def test_the_camera_with_another_unit_is_named_with_its_factor(factor: float) -> None:
    (fault,) = faults(3, cam1=factor)
    assert (fault.kind, fault.cameras, fault.certain) == ("unit", ("cam1",), True)
    assert fault.factor == pytest.approx(1 / factor, rel=0.03)
    assert f"{fault.factor:g}" in fault.text and "'cam1'" in fault.text


@pytest.mark.parametrize(("count", "factor"), [(1, 0.1), (1, 4.0), (2, 0.25), (3, 10.0)])
def test_a_unit_by_which_nobody_can_be_so_large_is_told_of_all(factor: float, count: int) -> None:
    (fault,) = faults(count, size=factor)
    assert fault.kind == "unit" and len(fault.cameras) == count and fault.factor == 1 / factor
    assert f"a depth unit of {0.001 / factor:g} m instead of 0.001 m" in fault.text


def test_of_two_cameras_both_are_named_unless_one_cannot_be() -> None:
    (fault,) = faults(2, cam1=0.7)
    assert fault.cameras == ("cam0", "cam1") and not fault.certain
    (fault,) = faults(2, cam1=0.25)
    assert fault.cameras == ("cam1",) and fault.factor == 4


def test_a_mirrored_picture_is_told() -> None:
    (fault,) = faults(3, cam1="mirror")
    assert (fault.kind, fault.cameras, fault.certain) == ("mirror", ("cam1",), True)
    (fault,) = faults(2, cam1="mirror")
    assert (fault.kind, fault.cameras, fault.certain) == ("mirror", ("cam0", "cam1"), False)


def test_what_cannot_be_told_is_not() -> None:
    assert faults(1, cam0="mirror") == []
    assert faults(2, cam0="mirror", cam1="mirror") == []
    assert faults(1, cam0=0.7) == []
    rng = np.random.default_rng(0)
    nothing = JointTrack(np.empty(0), np.empty((0, 18, 3)), np.empty((0, 18)))
    assert find_picture_faults(CAMERAS[:2], [nothing, track(POSES[1], TIMES_S, rng)], rng) == []
    unknown = dataclasses.replace(track(POSES[0], TIMES_S, rng), joints=np.full((len(TIMES_S), 18, 3), np.nan))
    assert find_picture_faults(CAMERAS[:2], [unknown, track(POSES[1], TIMES_S, rng)], rng) == []


def test_two_faults_of_different_cameras_are_told() -> None:
    first, second = faults(4, cam1=2.0, cam3="mirror")
    assert (first.kind, first.cameras, first.factor) == ("unit", ("cam1",), 0.5)
    assert (second.kind, second.cameras) == ("mirror", ("cam3",))
