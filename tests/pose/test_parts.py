"""What cameras saw of regions, and the body's frame."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.body.regions import REGION
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.geometry.transforms import look_at
from depthmocap.pose.cloud import LabelledCloud, merge_views
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.parts import (
    AREA,
    CENTRAL,
    CENTRE,
    COUNT,
    COVARIANCE,
    MIN_POINTS,
    PROBABILITY,
    TO_CAMERA,
    body_frame,
    heading_frame,
    network_inputs,
    part_statistics,
    transform_parts,
    yaw_matrix,
)
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.people.bodies import ONE_CHARACTER
from depthmocap.synth.render import PosedPerson, render_person

HAND, THIGH = REGION["hand R"], REGION["thigh L"]


def camera_at(eye, name="a"):
    pose = look_at(np.array(eye, float), np.zeros(3), 0.0)
    return DepthCamera(name, 320, 240, 280.0, 280.0, 160.0, 120.0, world_from_camera=pose)


def cloud_of(points, labels, eye=(0, -2, 0), weights=None):
    weights = np.ones(len(points), np.float32) if weights is None else weights.astype(np.float32)
    return LabelledCloud(
        points.astype(np.float32), np.asarray(labels, np.uint8), weights, (len(points),), (camera_at(eye),)
    )


def person_views(posed, azimuths):
    """The same person seen from several sides."""
    centre = posed.vertices.mean(0)
    views = []
    for azimuth in azimuths:
        eye = centre + np.array([2.5 * np.sin(azimuth), -2.5 * np.cos(azimuth), 0.3])
        camera = DepthCamera("a", 320, 240, 280.0, 280.0, 160.0, 120.0, world_from_camera=look_at(eye, centre, 0.0))
        rendering = render_person(posed, camera)
        views.append(LabelledView(View(camera, rendering.depth_m), rendering.labels))
    return views


@pytest.fixture(scope="module")
def posed(body_model):
    from depthmocap.synth.body.mesh import REST_POSTURE

    return PosedPerson(BodyModel.load().shape(ONE_CHARACTER).pose(REST_POSTURE))


def test_moments_are_those_of_the_points():
    rng = np.random.default_rng(0)
    # Narrow enough that reweighting by distance does nothing to speak of.
    points = rng.normal([0.3, 0.1, 0.2], [0.004, 0.002, 0.006], (300, 3))
    parts = part_statistics(cloud_of(points, np.full(300, HAND), weights=np.full(300, 0.7)))
    assert parts.shape == (1, 61, 16)
    row = parts[0, HAND - 1]
    assert row[COUNT] == 300
    assert row[PROBABILITY] == pytest.approx(0.7)
    assert row[CENTRAL] == pytest.approx(1, abs=0.01)
    np.testing.assert_allclose(row[CENTRE], points.mean(0), atol=1e-4)
    np.testing.assert_allclose(row[COVARIANCE], np.cov(points.T, bias=True)[np.triu_indices(3)], atol=1e-6)
    to_camera = np.array([0, -2, 0]) - points.mean(0)
    np.testing.assert_allclose(row[TO_CAMERA], to_camera / np.linalg.norm(to_camera), atol=1e-3)
    assert row[AREA] == pytest.approx(300 * (to_camera @ to_camera) / 280**2, rel=1e-3)
    assert not np.delete(parts[0], HAND - 1, axis=0).any()


@pytest.mark.parametrize("up", ["y", "-y"])
def test_other_worlds_are_turned_z_up(up):
    rng = np.random.default_rng(1)
    points = rng.normal(0, 0.1, (100, 3))
    as_z = part_statistics(cloud_of(points, np.full(100, HAND)))[0, HAND - 1]
    turned = part_statistics(cloud_of(points, np.full(100, HAND)), up)[0, HAND - 1]
    sign = 1 if up == "y" else -1
    assert turned[CENTRE][2] == pytest.approx(sign * as_z[CENTRE][1], abs=1e-6)


def test_a_speck_far_off_hardly_counts():
    rng = np.random.default_rng(2)
    points = rng.normal(0, 0.03, (200, 3))
    clean = part_statistics(cloud_of(points, np.full(200, HAND)))[0, HAND - 1]
    spoilt = np.concatenate([points, rng.normal([1.0, 0, 0], 0.02, (30, 3))])
    row = part_statistics(cloud_of(spoilt, np.full(230, HAND)))[0, HAND - 1]
    assert np.linalg.norm(row[CENTRE] - clean[CENTRE]) < 0.003  # their mean is 13 cm off
    assert row[CENTRAL] < 0.9


def test_regions_of_few_points_are_unseen_and_many_points_are_sampled_evenly():
    rng = np.random.default_rng(3)
    points = rng.normal(0, 0.05, (5000 + MIN_POINTS - 1, 3))
    labels = np.repeat([THIGH, HAND], [5000, MIN_POINTS - 1])
    parts = part_statistics(cloud_of(points, labels))[0]
    assert not parts[HAND - 1].any()
    assert parts[THIGH - 1, COUNT] == 5000
    np.testing.assert_allclose(parts[THIGH - 1, CENTRE], 0, atol=0.01)


def test_each_camera_has_its_own_row(posed):
    views = person_views(posed, (0, 2))
    both = part_statistics(merge_views(views))
    for i, view in enumerate(views):
        np.testing.assert_array_equal(both[i], part_statistics(merge_views([view]))[0])


def test_joints_that_cameras_tell_are_parts(posed):
    plain, guessing = person_views(posed, (0, 2))
    joints = np.column_stack([posed.joints, np.linspace(0.01, 0.4, 18)])
    parts = part_statistics(merge_views([plain, guessing._replace(joints=joints)]))
    assert not parts[0, 43:].any()
    rows = parts[1, 43:]
    np.testing.assert_allclose(rows[:, CENTRE], posed.joints, atol=1e-6)
    assert (rows[:, COUNT] == 1).all() and not rows[:, AREA].any()
    assert (np.diff(rows[:, PROBABILITY]) < 0).all()  # the larger the error to expect
    # The heading of who stands comes from the regions, and joints are put into the frame with them.
    frame = body_frame(parts)
    np.testing.assert_array_equal(frame.rotation, body_frame(part_statistics(merge_views([plain, guessing]))).rotation)
    inputs, observed = network_inputs(parts, frame)
    assert observed[1, 43:].all() and not observed[0, 43:].any()
    np.testing.assert_allclose(inputs[1, 43:, CENTRE], frame.from_world(posed.joints), atol=1e-5)
    np.testing.assert_allclose(inputs[1, 43:, COVARIANCE][:, [0, 3, 5]], np.repeat(joints[:, 3:], 3, 1) * 10, rtol=1e-4)


@pytest.mark.parametrize("azimuths", [(0,), (np.pi / 2,), (np.pi,), (-2.2,), (0, 2, 4)])
@pytest.mark.parametrize("heading", [0.0, 1.0, 3.0])
def test_frame_faces_as_the_body_does(posed, azimuths, heading):
    turn = yaw_matrix(np.cos(heading), np.sin(heading))
    person = posed.moved(turn, np.array([0.5, -0.2, 0.0]))
    frame = body_frame(part_statistics(merge_views(person_views(person, azimuths))))
    joints = frame.from_world(person.joints.astype(np.float64))
    across = joints[JOINT_INDEX["LShoulder"]] - joints[JOINT_INDEX["RShoulder"]]
    assert np.degrees(np.arctan2(-across[0], across[1])) == pytest.approx(0, abs=25)
    assert np.linalg.norm(joints[JOINT_INDEX["Spine"]]) < 0.3
    np.testing.assert_allclose(frame.to_world(joints), person.joints, atol=1e-5)


def test_moved_parts_are_those_of_moved_points(posed):
    views = person_views(posed, (0.4, 2.5))
    cloud = merge_views(views)
    turn, shift = yaw_matrix(np.cos(0.7), np.sin(0.7)), np.array([0.3, -1.0, 0.2])
    cameras = []
    for camera in cloud.cameras:
        pose = camera.world_from_camera.copy()
        pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], turn @ pose[:3, 3] + shift
        cameras.append(DepthCamera("b", 320, 240, 280.0, 280.0, 160.0, 120.0, world_from_camera=pose))
    points = (cloud.points_world @ turn.T + shift).astype(np.float32)
    truth = part_statistics(LabelledCloud(points, cloud.labels, cloud.weights, cloud.view_sizes, tuple(cameras)))
    parts = part_statistics(cloud)
    transformed = transform_parts(parts, np.broadcast_to(turn, (2, 3, 3)), np.broadcast_to(shift, (2, 3)))
    np.testing.assert_allclose(transformed, truth, atol=2e-4)
    # What the network reads does not know where the person stands and which way they face.
    before = network_inputs(parts, body_frame(parts))[0]
    after = network_inputs(truth, body_frame(truth))[0]
    np.testing.assert_allclose(after, before, atol=5e-3)


def _lying(parts: np.ndarray, turn: Rotation) -> tuple[np.ndarray, np.ndarray]:
    """Parts as those of somebody who lies, and the rotation."""
    rotation = turn.as_matrix()
    of_views = np.broadcast_to(rotation, (len(parts), 3, 3))
    return transform_parts(parts, of_views, np.zeros((len(parts), 3))), rotation


@pytest.mark.parametrize("told", ["joints", "regions"])
@pytest.mark.parametrize("turn_deg", [(90, 0, 0), (0, -80, 0), (60, 60, 0), (150, 10, 40), (0, 180, 0)])
def test_the_frame_of_who_lies_has_the_trunk_up(posed: PosedPerson, told: str, turn_deg: tuple[float, ...]) -> None:
    views = person_views(posed, (0.4, 2.5))
    if told == "joints":
        views = [view._replace(joints=np.column_stack([posed.joints, np.full(18, 0.02)])) for view in views]
    standing = part_statistics(merge_views(views))
    parts, rotation = _lying(standing, Rotation.from_euler("xyz", turn_deg, degrees=True))
    frame = body_frame(parts)
    joints = frame.from_world(posed.joints @ rotation.T)
    trunk = joints[JOINT_INDEX["Neck"]] - joints[JOINT_INDEX["Hip"]]
    assert trunk[2] / np.linalg.norm(trunk) > np.cos(np.radians(5 if told == "joints" else 25))
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-9)
    # What the network reads is nearly that of the same person who stands, whose heading is found from fewer cues.
    np.testing.assert_allclose(frame.to_world(joints), posed.joints @ rotation.T, atol=1e-6)
    across = joints[JOINT_INDEX["LShoulder"]] - joints[JOINT_INDEX["RShoulder"]]
    assert np.degrees(np.arctan2(-across[0], across[1])) == pytest.approx(0, abs=25)


def test_the_frame_leans_without_a_jump(posed: PosedPerson) -> None:
    views = [
        view._replace(joints=np.column_stack([posed.joints, np.full(18, 0.02)]))
        for view in person_views(posed, (0.4, 2.5))
    ]
    standing = part_statistics(merge_views(views))
    angles = np.linspace(0, np.pi / 2, 181)
    parts = np.stack([_lying(standing, Rotation.from_rotvec([angle, 0, 0]))[0] for angle in angles])
    frames = body_frame(parts)
    np.testing.assert_allclose(frames.rotation[0], heading_frame(standing).rotation, atol=1e-12)
    steps = [
        Rotation.from_matrix(b @ a.T).magnitude() for a, b in zip(frames.rotation, frames.rotation[1:], strict=False)
    ]
    assert np.degrees(max(steps)) < 5  # of half a degree each
    ups = frames.rotation[:, 2]
    assert (ups[angles < 0.2] == [0, 0, 1]).all()
    assert np.arccos(ups[-1, 2]) > 1.2


def test_inputs_of_unseen_regions_are_zero(posed):
    parts = part_statistics(merge_views(person_views(posed, (0,))))
    inputs, observed = network_inputs(parts, body_frame(parts))
    assert observed.any()
    assert not observed.all()
    assert not inputs[~observed].any()
    assert (inputs[observed][:, COUNT] > 0).all()
    assert np.abs(inputs).max() < 20


def test_nothing_seen_has_a_frame_all_the_same():
    frame = body_frame(np.zeros((2, 61, 16), np.float32))
    np.testing.assert_array_equal(frame.origin, 0)
    np.testing.assert_array_equal(frame.rotation, np.eye(3))


def test_clouds_that_cannot_be_used():
    points = np.zeros((10, 3))
    with pytest.raises(InputError, match="merge_views"):
        part_statistics(LabelledCloud(points.astype("f4"), np.full(10, HAND, np.uint8), np.ones(10, "f4")))
    with pytest.raises(InputError, match="outside 1"):
        part_statistics(cloud_of(points, np.full(10, 44)))
    with pytest.raises(InputError, match="not finite"):
        part_statistics(cloud_of(np.full((10, 3), np.nan), np.full(10, HAND)))
    with pytest.raises(InputError, match="up"):
        part_statistics(cloud_of(points, np.full(10, HAND)), "x")
