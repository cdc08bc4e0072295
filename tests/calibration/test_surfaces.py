"""Surfaces: their directions, what is the same thing to two cameras, and what they make of rough poses."""

import dataclasses

import numpy as np
import pytest
from walker import errors, stand, track

from depthmocap.calibration.camera_placement import place_cameras
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.observations import Observation
from depthmocap.calibration.refine import refine
from depthmocap.calibration.solve import apply_twists, normal_equations, point_rows
from depthmocap.calibration.surfaces import Surface, extract_surface, surface_rows
from depthmocap.geometry import DepthCamera, transform_points
from depthmocap.synth.scenes.room import Box, Room, render_room

ROOM = Room(
    Box((-3.0, -3.2, 0.0), (3.0, 3.0, 2.6)),
    (Box((-1.6, 1.4, 0.0), (-0.9, 2.0, 0.8)), Box((1.2, -1.9, 0.0), (1.8, -1.2, 1.1))),
)
AZIMUTHS = (5.0, 120.0, 250.0)


def camera(pose=None) -> DepthCamera:
    made = DepthCamera("cam", 96, 80, 45.0, 45.0, 47.5, 39.5)
    return made if pose is None else dataclasses.replace(made, world_from_camera=pose)


def test_a_wall_faces_the_camera_and_an_edge_has_no_direction():
    depth = np.full((80, 96), 2.0, np.float32)
    depth[:, 48:] = 3.0
    surface = extract_surface(camera(), depth, 1)
    np.testing.assert_allclose(surface.normals, np.tile([0.0, 0.0, -1.0], (len(surface.normals), 1)), atol=1e-6)
    columns = surface.points[:, 0] / surface.points[:, 2] * 45.0 + 47.5
    assert len(columns) > 3000
    assert (np.abs(columns - 47.5) > 2).all()


def test_two_sides_of_a_board_are_not_the_same_thing():
    points = np.stack([*np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20)), np.zeros((20, 20))], -1).reshape(
        -1, 3
    )
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    front, back = Surface(points + 0.02 * up, up), Surface(points, -up)
    assert surface_rows((0, 1), front, back, 0.1, 0.02) is None
    rows = surface_rows((0, 1), front, Surface(points, up), 0.1, 0.02)
    assert rows is not None
    np.testing.assert_allclose(((rows.a - rows.b) * rows.normals).sum(1), 0.02)


def test_equations_give_the_motion_and_draws_its_uncertainty():
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (400, 3))
    twist = np.array([[0.0] * 6, [0.004, -0.003, 0.002, 0.01, -0.02, 0.005]])
    transforms = apply_twists(np.tile(np.eye(4), (2, 1, 1)), twist)
    noisy = transform_points(transforms[1], points) + rng.normal(0, 0.01, points.shape)
    rows = point_rows((0, 1), points, noisy, np.full(400, 0.02), np.arange(400) // 10)
    system = normal_equations([rows], 2)
    estimated = system.solve()
    np.testing.assert_allclose(estimated[1], -twist[1], atol=0.003)
    assert (estimated[0] == 0).all()
    spread = system.bootstrap(rng, 200)[:, 1].std(0)
    # A hundredth of a metre over 20: each of 400 points counts.
    assert (spread[3:] > 0.0003).all()
    assert (spread[3:] < 0.001).all()


@pytest.fixture(scope="module")
def biased():
    """Cameras in a room, whose skeletons all lie 2.5 cm too near to them."""
    rng = np.random.default_rng(1)
    poses = [stand(azimuth, height) for azimuth, height in zip(AZIMUTHS, (1.3, 1.7, 2.1), strict=True)]
    observations = []
    for pose in poses:
        empty = render_room(ROOM, camera(pose))
        joint_track = track(pose, np.arange(0, 16, 0.2), rng, noise_m=0.02)
        joint_track = JointTrack(joint_track.times_s, joint_track.joints - [0.0, 0.0, 0.025], joint_track.sigma_m)
        observations.append(Observation(camera(), joint_track, {}, empty, len(joint_track.times_s)))
    return poses, observations


def worst(estimated, poses):
    return np.max(
        [errors(poses[0] @ pose, true, (0.0, 0.0, 1.0)) for pose, true in zip(estimated, poses, strict=True)], 0
    )


def test_walls_put_right_what_skeletons_get_wrong(biased):
    poses, observations = biased
    placement = place_cameras([observation.track for observation in observations], np.random.default_rng(0))
    before = worst(placement.poses, poses)
    refined = refine(placement, observations, np.random.default_rng(0))
    after = worst(refined.poses, poses)
    assert before[0] > 0.02
    assert refined.surfaces_used
    assert after[0] < 0.004
    assert after[1] < np.deg2rad(0.1)
    # And it is told how sure that is: the truth is within a few deviations.
    spread = refined.twist_samples[:, 1] - refined.twist_samples[:, 0]
    assert np.sqrt((spread[:, 3:] ** 2).sum(1).mean()) < 0.01


def test_without_a_room_the_skeletons_decide_and_their_common_errors_are_told(biased):
    _, observations = biased
    dark = [
        dataclasses.replace(observation, empty_m=np.zeros_like(observation.empty_m)) for observation in observations
    ]
    placement = place_cameras([observation.track for observation in dark], np.random.default_rng(0))
    refined = refine(placement, dark, np.random.default_rng(0))
    assert not refined.surfaces_used
    np.testing.assert_array_equal(refined.poses, placement.poses)
    assert not refined.shared_points
    spread = refined.twist_samples[:, 1] - refined.twist_samples[:, 0]
    assert np.sqrt((spread[:, 3:] ** 2).sum(1).mean()) > 0.005


def test_a_room_that_contradicts_the_skeletons_is_not_believed(biased):
    poses, observations = biased
    # A camera that was moved after its empty scene was recorded.
    moved_camera = dataclasses.replace(camera(), world_from_camera=stand(AZIMUTHS[1], 1.5) @ shifted(0.12))
    wrong = [
        observations[0],
        dataclasses.replace(observations[1], empty_m=render_room(ROOM, moved_camera)),
        observations[2],
    ]
    placement = place_cameras([observation.track for observation in wrong], np.random.default_rng(0))
    refined = refine(placement, wrong, np.random.default_rng(0))
    assert worst(refined.poses, poses)[0] < 0.06


def shifted(metres: float):
    pose = np.eye(4)
    pose[0, 3] = metres
    return pose
