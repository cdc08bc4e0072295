"""Every solid against its equation, wherever the camera is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.render import Material
from depthmocap.synth.scenes.room import Box, Room, render_room, shelf, table
from depthmocap.synth.scenes.solids import NONE, Solids, box, capsule, chain, cylinder, ellipsoid, join, shell

TURN = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
CENTRE = np.array([0.1, 0.2, 0.9])
START, END = np.array([-0.3, 0.1, 0.5]), np.array([0.35, 0.3, 1.2])

#: Each solid and how far a world point is outside its surface, in any unit: negative within, 0 on it.
SOLIDS = {
    "box": (
        box(CENTRE, (0.4, 0.2, 0.3), TURN),
        lambda p: (np.abs((p - CENTRE) @ TURN) - [0.4, 0.2, 0.3]).max(-1),
    ),
    "ellipsoid": (
        ellipsoid(CENTRE, (0.4, 0.2, 0.3), TURN),
        lambda p: np.linalg.norm((p - CENTRE) @ TURN / [0.4, 0.2, 0.3], axis=-1) - 1,
    ),
    "capsule": (capsule(START, END, 0.15), lambda p: _off_axis(p, ends=True) - 0.15),
    "cylinder": (
        cylinder(START, END, 0.15),
        lambda p: np.maximum(_off_axis(p, ends=False) - 0.15, np.abs(_share(p) - 0.5) - 0.5),
    ),
}


def _share(p: np.ndarray) -> np.ndarray:
    return (p - START) @ (END - START) / ((END - START) @ (END - START))


def _off_axis(p: np.ndarray, ends: bool) -> np.ndarray:
    share = np.clip(_share(p), 0, 1) if ends else _share(p)
    return np.linalg.norm(p - START - share[..., None] * (END - START), axis=-1)


def camera_at(eye: tuple[float, float, float], target: np.ndarray = CENTRE, distorted: bool = False) -> DepthCamera:
    pose = look_at(np.array(eye), np.asarray(target, dtype=float), 0.2)
    lens = (0.1, -0.2, 0.001, 0.002, 0.05) if distorted else (0.0, 0.0, 0.0, 0.0, 0.0)
    return DepthCamera("cam", 128, 96, 100.0, 101.0, 63.2, 47.9, pose, lens)


def draw(solids: Solids, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    values = np.zeros(depth.shape, dtype=np.uint8)
    solids.draw(camera, depth, values)
    return depth, values


def rays_of(camera: DepthCamera) -> np.ndarray:
    """World directions of depth 1, (h, w, 3)."""
    rays = np.concatenate([camera.rays.astype(float), np.ones((camera.height, camera.width, 1))], -1)
    return rays @ camera.world_from_camera[:3, :3].T


EYES = [(1.5, -1.2, 1.4), (-1.0, 1.7, 0.2), (0.3, 0.2, 3.0), (0.9, 0.1, 0.9)]


@pytest.mark.parametrize("distorted", [False, True])
@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("name", SOLIDS)
def test_rays_meet_the_surface_where_they_first_can(
    name: str, eye: tuple[float, float, float], distorted: bool
) -> None:
    solid, outside = SOLIDS[name]
    camera = camera_at(eye, distorted=distorted)
    depth, values = draw(solid, camera)
    rays, origin = rays_of(camera), camera.world_from_camera[:3, 3]
    hit = np.isfinite(depth)
    assert hit.sum() > 300
    on_it = origin + rays[hit] * depth[hit][:, None].astype(float)
    assert np.abs(outside(on_it)).max() < 2e-6
    np.testing.assert_array_equal(values > 0, hit)
    # By small steps along the rays nothing is met earlier, nor at all where nothing was drawn.
    steps = np.linspace(0.01, 4, 400)
    for first in range(0, camera.height, 12):
        points = origin + rays[first, ::4, None] * steps[:, None]
        inside = outside(points) < -1e-3
        reached = np.where(hit[first, ::4], depth[first, ::4], np.inf)[:, None]
        assert not (inside & (steps < reached)).any()


def test_a_small_solids_window_cuts_nothing_off() -> None:
    rng = np.random.default_rng(4)
    for _ in range(60):
        centre, half = rng.uniform(-1, 1, 3), rng.uniform(0.02, 0.5, 3)
        turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        camera = camera_at(tuple(rng.uniform(-1, 1, 3)), rng.uniform(-1, 1, 3))
        solid = box(centre, half, turn)
        small = draw(solid, camera)[0]
        whole = draw(solid, DepthCamera(**{**vars_of(camera), "distortion": (1e-12, 0.0, 0.0, 0.0, 0.0)}))[0]
        np.testing.assert_allclose(small, whole, atol=1e-4)


def vars_of(camera: DepthCamera) -> dict:
    names = ("name", "width", "height", "fx", "fy", "cx", "cy", "world_from_camera")
    return {name: getattr(camera, name) for name in names}


@pytest.mark.parametrize("distorted", [False, True])
def test_a_room_against_its_formula(distorted: bool) -> None:
    boxes = (*table((0.3, 0.2), (1.5, 1.0), 0.74), *shelf((-2.0, -1.1), (-1.6, 0.3), 1.8, 5))
    room = Room(Box((-2.0, -3.0, 0.0), (2.5, 3.0, 2.5)), boxes)
    for eye in ((0.0, -2.5, 1.2), (-1.5, 2.0, 2.2), (1.7, 0.6, 0.8)):
        camera = camera_at(eye, distorted=distorted)
        rays, origin = rays_of(camera), np.array(eye)

        def span(solid: Box, rays: np.ndarray = rays, origin: np.ndarray = origin) -> tuple[np.ndarray, np.ndarray]:
            a, b = (np.array(solid.low) - origin) / rays, (np.array(solid.high) - origin) / rays
            return np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)

        expected = span(room.shell)[1]
        for solid in boxes:
            enter, leave = span(solid)
            expected = np.where((enter < leave) & (enter > 0), np.minimum(expected, enter), expected)
        np.testing.assert_allclose(render_room(room, camera), expected, rtol=2e-7)


@pytest.mark.parametrize("name", SOLIDS)
def test_nothing_is_seen_from_inside_or_of_what_is_behind(name: str) -> None:
    solid, _ = SOLIDS[name]
    inside = CENTRE if name in ("box", "ellipsoid") else (START + END) / 2
    for target in (inside + np.array([1, 0, 0]), inside + np.array([0.1, -1, 0.4])):
        assert np.isinf(draw(solid, camera_at(tuple(inside), target))[0]).all()
    assert np.isinf(draw(solid, camera_at((3.0, 0.2, 0.9), np.array([6.0, 0.2, 0.9])))[0]).all()


def test_a_solid_that_passes_beside_the_camera_is_drawn() -> None:
    """A table whose corner is behind the camera still shows what is before it."""
    board = box((0.0, 0.0, 0.5), (2.0, 2.0, 0.02))
    depth, _ = draw(board, camera_at((0.0, -1.0, 1.0), np.array([0.0, 3.0, 1.0])))
    low = depth[-1]
    assert np.isfinite(low).all()
    camera = camera_at((0.0, -1.0, 1.0), np.array([0.0, 3.0, 1.0]))
    points = camera.world_from_camera[:3, 3] + rays_of(camera)[-1] * low[:, None]
    np.testing.assert_allclose(points[:, 2], 0.52, atol=1e-6)


def test_the_nearer_wins_and_brings_its_material() -> None:
    camera = camera_at((0.0, -3.0, 0.9), np.array([0.0, 0.0, 0.9]))
    near, far = box((0.0, -1.0, 0.9), (0.2, 0.1, 0.2), material=Material.OBJECT), box((0.0, 0.5, 0.9), (0.6, 0.1, 0.6))
    room = shell((-4.0, -4.0, -2.0), (4.0, 4.0, 4.0))
    pictures = [draw(join(order), camera) for order in ((near, far, room), (room, far, near))]
    for depth, values in pictures:
        assert np.isfinite(depth).all()
        assert depth[48, 63] == pytest.approx(1.9, abs=1e-5)
        assert values[48, 63] == Material.OBJECT
        assert set(np.unique(values)) == {Material.SCENE, Material.OBJECT}
    np.testing.assert_array_equal(pictures[0][0], pictures[1][0])
    assert np.isinf(draw(NONE, camera)[0]).all()


def around(count: int) -> np.ndarray:
    """Random points about the solids."""
    return np.random.default_rng(0).uniform([-0.7, -0.4, 0.2], [0.8, 0.9, 1.6], (count, 3))


@pytest.mark.parametrize("name", SOLIDS)
def test_points_within(name: str) -> None:
    solid, outside = SOLIDS[name]
    points = around(3000)
    expected = outside(points) < 0
    assert 20 < expected.sum() < 1000
    assert [solid.hold_any(p[None]) for p in points] == expected.tolist()


@pytest.mark.parametrize("name", SOLIDS)
def test_grown_by_a_margin(name: str) -> None:
    """What is nearer than the margin is within the grown solid, and what is much farther is not."""
    solid, outside = SOLIDS[name]
    points = around(20000)
    within, tried = points[outside(points) < 0], points[:300]
    gap = np.array([np.linalg.norm(within - p, axis=1).min() for p in tried])  # to a few centimetres
    grown = solid.grown(0.1)
    inside = np.array([grown.hold_any(p[None]) for p in tried])
    assert inside[gap < 0.1].all()
    assert not inside[gap > 0.1 * np.sqrt(3) + 0.06].any()
    assert (~inside).any()


@pytest.mark.parametrize("name", SOLIDS)
def test_what_hides_a_point_is_what_a_camera_sees(name: str) -> None:
    solid, _ = SOLIDS[name]
    camera = camera_at(EYES[0])
    depth, _ = draw(solid, camera)
    rays, eye = rays_of(camera), camera.world_from_camera[:3, 3]
    beyond = (eye + rays * 5)[::6, ::6].reshape(-1, 3)
    before = (eye + rays * 0.3)[::6, ::6].reshape(-1, 3)
    hidden = solid.hide(np.stack([eye, eye + np.array([0, 0, 50])]), beyond)
    assert hidden.shape == (2, len(beyond))
    np.testing.assert_array_equal(hidden[0], np.isfinite(depth[::6, ::6]).ravel())
    assert not solid.hide(eye[None], before).any()


def test_moved_and_joined() -> None:
    parts = join([solid for solid, _ in SOLIDS.values()] + [chain(np.eye(3), 0.05)])
    assert len(parts) == 6
    offset = np.array([0.3, -0.2, 0.5])
    camera = camera_at(EYES[0])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = TURN, offset
    moved_camera = DepthCamera(**{**vars_of(camera), "world_from_camera": pose @ camera.world_from_camera})
    np.testing.assert_allclose(draw(parts.moved(TURN, offset), moved_camera)[0], draw(parts, camera)[0], atol=1e-5)


def test_a_capsule_of_no_length_is_a_ball() -> None:
    camera = camera_at(EYES[0])
    ball = draw(ellipsoid(CENTRE, (0.2, 0.2, 0.2)), camera)[0]
    np.testing.assert_allclose(draw(capsule(CENTRE, CENTRE, 0.2), camera)[0], ball, atol=1e-5)
