"""Windows, noise and training batches in torch, on CPU tensors, against the NumPy ones where there are any."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
import pytest

from depthmocap.body.model import Body, BodyModel
from depthmocap.classify import preprocess
from depthmocap.classify.preprocess import make_window
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.postures import PosturePrior
from depthmocap.synth.render import Material, PosedPerson, render_person

torch = pytest.importorskip("torch")

from depthmocap.synth import torch_windows  # noqa: E402
from depthmocap.synth.torch_bank import BodyBank, RestLayer  # noqa: E402
from depthmocap.synth.torch_body import TorchModel  # noqa: E402
from depthmocap.synth.torch_noise import TorchNoise, add_noise  # noqa: E402
from depthmocap.synth.torch_render import TorchCameras, TorchLayers  # noqa: E402
from depthmocap.synth.torch_source import TorchSynth, TorchSynthSettings, posture_pool, random_poses  # noqa: E402

#: Distances at which the person is larger and smaller than a window.
DISTANCES = (1.0, 1.6, 2.3, 3.0, 4.0)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Tensors this small gain nothing from more, and on a busy machine threads wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def people(default_body: Body) -> list[PosedPerson]:
    rng = np.random.default_rng(3)
    return [PosedPerson(default_body.pose(PosturePrior.load().sample(rng)[0])) for _ in DISTANCES]


@pytest.fixture(scope="module")
def cameras(people: list[PosedPerson]) -> list[DepthCamera]:
    made = []
    for i, (person, distance) in enumerate(zip(people, DISTANCES, strict=True)):
        centre = person.vertices.mean(0).astype(float)
        eye = centre + distance * np.array([np.sin(2 * i), -np.cos(2 * i), 0.2])
        made.append(DepthCamera("camera", 300, 260, 200.0 + i, 200.0, 151.0, 128.0, look_at(eye, centre)))
    return made


@pytest.fixture(scope="module")
def pictures(people: list[PosedPerson], cameras: list[DepthCamera]) -> tuple[np.ndarray, np.ndarray]:
    views = [render_person(person, camera) for person, camera in zip(people, cameras, strict=True)]
    return np.stack([view.depth_m for view in views]), np.stack([view.labels for view in views])


def focal(cameras: list[DepthCamera]) -> torch.Tensor:
    return torch.tensor([camera.fx for camera in cameras], dtype=torch.float64)


# Windows of pictures


@pytest.mark.parametrize("sizes", [(192, 180), (250, 190)])
def test_windows_are_numpys(
    pictures: tuple[np.ndarray, np.ndarray], cameras: list[DepthCamera], sizes: tuple[int, int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    rng = np.random.default_rng(0)
    depth, labels = pictures[0].copy(), pictures[1]
    mask = labels > 0
    stray = rng.random(depth.shape) < 1e-3  # pixels that fly beside nothing, holes, and rough depth
    depth[stray] = rng.uniform(0.3, 6, stray.sum())
    mask |= stray
    depth[rng.random(depth.shape) < 0.05] = 0
    depth[0] *= rng.normal(1, 0.02, depth[0].shape)
    depth[1, :, :40] = 2.0
    mask[2] = False  # nobody
    mask[3] &= np.add.outer(np.arange(260), np.arange(300)) % 260 < 3  # next to nobody
    monkeypatch.setattr(preprocess, "WINDOW", sizes[0])
    monkeypatch.setattr(preprocess, "PERSON", sizes[1])
    got = torch_windows.make_windows(torch.from_numpy(depth), torch.from_numpy(mask), focal(cameras), *sizes)
    got_labels = got.labels_from_images(torch.from_numpy(labels), 255)
    found = []
    for i, camera in enumerate(cameras):
        expected = make_window(depth[i], mask[i], camera)
        found.append(expected is not None)
        if expected is None:
            assert not got.inputs[i].any()
            assert (got_labels[i] == 255).all()
            continue
        assert (float(got.left[i]), float(got.top[i]), float(got.step[i])) == pytest.approx(
            (expected.left, expected.top, expected.step), abs=1e-9
        )
        np.testing.assert_array_equal(got.inputs[i, 1].numpy(), expected.inputs[1])
        np.testing.assert_allclose(got.inputs[i].numpy(), expected.inputs, atol=3e-5)
        np.testing.assert_array_equal(got_labels[i].numpy(), expected.labels_from_image(labels[i], 255))
    assert found == got.found.tolist()
    assert found[2] is False
    assert sum(found) >= 3


def test_median() -> None:
    rng = np.random.default_rng(1)
    values = rng.uniform(0.2, 9, (40, 33)).astype(np.float32)
    values[:10] = np.round(values[:10])  # many alike
    chosen = rng.random(values.shape) < np.linspace(0.05, 1, 40)[:, None]
    chosen[:, 0] = True
    got = torch_windows._median(torch.from_numpy(values), torch.from_numpy(chosen)).numpy()
    np.testing.assert_array_equal(got, [np.median(v[c]) for v, c in zip(values, chosen, strict=True)])


# Windows drawn at once


def drawn(
    people: list[PosedPerson], cameras: list[DepthCamera], layers: TorchLayers | None = None
) -> tuple[torch_windows.TorchWindows, torch.Tensor]:
    model = TorchModel.of(people[0].body.model)
    vertices = torch.from_numpy(np.stack([person.vertices for person in people]))
    sizes = torch.tensor([[camera.width, camera.height] for camera in cameras])
    return torch_windows.render_windows(
        vertices, model.faces, model.face_regions, TorchCameras.of(cameras), sizes, layers
    )


def expected_window(person: PosedPerson, camera: DepthCamera) -> tuple[preprocess.Window, np.ndarray]:
    view = render_person(person, camera)
    window = make_window(view.depth_m, view.person, camera)
    assert window is not None
    labels = window.labels_from_image(view.labels)
    return window, np.where(labels > 0, labels, 255)


def test_windows_drawn_at_once(people: list[PosedPerson], cameras: list[DepthCamera]) -> None:
    got, labels = drawn(people, cameras)
    kinds = set()
    for i, (person, camera) in enumerate(zip(people, cameras, strict=True)):
        window, expected = expected_window(person, camera)
        inputs = got.inputs[i].numpy()
        kinds.add(window.step > 1)
        if window.step <= 1:  # drawn at the sensor's own pixels: the same window
            assert float(got.step[i]) == window.step
            assert (float(got.left[i]), float(got.top[i])) == pytest.approx((window.left, window.top), abs=1e-9)
            assert np.count_nonzero(inputs[1] != window.inputs[1]) <= 3
            assert np.count_nonzero(np.abs(inputs - window.inputs).max(0) > 1e-3) <= 3
            assert np.count_nonzero(labels[i].numpy() != expected) <= 3
        else:  # drawn at the window's: its pixels see up to half a sensor's pixel beside
            assert float(got.step[i]) == pytest.approx(window.step, rel=0.02)
            assert (float(got.left[i]), float(got.top[i])) == pytest.approx((window.left, window.top), abs=2)
            both = (inputs[1] > 0) & (window.inputs[1] > 0)
            assert np.count_nonzero((inputs[1] > 0) != (window.inputs[1] > 0)) < 0.06 * both.sum()
            assert np.median(np.abs(inputs[0] - window.inputs[0])[both]) < 0.02
            assert (labels[i].numpy() == expected)[both].mean() > 0.9
            np.testing.assert_allclose(inputs[2], window.inputs[2], atol=0.03)
    assert kinds == {True, False}


def test_a_person_that_the_border_cuts(people: list[PosedPerson], cameras: list[DepthCamera]) -> None:
    cut = [dataclasses.replace(camera, cx=camera.cx - 120, cy=camera.cy + 60) for camera in cameras]
    got, labels = drawn(people[3:], cut[3:])
    for i in range(2):
        window, expected = expected_window(people[3 + i], cut[3 + i])
        assert window.step <= 1
        assert float(got.step[i]) == window.step
        assert np.count_nonzero(np.abs(got.inputs[i].numpy() - window.inputs).max(0) > 1e-3) <= 3
        assert np.count_nonzero(labels[i].numpy() != expected) <= 3
    nobody, none = drawn(people[:1], [dataclasses.replace(cameras[0], cx=5000.0)])
    assert not nobody.found.any()
    assert not nobody.inputs.any()
    assert (none == 255).all()


# Noise


def wall(depth_m: float, count: int = 4, side: int = 80) -> torch.Tensor:
    depth = torch.zeros(count, side, side)
    depth[:, 10:-10, 10:-10] = depth_m
    return depth


def sensed(depth: torch.Tensor, noise: TorchNoise, seed: int = 0, pixel_px: float = 1.0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return add_noise(depth, torch.full((len(depth),), pixel_px), noise, generator)


QUIET = TorchNoise((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (1e-4,))


@pytest.mark.parametrize("depth_m", [0.5, 2.5])
def test_noise_along_the_axis(depth_m: float) -> None:
    noise = dataclasses.replace(QUIET, axial_m=(0.002, 0.002), axial_per_m=(0.003, 0.003))
    out = sensed(wall(depth_m), noise)[:, 20:-20, 20:-20]
    assert float(out.std()) == pytest.approx(0.002 + 0.003 * (depth_m - 0.5), rel=0.05)
    assert float(out.mean()) == pytest.approx(depth_m, abs=3e-4)


def test_noise_at_edges() -> None:
    depth = wall(2.0)
    lost = sensed(depth, dataclasses.replace(QUIET, edge_loss=(0.4, 0.4)))
    rim = (depth > 0) & (torch.nn.functional.max_pool2d((depth == 0).float(), 3, 1, 1) > 0)
    assert float((lost[rim] == 0).float().mean()) == pytest.approx(0.4, abs=0.06)
    inside = (depth > 0) & ~rim
    torch.testing.assert_close(lost[inside], depth[inside], atol=1e-4, rtol=0)
    flying = sensed(depth, dataclasses.replace(QUIET, flying=(0.3, 0.3)))
    behind = flying[rim] - 2.0
    assert float((behind > 1e-3).float().mean()) == pytest.approx(0.3, abs=0.06)
    assert float(behind.max()) < 0.16
    step = wall(2.0)
    step[:, :, 40:-10] = 3.0
    between = sensed(step, dataclasses.replace(QUIET, flying=(1.0, 1.0)))[:, 20:-20, 39:41]
    assert ((between > 2.0 - 1e-3) & (between < 3.0 + 1e-3)).all()
    assert 0.2 < float(between.std()) < 0.4
    for out in (lost, flying):
        assert not out[depth == 0].any()


def test_noise_across_and_steps() -> None:
    depth = wall(2.0)
    moved = sensed(depth, dataclasses.replace(QUIET, lateral_px=(1.0, 1.0)))
    assert ((moved > 0) != (depth > 0)).sum() > 100
    # The same deviation is less of a larger pixel.
    coarse = sensed(depth, dataclasses.replace(QUIET, lateral_px=(1.0, 1.0)), pixel_px=10.0)
    assert torch.equal(coarse > 0, depth > 0)
    stepped = sensed(wall(2.0), dataclasses.replace(QUIET, axial_m=(0.02, 0.02), quantise_m=(0.03,)))
    assert float((stepped / 0.03 - (stepped / 0.03).round()).abs().max()) < 1e-3
    assert len(stepped.unique()) > 3
    assert torch.equal(sensed(depth, TorchNoise(), 5), sensed(depth, TorchNoise(), 5))
    assert not torch.equal(sensed(depth, TorchNoise(), 5), sensed(depth, TorchNoise(), 6))


# Bank and source


def shells(body: Body, kind: int) -> list[RestLayer]:
    """What a body wears: nothing, a shell, or two; the second follows one bone alone."""
    model = body.model
    rest = (body.rest_vertices * 1.01).astype(np.float32)
    shell = RestLayer(rest, model.faces[::2], Material.CLOTH, model.skin_indices, model.skin_weights)
    head = model.bone_names.index("head")
    hat = RestLayer(rest[:300] + np.float32(0.1), np.arange(300).reshape(-1, 3), Material.HAIR,
                    np.full((300, 1), head), np.ones((300, 1), np.float32))  # fmt: skip
    return [[], [shell], [shell, hat]][kind]


@pytest.fixture(scope="module")
def bank(default_body: Body) -> BodyBank:
    bodies = [
        default_body,
        default_body.with_vertices(default_body.rest_vertices + np.float32(0.01)),
        default_body.with_vertices(default_body.rest_vertices * np.float32(0.97)),
    ]
    return BodyBank.of(bodies, [shells(body, i) for i, body in enumerate(bodies)])


def test_bank_poses_what_bodies_wear(bank: BodyBank, default_body: Body, body_model: BodyModel) -> None:
    rng = np.random.default_rng(4)
    chosen = [2, 0, 1, 2]
    postures = np.stack([PosturePrior.load().sample(rng)[0] for _ in chosen])
    vertices, layers = bank.pose(torch.tensor(chosen), torch.from_numpy(postures))
    assert layers is not None
    for i, (which, posture) in enumerate(zip(chosen, postures, strict=True)):
        body = default_body.with_vertices(bank.rest_vertices[which].numpy())
        transforms = default_body.bone_transforms(posture)
        np.testing.assert_allclose(vertices[i].numpy(), body.pose(posture).vertices, atol=5e-6)
        own = layers.vertices[layers.picture_of_vertex == i].numpy()
        worn = shells(body, which)
        expected = [
            transforms.skin(layer.vertices, layer.skin_indices.astype(np.int32), layer.skin_weights) for layer in worn
        ]
        np.testing.assert_allclose(own, np.concatenate([np.zeros((0, 3)), *expected]), atol=1e-5)
        # Faces, too: corners of every triangle in its order.
        corners = layers.vertices[layers.faces[layers.picture_of_face == i]].numpy()
        meshes = [points[layer.faces] for points, layer in zip(expected, worn, strict=True)]
        np.testing.assert_allclose(corners, np.concatenate([np.zeros((0, 3, 3)), *meshes]), atol=1e-5)
        materials = [np.full(len(layer.faces), layer.material) for layer in worn]
        np.testing.assert_array_equal(
            layers.materials[layers.picture_of_face == i].numpy(), np.concatenate([np.zeros(0), *materials])
        )


SETTINGS = TorchSynthSettings(batch=8)


@pytest.fixture(scope="module")
def pool() -> np.ndarray:
    return posture_pool(PosturePrior.load(), 20, np.random.default_rng(1))


def source(bank: BodyBank, pool: np.ndarray, settings: TorchSynthSettings = SETTINGS, seed: int = 0) -> TorchSynth:
    sensors = [DepthCamera("fine", 512, 424, 366.0, 366.0, 256.0, 212.0),
               DepthCamera("coarse", 320, 240, 285.0, 285.0, 160.0, 120.0)]  # fmt: skip
    return TorchSynth(bank, pool, sensors, settings, seed)


def test_batches(bank: BodyBank, pool: np.ndarray) -> None:
    made = source(bank, pool)
    (x, y), (x1, _) = itertools.islice(made.batches(first=3), 2)
    assert (x.shape, y.shape) == ((8, 3, 192, 192), (8, 192, 192))
    assert (x.dtype, y.dtype) == (torch.float32, torch.uint8)
    assert x.isfinite().all()
    mask = x[:, 1] > 0
    assert (mask.flatten(1).sum(1) > 500).sum() >= 6
    assert ((y >= 1) & (y <= 43) | (y == 255)).all()
    assert ((y[mask] != 255).float().mean()) > 0.6
    assert len(y.unique()) > 30
    # A batch is of its number and the seed alone.
    again, again_labels = source(bank, pool).batch(3)
    assert torch.equal(x, again)
    assert torch.equal(y, again_labels)
    assert not torch.equal(x, x1)
    assert not torch.equal(x, source(bank, pool, seed=1).batch(3)[0])


def test_size_without_noise(bank: BodyBank, pool: np.ndarray) -> None:
    plain = TorchSynthSettings(batch=6, window=250, person=190, truncate=0.0, occlude=0.0, noise=None)
    x, y = source(bank, pool, plain).batch(0)
    assert x.shape == (6, 3, 250, 250)
    mask = x[:, 1] > 0
    extent = torch.stack([mask.any(1).sum(1), mask.any(2).sum(1)]).amax(0)
    assert ((extent >= 186) & (extent <= 191)).all()
    occluded, _ = source(bank, pool, dataclasses.replace(plain, occlude=1.0)).batch(0)
    # A part of most people is gone.
    assert ((occluded[:, 1] != x[:, 1]).flatten(1).sum(1) > 50).sum() >= 3
    assert y.max() == 255


def test_windows_of_nobody_teach_nothing(bank: BodyBank, pool: np.ndarray) -> None:
    lost = TorchSynthSettings(batch=8, truncate=1.0, truncated_aim_m=50.0)
    x, y = source(bank, pool, lost).batch(0)
    empty = ~(x[:, 1] > 0).flatten(1).any(1)
    assert empty.sum() >= 4
    assert not x[empty].any()
    assert (y[empty] == 255).all()


def test_cameras_look_at_people(people: list[PosedPerson]) -> None:
    vertices = torch.from_numpy(np.stack([person.vertices for person in people] * 40))
    settings = TorchSynthSettings(truncate=0.0)
    pose = random_poses(vertices, settings, torch.Generator().manual_seed(0)).numpy()
    rotation, translation = pose[:, :, :3], pose[:, :, 3]
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.tile(np.eye(3), (200, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-9)
    low, high = vertices.amin(1).numpy(), vertices.amax(1).numpy()
    centre = (rotation @ ((low + high) / 2)[:, :, None])[:, :, 0] + translation
    assert ((centre[:, 2] > 1.1) & (centre[:, 2] < 4.6)).all()
    assert np.abs(centre[:, :2] / centre[:, 2:]).max() < 0.4
    assert (rotation[:, 1, 2] < -0.3).all()  # the picture's y points down
    eye = -(rotation.swapaxes(1, 2) @ translation[:, :, None])[:, :, 0]
    height = eye[:, 2] - low[:, 2]
    assert ((height > 0.2 - 1e-6) & (height < 2.8 + 1e-6)).all()
    side = np.arctan2(eye[:, 0], -eye[:, 1])
    assert np.histogram(side, 4, (-np.pi, np.pi))[0].min() > 30


def test_bad_settings(bank: BodyBank, pool: np.ndarray, default_body: Body) -> None:
    with pytest.raises(InputError, match="distance_m"):
        TorchSynthSettings(distance_m=(4.0, 1.0))
    with pytest.raises(InputError, match="person"):
        TorchSynthSettings(window=100, person=120)
    with pytest.raises(InputError, match="batch"):
        TorchSynthSettings(batch=0)
    with pytest.raises(InputError, match="cameras"):
        TorchSynth(bank, pool, [])
    with pytest.raises(InputError, match="at least one body"):
        BodyBank.of([])
    with pytest.raises(InputError, match="one list of layers"):
        BodyBank.of([default_body], [])
