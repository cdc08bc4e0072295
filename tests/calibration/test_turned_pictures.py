"""Pictures that are turned by 180° against their intrinsics are told by the other cameras, and right ones never are."""

import numpy as np
import pytest
from walker import stand, track

from depthmocap.calibration.mending import mended_camera
from depthmocap.calibration.picture_faults import PictureFault
from depthmocap.calibration.turned_pictures import as_turned, find_turned_pictures
from depthmocap.geometry import DepthCamera

TIMES_S = np.arange(0, 8, 0.2)
POSES = [stand(azimuth, height) for azimuth, height in ((10, 1.4), (130, 1.9), (245, 1.6))]
#: Intrinsics of an Azure Kinect, whose principal point is far from the middle.
CAMERAS = [DepthCamera(f"cam{i}", 320, 288, 252.25, 252.25, 160.7, 165.8, pose) for i, pose in enumerate(POSES)]


def faults(count: int, turned: tuple[int, ...] = (), seed: int = 0) -> list[PictureFault]:
    """Of so many cameras, of which some have intrinsics that were not turned with their pictures."""
    rng = np.random.default_rng(seed)
    tracks = [track(pose, TIMES_S, rng) for pose in POSES[:count]]
    for i in turned:
        # What is turned twice is as it was: the track is right for the turned intrinsics.
        tracks[i] = as_turned(CAMERAS[i].turned(2), tracks[i])
    return find_turned_pictures(CAMERAS[:count], tracks, [], rng)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_right_pictures_are_not_turned(count: int) -> None:
    assert faults(count) == [] == faults(count, seed=1)


@pytest.mark.parametrize(("count", "turned"), [(3, (1,)), (3, (0, 1, 2))])
def test_the_picture_that_is_turned_is_told_with_what_mends_it(count: int, turned: tuple[int, ...]) -> None:
    told = faults(count, turned)
    assert [fault.cameras for fault in told] == [(f"cam{i}",) for i in turned]
    for i, fault in zip(turned, told, strict=True):
        assert "cx 158.3 and cy 121.2 in rig.json would be right" in fault.text and fault.certain
        mended = mended_camera(CAMERAS[i], fault)
        assert (mended.cx, mended.cy) == pytest.approx((158.3, 121.2))
        assert np.array_equal(mended.world_from_camera, CAMERAS[i].world_from_camera)


def test_of_two_cameras_it_is_the_one_that_fits_or_both_are_named() -> None:
    (fault,) = faults(2, (1,))
    assert "cam1" in fault.cameras and fault.certain == (len(fault.cameras) == 1)


def test_cameras_that_are_wrong_in_another_way_are_not_looked_at() -> None:
    rng = np.random.default_rng(0)
    tracks = [track(pose, TIMES_S, rng) for pose in POSES]
    tracks[1] = as_turned(CAMERAS[1].turned(2), tracks[1])
    assert find_turned_pictures(CAMERAS, tracks, [PictureFault("mirror", ("cam1",), "")], rng) == []
