"""Borders of regions are smooth, about where the faces' are, and the surface is the same."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from depthmocap.body.regions import MIRROR, REGION, REGION_NAMES
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.borders import RegionMesh, cut_along_borders
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import draw_mesh


def crosses(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = points[faces].astype(np.float64)
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def areas(points: np.ndarray, faces: np.ndarray, regions: np.ndarray) -> np.ndarray:
    return np.bincount(regions, np.linalg.norm(crosses(points, faces), axis=1), minlength=len(REGION_NAMES))


def edges(faces: np.ndarray) -> np.ndarray:
    return np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)


def border_length(points: np.ndarray, faces: np.ndarray, regions: np.ndarray) -> float:
    found, edge = np.unique(edges(faces), axis=0, return_inverse=True)
    of_side = np.repeat(regions.astype(int), 3)
    low, high = np.full(len(found), 99), np.zeros(len(found), int)
    np.minimum.at(low, edge.reshape(-1), of_side)
    np.maximum.at(high, edge.reshape(-1), of_side)
    a, b = points[found[low != high]].swapaxes(0, 1)
    return float(np.linalg.norm(a - b, axis=1).sum())


# On the body


def test_the_surface_stays_and_its_borders_are_shorter(body_model: BodyModel, default_body: Body) -> None:
    mesh = body_model.region_mesh
    rest = default_body.rest_vertices
    points = mesh.points(rest)
    uncut, cut = areas(rest, body_model.faces, body_model.face_regions), areas(points, mesh.faces, mesh.regions)
    assert cut.sum() == pytest.approx(uncut.sum(), rel=1e-5)
    # Regions keep their place and their size; the jagged way round them is half as long again.
    np.testing.assert_allclose(cut[1:], uncut[1:], rtol=0.08)
    before = border_length(rest, body_model.faces, body_model.face_regions)
    assert border_length(points, mesh.faces, mesh.regions) < 0.7 * before
    np.testing.assert_allclose(cut[1:], cut[MIRROR[1:]], rtol=0.05)
    for name in ("hand", "knee", "chest", "shoulder back"):
        centres = [points[mesh.faces[mesh.regions == REGION[f"{name} {side}"]]].mean((0, 1)) for side in ("R", "L")]
        assert centres[0][0] < 0 < centres[1][0]


def test_triangles_join_as_before(body_model: BodyModel) -> None:
    """Every side of a triangle is one of two, but for those that only one face had before: no gaps, no overlaps."""

    def lone(faces: np.ndarray) -> int:
        _, count = np.unique(edges(faces), axis=0, return_counts=True)
        assert count.max() <= 2
        return int((count == 1).sum())

    mesh = body_model.region_mesh
    # A side of one face alone may be cut in two.
    assert lone(body_model.faces) <= lone(mesh.faces) <= 2 * lone(body_model.faces)
    assert ((mesh.shares > 0) & (mesh.shares < 1)).all()


def test_any_body_in_any_posture_looks_the_same(body_model: BodyModel) -> None:
    posture = PosturePrior.load().sample(np.random.default_rng(8))[0]
    posed = body_model.shape(Phenotype(age=0.4, weight=0.9)).pose(posture)
    centre = posed.vertices.mean(0).astype(float)
    camera = DepthCamera(
        "c", 256, 212, 184.0, 183.0, 126.5, 102.5, look_at(centre + np.array([1.0, -1.6, 0.4]), centre)
    )

    def drawn(points: np.ndarray, faces: np.ndarray, regions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        depth = np.full((camera.height, camera.width), np.inf, np.float32)
        labels = np.zeros(depth.shape, np.uint8)
        draw_mesh(points, faces, regions, camera, depth, labels)
        return depth, labels

    depth, labels = drawn(posed.vertices, body_model.faces, body_model.face_regions)
    cut_depth, cut_labels = drawn(*posed.by_region())
    np.testing.assert_array_equal(np.isfinite(cut_depth), np.isfinite(depth))
    seen = np.isfinite(depth)
    assert np.abs(cut_depth[seen] - depth[seen]).max() < 1e-4
    # Labels differ beside borders alone.
    smooth = np.zeros(seen.shape, np.bool_)
    for region in np.unique(labels[seen]):
        smooth |= cv2.erode((labels == region).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    assert (labels == cut_labels)[smooth].all()
    assert 0.005 < (labels != cut_labels)[seen].mean() < 0.1


# On a mesh that one can follow


def grid(count: int) -> tuple[np.ndarray, np.ndarray]:
    """A square of a metre in the plane z = 0, of two triangles a cell."""
    step = np.linspace(0, 1, count)
    x, y = np.meshgrid(step, step)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    corner = np.arange(count * count).reshape(count, count)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def assert_divides(points: np.ndarray, mesh: RegionMesh, faces: np.ndarray) -> None:
    got = crosses(mesh.points(points), mesh.faces)
    assert got[:, 2].min() > 0, "a triangle is turned over"
    assert got[:, 2].sum() == pytest.approx(crosses(points, faces)[:, 2].sum())


def test_a_slanted_border_becomes_a_straight_line() -> None:
    points, faces = grid(101)
    middle = points[faces].mean(1)
    regions = np.where(middle[:, 1] < 0.31 + 0.37 * middle[:, 0], 1, 2).astype(np.uint8)
    mesh = cut_along_borders(points, faces, regions)
    assert_divides(points, mesh, faces)
    cut = mesh.points(points)[len(points) :]
    # Away from the square's own sides, where there is nothing beyond to mix with.
    inner = (cut[:, 0] > 0.06) & (cut[:, 0] < 0.94)
    away = (cut[:, 1] - 0.31 - 0.37 * cut[:, 0])[inner] / np.hypot(1, 0.37)
    assert np.abs(away).max() < 0.003  # cells are 10 mm wide, and the jagged border strays by up to 6
    assert border_length(mesh.points(points), mesh.faces, mesh.regions) == pytest.approx(np.hypot(1, 0.37), rel=0.03)
    assert border_length(points, faces, regions) > 1.2 * np.hypot(1, 0.37)


def test_three_regions_may_meet() -> None:
    points, faces = grid(41)
    middle = points[faces].mean(1) - 0.5
    angle = np.arctan2(middle[:, 1], middle[:, 0])
    regions = np.digitize(angle, [-np.pi / 3, np.pi / 3]).astype(np.uint8) + 1
    mesh = cut_along_borders(points, faces, regions)
    assert_divides(points, mesh, faces)
    assert set(np.unique(mesh.regions)) == {1, 2, 3}
    before, after = areas(points, faces, regions), areas(mesh.points(points), mesh.faces, mesh.regions)
    np.testing.assert_allclose(after[1:4], before[1:4], rtol=0.02)


def test_one_region_is_not_cut() -> None:
    points, faces = grid(5)
    mesh = cut_along_borders(points, faces, np.full(len(faces), 7, np.uint8))
    assert len(mesh.ends) == 0
    np.testing.assert_array_equal(mesh.points(points), points)
    np.testing.assert_array_equal(mesh.faces, faces)
    assert (mesh.regions == 7).all()
