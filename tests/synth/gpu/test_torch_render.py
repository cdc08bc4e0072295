"""The renderer in torch against the one in Numba, on CPU tensors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from depthmocap.body.model import Body, BodyModel, PosedBody
from depthmocap.body.posture import world_rotations
from depthmocap.geometry import DepthCamera, look_at, transform_points
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.people.bodies import random_phenotype
from depthmocap.synth.render import Layer, Material, PosedPerson, Rendering, draw_mesh, render_person

torch = pytest.importorskip("torch")

from depthmocap.synth.gpu import torch_raster  # noqa: E402
from depthmocap.synth.gpu.torch_body import TorchModel, pose_batch, torch_bone_transforms, torch_world_rotations  # noqa: E402
from depthmocap.synth.gpu.torch_render import TorchCameras, TorchLayers, TorchRendering, render_batch, render_people  # noqa: E402

HEIGHT, WIDTH = 212, 256
COUNT = 6


def camera_at(eye: np.ndarray, target: np.ndarray, focal_px: float = 184.0) -> DepthCamera:
    return DepthCamera("camera", WIDTH, HEIGHT, focal_px, focal_px * 0.99, 126.5, 102.5, look_at(eye, target))


@pytest.fixture(scope="module")
def bodies(body_model: BodyModel) -> list[Body]:
    rng = np.random.default_rng(5)
    return [body_model.shape(random_phenotype(rng)) for _ in range(COUNT)]


@pytest.fixture(scope="module")
def postures() -> np.ndarray:
    rng = np.random.default_rng(6)
    return np.stack([PosturePrior.load().sample(rng)[0] for _ in range(COUNT)])


@pytest.fixture(scope="module")
def posed(bodies: list[Body], postures: np.ndarray) -> list[PosedBody]:
    return [body.pose(posture) for body, posture in zip(bodies, postures, strict=True)]


@pytest.fixture(scope="module")
def cameras(posed: list[PosedBody]) -> list[DepthCamera]:
    """From all around, 0.8 to 4 m away: the nearest bodies are cut by the borders."""
    rng = np.random.default_rng(7)
    made = []
    for body, distance in zip(posed, np.geomspace(0.8, 4.0, COUNT), strict=True):
        centre = body.vertices.mean(0).astype(float)
        direction = rng.normal(size=3) * [1, 1, 0.3]
        made.append(
            camera_at(centre + direction / np.linalg.norm(direction) * distance, centre + rng.normal(0, 0.1, 3))
        )
    return made


def stacked(posed: list[PosedBody]) -> torch.Tensor:
    return torch.from_numpy(np.stack([body.by_region()[0] for body in posed]))


def drawn(
    people: list[PosedPerson], cameras: list[DepthCamera], background_m: np.ndarray | None = None
) -> TorchRendering:
    model = TorchModel.of(people[0].body.model)
    background = None if background_m is None else torch.from_numpy(np.stack([background_m] * len(people)))
    return render_people(
        stacked([person.body for person in people]), model.faces, model.face_regions, TorchCameras.of(cameras),
        HEIGHT, WIDTH, TorchLayers.of(people), background,
    )  # fmt: skip


def assert_same(got: TorchRendering, i: int, expected: Rendering) -> None:
    """Silhouettes within a pixel, depth within a millimetre, and all but a pixel in a thousand really the same."""
    depth, seen = got.depth_m[i].numpy(), got.depth_m[i].numpy() > 0
    wanted = expected.depth_m > 0
    kernel = np.ones((3, 3), np.uint8)
    assert not (seen & (cv2.dilate(wanted.astype(np.uint8), kernel) == 0)).any()
    assert seen[cv2.erode(wanted.astype(np.uint8), kernel) > 0].all()
    few = 1e-3 * wanted.sum()
    assert np.count_nonzero(seen != wanted) <= few
    assert np.count_nonzero(np.abs(depth - expected.depth_m)[seen & wanted] > 1e-3) <= few
    assert np.count_nonzero(got.labels[i].numpy() != expected.labels) <= few
    assert np.count_nonzero(got.material[i].numpy() != expected.material) <= few


# Posing


def test_rotations(postures: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    many = np.concatenate([postures, rng.normal(0, 2, (4, 20, 3)), np.zeros((1, 20, 3)), np.full((1, 20, 3), 1e-9)])
    np.testing.assert_allclose(torch_world_rotations(torch.from_numpy(many)).numpy(), world_rotations(many), atol=1e-12)


def test_posed_as_on_the_cpu(bodies: list[Body], postures: np.ndarray) -> None:
    wild = postures + np.random.default_rng(1).normal(0, 0.5, postures.shape)
    model = TorchModel.of(bodies[0].model)
    transforms = torch_bone_transforms(
        torch.from_numpy(np.stack([model.pivots(body) for body in bodies])), torch.from_numpy(wild)
    )
    rest = torch.from_numpy(np.stack([body.rest_vertices for body in bodies]))
    # Autocast around a training step must not reach the geometry.
    with torch.autocast("cpu", torch.bfloat16):
        vertices = pose_batch(rest, model.weights, transforms)
    assert vertices.dtype == torch.float32
    for body, posture, got in zip(bodies, wild, vertices.numpy(), strict=True):
        np.testing.assert_allclose(got, body.pose(posture).vertices, atol=5e-6)


# People


def test_bodies(posed: list[PosedBody], cameras: list[DepthCamera]) -> None:
    people = [PosedPerson(body) for body in posed]
    got = drawn(people, cameras)
    assert (got.depth_m.dtype, got.labels.dtype, got.material.dtype) == (torch.float32, torch.uint8, torch.uint8)
    for i, (person, camera) in enumerate(zip(people, cameras, strict=True)):
        expected = render_person(person, camera)
        assert np.count_nonzero(expected.labels) > 500
        assert_same(got, i, expected)
        np.testing.assert_array_equal(got.person[i].numpy(), got.labels[i].numpy() > 0)


def dressed(posed: list[PosedBody]) -> list[PosedPerson]:
    """A tent over every second face and a board far before the body; some wear one of them, some nothing."""
    rng = np.random.default_rng(2)
    people = []
    for i, body in enumerate(posed):
        cloth = Layer(body.vertices + np.float32(0.02) * rng.normal(size=3).astype(np.float32), body.faces[::2],
                      Material.CLOTH)  # fmt: skip
        low, high = body.vertices.min(0), body.vertices.max(0)
        corners = np.array([[low[0], y, z] for y in (low[1], high[1]) for z in (low[2], high[2])], dtype=np.float32)
        board = Layer(
            corners - np.float32([0.5, 0, 0]), np.array([[0, 1, 2], [3, 1, 2]], dtype=np.int32), Material.HAIR
        )
        people.append(PosedPerson(body, ((), (cloth,), (cloth, board))[i % 3]))
    return people


def test_clothes(posed: list[PosedBody], cameras: list[DepthCamera]) -> None:
    people = dressed(posed)
    got = drawn(people, cameras)
    hidden = 0
    for i, (person, camera) in enumerate(zip(people, cameras, strict=True)):
        expected = render_person(person, camera)
        assert_same(got, i, expected)
        hidden += np.count_nonzero(
            (render_person(PosedPerson(person.body), camera).labels > 0) & (expected.labels == 0)
        )
    assert hidden > 100  # the board is beyond reach of the skin, so that labels behind it are gone


def test_room(posed: list[PosedBody], cameras: list[DepthCamera]) -> None:
    room = np.full((HEIGHT, WIDTH), 5.0, dtype=np.float32)
    room[:, :100] = 1.5
    room[:20] = 0
    people = dressed(posed)
    got = drawn(people, cameras, room)
    for i, (person, camera) in enumerate(zip(people, cameras, strict=True)):
        assert_same(got, i, render_person(person, camera, room))


def test_one_is_as_many(posed: list[PosedBody], cameras: list[DepthCamera]) -> None:
    people = dressed(posed)
    many = drawn(people, cameras)
    one = drawn(people[2:3], cameras[2:3])
    for name in ("depth_m", "labels", "material"):
        assert torch.equal(getattr(one, name)[0], getattr(many, name)[2])


def test_pieces_do_not_matter(
    posed: list[PosedBody], cameras: list[DepthCamera], monkeypatch: pytest.MonkeyPatch
) -> None:
    people = dressed(posed)[:3]
    whole = drawn(people, cameras[:3])
    monkeypatch.setitem(torch_raster.FACES_AT_ONCE, "cpu", 9001)
    monkeypatch.setitem(torch_raster.PIXELS_AT_ONCE, "cpu", 701)
    pieces = drawn(people, cameras[:3])
    for name in ("depth_m", "labels", "material"):
        assert torch.equal(getattr(whole, name), getattr(pieces, name))


def test_nobody_in_view(posed: list[PosedBody]) -> None:
    centre = posed[0].vertices.mean(0).astype(float)
    away = camera_at(centre + np.array([0, -3, 0]), centre + np.array([0, -6, 0]))
    aside = camera_at(centre + np.array([0, -3, 0]), centre + np.array([20, 0, 0]))
    got = drawn(dressed(posed)[:2], [away, aside])
    assert not got.depth_m.any()
    assert not got.labels.any()
    assert not got.material.any()


def test_a_crop_is_a_part_of_the_picture(posed: list[PosedBody], cameras: list[DepthCamera]) -> None:
    model = TorchModel.of(posed[0].model)
    whole = TorchCameras.of(cameras)
    shift = torch.full((COUNT,), 1.0)
    part = whole.cropped(80 * shift, 50 * shift, shift)
    depth, labels = render_batch(stacked(posed), model.faces, model.face_regions, whole, HEIGHT, WIDTH)
    part_depth, part_labels = render_batch(stacked(posed), model.faces, model.face_regions, part, 100, 120)
    torch.testing.assert_close(part_depth, depth[:, 50:150, 80:200], atol=1e-4, rtol=0)
    assert (part_labels == labels[:, 50:150, 80:200]).float().mean() > 0.999
    # A pixel of twice the size sees what lies between the centres of four.
    coarse = whole.cropped(0 * shift, 0 * shift, 2 * shift)
    u, v = coarse.intrinsics[:, 2] * 2 + 0.5, coarse.intrinsics[:, 3] * 2 + 0.5
    torch.testing.assert_close(torch.stack([u, v], 1), whole.intrinsics[:, 2:])


# Triangles of all kinds


def soup(rng: np.random.Generator, count: int, size_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles before, around and behind a camera at the origin that looks along z."""
    centres = rng.uniform([-1.5, -1.5, -0.5], [1.5, 1.5, 3.0], (count, 1, 3))
    points = (centres + rng.normal(0, size_m, (count, 3, 3))).reshape(-1, 3).astype(np.float32)
    return points, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("size_m", [0.01, 0.3, 3.0])
@pytest.mark.parametrize("two_sided", [False, True])
def test_any_triangles(size_m: float, two_sided: bool) -> None:
    rng = np.random.default_rng(int(size_m * 100))
    camera = DepthCamera("camera", WIDTH, HEIGHT, 150.0, 151.0, 120.3, 99.8)
    meshes = [soup(rng, 60, size_m) for _ in range(2 if size_m > 1 else 6)]
    cameras = TorchCameras.of([camera] * len(meshes))
    points = torch.from_numpy(np.stack([mesh[0] for mesh in meshes]))
    keys = torch.full((len(meshes), HEIGHT, WIDTH), torch_raster.NOTHING)
    screen = torch_raster.project(cameras.points(points), cameras.intrinsics[:, None], 0.15)
    torch_raster.draw_shared(keys, screen, torch.from_numpy(meshes[0][1]).long(), two_sided)
    covered = 0
    for i, (vertices, faces) in enumerate(meshes):
        depth = np.full((HEIGHT, WIDTH), np.inf, dtype=np.float32)
        values = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
        draw_mesh(vertices, faces, np.arange(1, 61, dtype=np.uint8), camera, depth, values, two_sided)
        got = torch_raster.depth_of_keys(keys)[i].numpy()
        face = torch_raster.faces_of_keys(keys)[i].numpy()
        same = face == values
        covered += np.count_nonzero(values)
        # Where rounding decides, a border moves by a pixel; a face seen edge-on is all border.
        assert np.count_nonzero(~same) <= 2e-3 * np.count_nonzero(values) + 1
        np.testing.assert_allclose(got[same], depth[same], rtol=2e-4)
    assert covered > (30 if size_m < 0.1 else 3000)


def test_the_first_of_equal_faces_is_seen() -> None:
    points = torch.tensor([[[-1.0, -1, 2], [-1, 1, 2], [1, 1, 2]]])
    cameras = TorchCameras.of([DepthCamera("camera", 64, 48, 40.0, 40.0, 31.5, 23.5)])
    faces = torch.tensor([[0, 1, 2], [0, 1, 2]])
    for values in ([7, 9], [9, 7]):
        depth, labels = render_batch(points, faces, torch.tensor(values, dtype=torch.uint8), cameras, 48, 64)
        assert labels.max() == values[0]
        assert (labels > 0).sum() > 200
        torch.testing.assert_close(depth[labels > 0], torch.full_like(depth[labels > 0], 2.0))


def test_no_gap_between_neighbours() -> None:
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(-2, 2, 60), np.linspace(-2, 2, 50))
    points = np.stack([u, v, np.full_like(u, 1.5)], -1) + rng.uniform(-0.02, 0.02, (20, *u.shape, 3))
    i, j = np.meshgrid(np.arange(49), np.arange(59), indexing="ij")
    a, b, c, d = i * 60 + j, (i + 1) * 60 + j, (i + 1) * 60 + j + 1, i * 60 + j + 1
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    vertices = torch.from_numpy(points.reshape(20, -1, 3).astype(np.float32))
    # Corners on the centres of pixels, too, where many faces meet.
    vertices[10:] = torch.from_numpy(np.stack([u, v, np.full_like(u, 2.0)], -1).reshape(-1, 3).astype(np.float32))
    vertices[10:, :, :2] = (vertices[10:, :, :2] * 50).round() / 50
    cameras = TorchCameras.of([DepthCamera("camera", 160, 120, 100.0, 100.0, 80.0, 60.0)] * 20)
    values = torch.ones(len(faces), dtype=torch.uint8)
    depth, _ = render_batch(vertices, torch.from_numpy(faces), values, cameras, 120, 160)
    assert (depth > 0).all()


def test_a_plane_is_exact() -> None:
    rng = np.random.default_rng(3)
    camera = DepthCamera("camera", 160, 120, 140.0, 138.0, 80.5, 58.25, look_at(np.array([0.5, -3, 0.2]), np.zeros(3)))
    corners = np.array([[-9.0, 1.0, -9], [9, 1, -9], [9, 2, 9], [-9, 2, 9]]) + rng.normal(0, 1e-3, (4, 3))
    corners[3] = corners[0] + corners[2] - corners[1]
    local = transform_points(camera.camera_from_world, corners)
    normal = np.cross(local[1] - local[0], local[3] - local[0])
    expected = (normal @ local[0]) / (np.concatenate([camera.rays, np.ones((120, 160, 1))], -1) @ normal)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    vertices = torch.from_numpy(corners[None].astype(np.float32))
    depth, _ = render_batch(vertices, faces, torch.ones(2, dtype=torch.uint8), TorchCameras.of([camera]), 120, 160)
    np.testing.assert_allclose(depth[0].numpy(), expected, rtol=1e-5)
