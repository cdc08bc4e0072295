"""The z-buffer against planes, boxes and spheres, and the rendered body against a ray caster."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from depthmocap.geometry import DepthCamera, look_at, transform_points
from depthmocap.kernels.raster import rasterise
from depthmocap.synth.body.mesh import REST_POSTURE, Body, PosedBody
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import NEAR_M, render_body

WIDTH, HEIGHT, FX, FY, CX, CY = 160, 120, 140.0, 138.0, 80.5, 58.25


def draw(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth (inf where nothing is) and face of camera-frame triangles."""
    depth = np.full((HEIGHT, WIDTH), np.inf, dtype=np.float32)
    face = np.full((HEIGHT, WIDTH), -1, dtype=np.int32)
    indices = np.arange(len(faces), dtype=np.int32)
    rasterise(points.astype(np.float32), faces.astype(np.int32), indices, FX, FY, CX, CY, 0.15, False, depth, face)
    return depth, face


def rays() -> np.ndarray:
    """Directions of depth 1 through the pixels' centres, (h, w, 3)."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return np.stack([(u - CX) / FX, (v - CY) / FY, np.ones_like(u)], -1)


def rectangle(corner: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two triangles seen from the side that ``a × b`` points to."""
    return np.stack([corner, corner + a, corner + a + b, corner + b]), np.array([[0, 1, 2], [0, 2, 3]])


def box(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twelve triangles, facing outwards."""
    points, faces = [], []
    x, y, z = np.diag(high - low)
    for corner, a, b in ((low, y, x), (low, z, y), (low, x, z), (high, -x, -y), (high, -y, -z), (high, -z, -x)):
        side_points, side_faces = rectangle(corner, a, b)
        faces.append(side_faces + 4 * len(points))
        points.append(side_points)
    return np.concatenate(points), np.concatenate(faces)


def sphere(centre: np.ndarray, radius: float, rings: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """Triangles between circles of latitude, facing outwards."""
    segments = 2 * rings
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.arange(segments) * 2 * np.pi / segments, indexing="ij"
    )
    points = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    i, j = np.meshgrid(np.arange(rings), np.arange(segments), indexing="ij")
    right = (j + 1) % segments
    a, b, c, d = (row * segments + column for row, column in ((i, j), (i + 1, j), (i + 1, right), (i, right)))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return points.reshape(-1, 3) * radius + centre, faces


def test_tilted_plane_is_exact() -> None:
    corner, a, b = np.array([-1.0, -0.8, 1.2]), np.array([0.1, 1.4, 1.1]), np.array([2.2, 0.1, 1.6])
    normal = np.cross(a, b)
    if normal @ corner > 0:  # turn its face to the camera
        a, b, normal = b, a, -normal
    depth, face = draw(*rectangle(corner, a, b))
    expected = (normal @ corner) / (rays() @ normal)
    # Which pixels it covers: solve for its own two coordinates.
    place = rays() * expected[..., None] - corner
    s, t = np.moveaxis(place @ np.linalg.pinv(np.stack([a, b])), -1, 0)
    inside, outside = np.abs(np.stack([s, t]) - 0.5).max(0) < 0.495, np.abs(np.stack([s, t]) - 0.5).max(0) > 0.505
    assert np.count_nonzero(inside) > 2000
    np.testing.assert_allclose(depth[inside], expected[inside], atol=1e-5)
    assert (face[inside] >= 0).all()
    assert np.isinf(depth[outside]).all()
    assert (face[outside] == -1).all()


def test_sphere() -> None:
    centre, radius = np.array([0.2, -0.1, 2.0]), 0.5
    depth, _ = draw(*sphere(centre, radius))
    direction = rays()
    length2 = (direction**2).sum(-1)
    along = direction @ centre / length2
    inside2 = along**2 - (centre @ centre - radius**2) / length2
    hit = inside2 > 0
    expected = along - np.sqrt(np.where(hit, inside2, 0))
    normal = (direction * expected[..., None] - centre) / radius
    steep = hit & (-(normal * direction).sum(-1) / np.sqrt(length2) > 0.2)
    assert np.count_nonzero(steep) > 3000
    assert np.abs(depth - expected)[steep].max() < 1e-3
    # The silhouette, to a pixel.
    disc = hit.astype(np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    assert np.isfinite(depth[cv2.erode(disc, kernel) > 0]).all()
    assert np.isinf(depth[cv2.dilate(disc, kernel) == 0]).all()


@pytest.mark.parametrize("nearer_first", [True, False])
def test_the_nearest_face_wins(nearer_first: bool) -> None:
    wall = rectangle(np.array([-3.0, -3.0, 3.0]), np.array([0, 6.0, 0]), np.array([6.0, 0, 0]))
    crate = box(np.array([-0.2, -0.2, 1.5]), np.array([0.3, 0.2, 2.0]))
    first, second = (crate, wall) if nearer_first else (wall, crate)
    depth, face = draw(np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1] + len(first[0])]))
    front = rays() * 1.5
    on_crate = (front[..., 0] > -0.19) & (front[..., 0] < 0.29) & (np.abs(front[..., 1]) < 0.19)
    beside = (front[..., 0] < -0.21) | (front[..., 0] > 0.31) | (np.abs(front[..., 1]) > 0.21)
    np.testing.assert_allclose(depth[on_crate], 1.5, atol=1e-5)
    np.testing.assert_allclose(depth[beside], 3.0, atol=1e-5)
    of_crate = face < 12 if nearer_first else face >= 2
    assert of_crate[on_crate].all()
    assert not of_crate[beside].any()
    assert np.isfinite(depth).all()


def test_back_faces_are_not_drawn() -> None:
    corner, a, b = np.array([-1.0, -1.0, 2.0]), np.array([0, 2.0, 0]), np.array([2.0, 0, 0])
    assert np.isfinite(draw(*rectangle(corner, a, b))[0]).any()
    assert np.isinf(draw(*rectangle(corner, b, a))[0]).all()
    # From inside a box nothing of it is seen.
    assert np.isinf(draw(*box(np.array([-1.0, -1, -1]), np.array([1.0, 1, 3])))[0]).all()


def test_neighbouring_triangles_leave_no_gap() -> None:
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(-1.2, 1.2, 40), np.linspace(-1.0, 1.0, 30))
    jitter = rng.uniform(-0.02, 0.02, (2, *u.shape))
    points = np.stack([u + jitter[0], v + jitter[1], 1.5 + 0.05 * np.sin(9 * u) * np.cos(7 * v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(29), np.arange(39), indexing="ij")
    a, b, c, d = i * 40 + j, (i + 1) * 40 + j, (i + 1) * 40 + j + 1, i * 40 + j + 1
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    assert np.isfinite(draw(points, faces)[0]).all()


def test_triangles_behind_or_too_near_are_left_out() -> None:
    corner, a, b = np.array([-5.0, 0.3, -2.0]), np.array([0, 0, 6.0]), np.array([10.0, 0, 0])
    for first, second in ((a, b), (b, a)):  # a floor that runs under the camera
        assert np.isinf(draw(*rectangle(corner, first, second))[0]).all()


# The body


def camera_at(eye: tuple[float, float, float], target: tuple[float, float, float] = (0, 0, 0)) -> DepthCamera:
    pose = look_at(np.array(eye, dtype=float), np.array(target, dtype=float))
    return DepthCamera("cam0", 256, 212, 184.0, 183.0, 126.5, 102.5, pose)


@pytest.fixture(scope="module")
def posed(default_body: Body) -> PosedBody:
    return default_body.pose(PosturePrior.load().sample(np.random.default_rng(8))[0])


def test_body_against_a_ray_caster(posed: PosedBody) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    camera = camera_at((1.2, -1.6, 0.7))
    depth, labels = render_body(posed, camera)
    points, faces, regions = posed.by_region()
    mesh = trimesh.Trimesh(points.astype(np.float64), faces, process=False)
    directions = np.concatenate([camera.rays, np.ones((*depth.shape, 1), np.float32)], -1).reshape(-1, 3)
    directions = directions.astype(np.float64) @ camera.world_from_camera[:3, :3].T
    origins = np.broadcast_to(camera.world_from_camera[:3, 3], directions.shape)
    hits, ray_of_hit, face_of_hit = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    cast = np.zeros(depth.size)
    cast[ray_of_hit] = transform_points(camera.camera_from_world, hits)[:, 2]
    cast = cast.reshape(depth.shape)
    cast_labels = np.zeros(depth.size, dtype=np.uint8)
    cast_labels[ray_of_hit] = regions[face_of_hit]
    both = (depth > 0) & (cast > 0)
    assert np.count_nonzero(both) > 3000
    # The silhouettes agree but for rays that graze an edge.
    assert np.count_nonzero((depth > 0) != (cast > 0)) < 0.003 * np.count_nonzero(both)
    kernel = np.ones((3, 3), np.uint8)
    body = (cast > 0).astype(np.uint8)
    assert (depth[cv2.erode(body, kernel) > 0] > 0).all()
    assert (depth[cv2.dilate(body, kernel) == 0] == 0).all()
    assert (np.abs(depth - cast)[both] < 1e-3).mean() > 0.999
    assert (labels == cast_labels.reshape(depth.shape))[both].mean() > 0.999


def test_depth_and_labels_belong_together(posed: PosedBody) -> None:
    depth, labels = render_body(posed, camera_at((0.3, -2.4, 0.2)))
    assert (depth.dtype, labels.dtype) == (np.float32, np.uint8)
    np.testing.assert_array_equal(depth > 0, labels > 0)
    assert labels.max() <= 43
    assert len(np.unique(labels)) > 20


def test_rendered_points_lie_on_the_body(posed: PosedBody) -> None:
    camera = camera_at((-1.5, -1.5, 1.0))
    depth, _ = render_body(posed, camera)
    points = transform_points(camera.world_from_camera, camera.unproject(depth))
    low, high = posed.vertices.min(0) - 1e-3, posed.vertices.max(0) + 1e-3
    assert ((points > low) & (points < high)).all()


def test_front_and_back_of_a_person(default_body: Body) -> None:
    """Facing −Y, the chest is seen from there, its right on the picture's left, and the back from +Y."""
    from depthmocap.body.regions import REGION

    body = default_body.pose(REST_POSTURE)
    _, front = render_body(body, camera_at((0, -2.5, 0.1)))
    _, back = render_body(body, camera_at((0, 2.5, 0.1)))
    chest, behind = [REGION["chest R"], REGION["chest L"]], [REGION["upper back R"], REGION["upper back L"]]
    assert np.isin(front, chest).sum() > 300
    assert np.isin(back, behind).sum() > 300
    assert not np.isin(front, behind).any()
    assert not np.isin(back, chest).any()
    columns = {name: np.nonzero(front == REGION[name])[1].mean() for name in ("chest R", "chest L", "hand R", "hand L")}
    assert columns["hand R"] < columns["chest R"] < columns["chest L"] < columns["hand L"]


def test_body_behind_or_around_the_camera(posed: PosedBody) -> None:
    x, y, z = posed.vertices.mean(0).tolist()
    depth, labels = render_body(posed, camera_at((0, -3, 0), (0, -6, 0)))
    assert not depth.any()
    assert not labels.any()
    depth, _ = render_body(posed, camera_at((x, y, z), (x, y - 2, z)))
    assert (depth[depth > 0] > NEAR_M).all()


def test_pictures_are_cut_at_their_borders(posed: PosedBody) -> None:
    whole = camera_at((0.2, -1.6, 0.3))
    depth, labels = render_body(posed, whole)
    rows, columns = np.nonzero(depth)
    top, left = int(np.median(rows)) - 20, int(np.median(columns)) - 10
    part = DepthCamera(
        "part", 30, 40, whole.fx, whole.fy, whole.cx - left, whole.cy - top, whole.world_from_camera
    )  # fmt: skip
    part_depth, part_labels = render_body(posed, part)
    window = (slice(top, top + 40), slice(left, left + 30))
    np.testing.assert_allclose(part_depth, depth[window], atol=1e-4)
    assert (part_labels == labels[window]).mean() > 0.995
    # A body that is wholly outside the picture leaves nothing in it.
    away = DepthCamera("away", 30, 40, whole.fx, whole.fy, whole.cx + 5000, whole.cy, whole.world_from_camera)
    assert not render_body(posed, away)[0].any()


def test_background_hides_and_is_hidden(posed: PosedBody) -> None:
    camera = camera_at((0, -2.5, 0.1))
    bare, labels = render_body(posed, camera)
    room = np.full(bare.shape, 4.0, dtype=np.float32)
    room[:, :128] = 1.0
    room[:10] = 0
    depth, room_labels = render_body(posed, camera, room)
    person = bare > 0
    assert (depth[:, :128][10:] == 1).all()
    assert not room_labels[10:, :128].any()
    np.testing.assert_array_equal(depth[:, 128:][person[:, 128:]], bare[:, 128:][person[:, 128:]])
    np.testing.assert_array_equal(room_labels[:, 128:], labels[:, 128:])
    assert (depth[10:, 128:][~person[10:, 128:]] == 4).all()
    assert (depth[:10][~person[:10]] == 0).all()
