"""UBC3V's camera angles and ray table."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from ubc3v_files import SHAPE, write_section

from depthmocap.datasets.ubc3v import (
    KINECT2,
    Section,
    camera_pose,
    maya_angles,
)
from depthmocap.datasets.ubc3v_camera import RayTableCamera, load_ray_table
from depthmocap.errors import InputError
from depthmocap.geometry.transforms import is_rigid, look_at, transform_points

# Camera angles

coordinate = st.one_of(st.just(0.0), st.just(-0.0), st.floats(-6, 6).filter(lambda x: x == 0 or abs(x) > 1e-6))


@settings(deadline=None, max_examples=300)
@given(coordinate, coordinate, st.floats(-3, 3), coordinate, coordinate, st.floats(-1, 2))
@example(0.0, 0.0, 3.0, 0.0, 0.0, 1.0)  # straight down, no azimuth
@example(0.0, 0.0, -3.0, 0.0, 0.0, 1.0)  # straight up
@example(0.0, 3.0, 1.0, 0.0, 0.0, 1.0)  # on each axis, level
@example(0.0, -3.0, 1.0, 0.0, 0.0, 1.0)
@example(3.0, 0.0, 1.0, 0.0, 0.0, 1.0)
@example(-3.0, 0.0, 1.0, 0.0, 0.0, 1.0)
@example(2.0, 2.0, 1.0, 4.0, 4.0, 1.0)  # looks away from the origin
def test_camera_angles_round_trip(x, y, z, to_x, to_y, to_z):
    eye, target = np.array([x, y, z]), np.array([to_x, to_y, to_z])
    if np.linalg.norm(target - eye) < 1e-3:
        return
    pose = look_at(eye, target)
    translate, rotate = maya_angles(pose)
    np.testing.assert_allclose(camera_pose(translate, rotate), pose, atol=1e-9)
    np.testing.assert_allclose(maya_camera(translate, rotate), pose, atol=1e-9)


@pytest.mark.parametrize("x", [-2.0, 2.0])
@pytest.mark.parametrize("y", [-2.0, 2.0])
@pytest.mark.parametrize("z", [-1.0, 1.0, 3.0])
def test_camera_angles_all_quadrants(x, y, z):
    for yaw in np.radians(np.arange(0, 360, 15)):
        for pitch in (-1.2, -0.3, 0.0, 0.3, 1.2):
            direction = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
            pose = look_at(np.array([x, y, z]), np.array([x, y, z]) + direction)
            np.testing.assert_allclose(camera_pose(*maya_angles(pose)), pose, atol=1e-9)


def maya_camera(translate_cm, rotate_deg):
    """The pose by Maya's own definition: Euler order xyz, the camera looks along -z, y up."""
    (a, b, c), (d, e, f) = np.cos(np.radians(rotate_deg)), np.sin(np.radians(rotate_deg))
    rx = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    ry = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    rz = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    z_up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    pose = np.eye(4)
    pose[:3, :3] = z_up @ rz @ ry @ rx @ np.diag([1, -1, -1])
    pose[:3, 3] = z_up @ translate_cm / 100
    return pose


@pytest.mark.parametrize(
    ("translate", "rotate"),
    [  # Maya's angles of cameras that look down at the origin: rotate z is 180 where z < 0
        ((200.0, 100.0, 300.0), (-15.503, 33.690, 0.0)),
        ((-200.0, 100.0, 300.0), (-15.503, -33.690, 0.0)),
        ((200.0, 100.0, -300.0), (180 - 15.503, 33.690, 180.0)),
        ((-200.0, 100.0, -300.0), (180 - 15.503, -33.690, 180.0)),
    ],
)
def test_pose_of_maya_look_at_angles(translate, rotate):
    x, y, z = translate
    expected = look_at(np.array([x, -z, y]) / 100, np.zeros(3))
    pose = camera_pose(np.array(translate), np.array(rotate))
    assert is_rigid(pose)
    np.testing.assert_allclose(pose, expected, atol=1e-4)
    np.testing.assert_allclose(maya_camera(np.array(translate), np.array(rotate)), expected, atol=1e-4)


def test_pose_sign_tests_are_strict():
    def heading(translate, rotate):
        return camera_pose(np.array(translate), np.array(rotate))[:3, 2]

    # Zero: 0 <= 0 is not flipped; a zero product takes the second branch; rotate y of 0 counts as not negative.
    np.testing.assert_allclose(heading([0.0, 0.0, 300.0], [0.0, 0.0, 0.0]), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(heading([1.0, 0.0, 300.0], [0.0, 0.0, 0.0]), [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(heading([0.0, 0.0, 300.0], [0.0, -90.0, 0.0]), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(heading([0.0, 0.0, 300.0], [0.0, 90.0, 0.0]), [-1, 0, 0], atol=1e-12)


def test_roll_cannot_be_stored():
    eye, target = np.array([2.0, 1.0, 1.0]), np.zeros(3)
    with pytest.raises(ValueError, match="roll"):
        maya_angles(look_at(eye, target, roll_rad=0.01))
    maya_angles(look_at(eye, target, roll_rad=1e-4))
    upside_down = look_at(eye, target, roll_rad=np.pi)  # its x axis is level
    np.testing.assert_allclose(camera_pose(*maya_angles(upside_down)), upside_down, atol=1e-9)
    with pytest.raises(ValueError, match="rotation and a translation"):
        maya_angles(np.eye(4) * 2)


# The ray table


def bent_rays():
    """Rays of a lens with a Kinect 2's distortion: x/z right and y/z down."""
    return dataclasses.replace(KINECT2, distortion=(0.09, -0.27, 0.0, 0.0, 0.09)).rays.astype(np.float64)


def save_table(path: Path, rays, kind="image"):
    left, up = -rays[..., 0], -rays[..., 1]
    mapper = {"xmap": left, "ymap": up} if kind == "maps" else {"x": left[:, ::-1], "y": up}
    savemat(path, {"mapper": mapper}, do_compression=True)


@pytest.mark.parametrize("kind", ["image", "maps"])
def test_ray_table(tmp_path, kind):
    pytest.importorskip("isal")
    rays = bent_rays()
    rays[:5, :5] = -np.inf  # a sensor's own table may have no rays in the corners
    save_table(tmp_path / "mapper.mat", rays, kind)
    path, samples = write_section(tmp_path, count=1)
    view = Section(path, ray_table=tmp_path / "mapper.mat")[0].views[0]
    camera = view.camera
    assert isinstance(camera, RayTableCamera)
    assert camera.name == "Cam1"
    np.testing.assert_allclose(camera.rays[5:], rays[5:], atol=1e-6)
    np.testing.assert_allclose(camera.rays[:5, :5], bent_rays()[:5, :5], atol=0.01)  # filled
    np.testing.assert_allclose(camera.world_from_camera, samples[0][0][0].camera.world_from_camera, atol=1e-9)

    v, u = (axis.ravel() for axis in np.mgrid[0:424:25, 0:512:25])
    points = np.concatenate([camera.rays[v, u], np.ones((len(u), 1))], 1) * 2.5
    world = transform_points(camera.world_from_camera, points)
    np.testing.assert_allclose(camera.project(world), np.stack([u, v, np.full(len(u), 2.5)], 1), atol=0.02)
    behind = camera.project(transform_points(camera.world_from_camera, -points[:1]))
    assert np.isnan(behind[0, :2]).all()


def test_ray_table_of_pixel_structs(tmp_path, monkeypatch):
    """A struct for each pixel, on a small sensor: a full table takes seconds to write."""
    small = dataclasses.replace(KINECT2, width=8, height=6, cx=3.6, cy=2.4)
    monkeypatch.setattr("depthmocap.datasets.ubc3v_camera.KINECT2", small)
    mapper = np.empty((6, 8), dtype=[("x", object), ("y", object)])
    mapper["x"], mapper["y"] = -small.rays[:, ::-1, 0], -small.rays[..., 1]
    savemat(tmp_path / "mapper.mat", {"mapper": mapper})
    np.testing.assert_allclose(load_ray_table(tmp_path / "mapper.mat").rays, small.rays, atol=1e-7)


def test_broken_ray_tables(tmp_path):
    path = tmp_path / "mapper.mat"
    with pytest.raises(InputError, match="not found"):
        load_ray_table(path)
    path.write_bytes(b"text")
    with pytest.raises(InputError, match="not a readable"):
        load_ray_table(path)
    for document in ({"other": np.zeros(3)}, {"mapper": {"x": np.zeros((4, 4)), "y": np.zeros((4, 4))}}):
        savemat(path, document)
        with pytest.raises(InputError, match="holds no struct"):
            load_ray_table(path)
    for rays in (-bent_rays(), np.full((*SHAPE, 2), np.nan)):
        save_table(path, rays)
        with pytest.raises(InputError, match="wrong way"):
            load_ray_table(path)
