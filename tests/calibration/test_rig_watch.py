"""While it runs: of cameras that do not fit, the one that is wrong is named, and what is wrong with it."""

import dataclasses

import numpy as np
from walker import stand, track

from depthmocap.calibration.rig_watch import RigWatch
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera, transform_points
from depthmocap.pose.cloud import LabelledCloud


def test_the_room_of_one_camera_that_may_be_carried_is_not_watched() -> None:
    nothing, room_m = np.empty(0, np.float32), np.full((48, 64), 2.0, np.float32)
    for pose, watched in ((np.eye(4), set()), (stand(10, 1.4), {"cam0"})):
        camera = DepthCamera("cam0", 64, 48, 60.0, 60.0, 32.0, 24.0, pose)
        cloud = LabelledCloud(np.empty((0, 3), np.float32), np.empty(0, np.uint8), nothing, (0,), (camera,))
        watch = RigWatch("z")
        assert watch(FrameSet(0, (View(camera, room_m),)), cloud) == []
        assert set(watch._scenes) == watched


def test_a_turned_camera_is_named_alone_and_by_how_much() -> None:
    rng, times_s = np.random.default_rng(0), np.arange(0, 9, 0.06)
    poses = [stand(azimuth, height) for azimuth, height in ((10, 1.4), (130, 1.9), (245, 1.6))]
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(0.26), 0, np.sin(0.26)], [0, 1, 0], [-np.sin(0.26), 0, np.cos(0.26)]]
    told = [poses[0], poses[1] @ turn, poses[2]]
    cameras = tuple(DepthCamera(f"cam{i}", 32, 24, 30.0, 30.0, 16.0, 12.0, pose) for i, pose in enumerate(told))
    tracks = [track(pose, times_s, rng) for pose in poses]
    nothing = np.empty(0, np.float32)
    cloud = LabelledCloud(np.empty((0, 3), np.float32), np.empty(0, np.uint8), nothing, (0, 0, 0), cameras)
    watch, lines = RigWatch("z", explain=True), []
    for i, now_s in enumerate(times_s):
        joints = tuple(
            np.concatenate([transform_points(pose, one.joints[i]), one.sigma_m[i][:, None]], 1)
            for pose, one in zip(told, tracks, strict=True)
        )
        lines += watch(FrameSet(round(now_s * 1e9), ()), dataclasses.replace(cloud, joints=joints))
    lines += watch.finish()
    misplaced, explained = sorted(lines, key=lambda line: "stands elsewhere than the rig says, by" in line)
    assert misplaced.startswith("camera 'cam1' sees the person more than 10 cm from where the others do")
    assert explained.startswith("camera 'cam1' stands elsewhere than the rig says, by 15°")
    assert watch.distances_m().keys() == {"cam0", "cam1", "cam2"}
