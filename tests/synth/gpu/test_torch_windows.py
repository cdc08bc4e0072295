"""Windows and noise in torch, on CPU tensors, against the NumPy ones where there are any."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from depthmocap.body.model import Body
from depthmocap.classify import preprocess
from depthmocap.classify.preprocess import make_window
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import PosedPerson, render_person

torch = pytest.importorskip("torch")

from depthmocap.synth.gpu import torch_windows  # noqa: E402
from depthmocap.synth.gpu.torch_body import TorchModel  # noqa: E402
from depthmocap.synth.gpu.torch_noise import TorchNoise, add_noise  # noqa: E402
from depthmocap.synth.gpu.torch_render import TorchCameras, TorchLayers  # noqa: E402

#: Distances at which the person is larger and smaller than a window.
DISTANCES = (1.0, 1.6, 2.3, 3.0, 4.0)


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


def square(window: preprocess.Window | None, side: int = preprocess.WINDOW) -> preprocess.Window | None:
    """A window with empty pixels around it, as batches on a GPU have them."""
    if window is None:
        return None
    rows, columns = ((side - each) // 2 for each in window.inputs.shape[1:])
    inputs = np.pad(window.inputs, ((0, 0), (rows, rows), (columns, columns)))
    inputs[2] = window.inputs[2, 0, 0]
    left, top = window.left - columns * window.step, window.top - rows * window.step
    return dataclasses.replace(window, inputs=inputs, left=left, top=top)


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
    monkeypatch.setattr(preprocess, "PERSON", sizes[1])
    got = torch_windows.make_windows(torch.from_numpy(depth), torch.from_numpy(mask), focal(cameras), *sizes)
    got_labels = got.labels_from_images(torch.from_numpy(labels), 255)
    found = []
    for i, camera in enumerate(cameras):
        expected = square(make_window(depth[i], mask[i], camera), sizes[0])
        found.append(expected is not None)
        if expected is None:
            assert not got.inputs[i].any()
            assert (got_labels[i] == 255).all()
            continue
        assert (float(got.left[i]), float(got.top[i]), float(got.step[i])) == pytest.approx(
            (expected.left, expected.top, expected.step), abs=1e-9
        )
        # Pixels whose middle lies on a border of the picture's may be read on its other side.
        assert (np.abs(got.inputs[i].numpy() - expected.inputs).max(0) < 3e-5).mean() > 0.99
        assert (got_labels[i].numpy() == expected.labels_from_image(labels[i], 255)).mean() > 0.99
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
    points = torch.from_numpy(np.stack([person.body.by_region()[0] for person in people]))
    sizes = torch.tensor([[camera.width, camera.height] for camera in cameras])
    view = torch_windows.view_windows(points, model.faces, model.face_regions, TorchCameras.of(cameras), sizes, layers)
    return view.windows(view.rendering.depth_m, view.rendering.person)


def expected_window(person: PosedPerson, camera: DepthCamera) -> tuple[preprocess.Window, np.ndarray]:
    view = render_person(person, camera)
    window = square(make_window(view.depth_m, view.person, camera))
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
    person, camera = people[3], cameras[3]
    shifts = ((-150, 60), (150, -60), (0, 120), (0, -120))
    cut = [dataclasses.replace(camera, cx=camera.cx + x, cy=camera.cy + y) for x, y in shifts]
    got, labels = drawn([person] * 4, cut)
    whole = np.count_nonzero(render_person(person, camera).labels)
    for i in range(4):
        assert 200 < np.count_nonzero(render_person(person, cut[i]).labels) < 0.95 * whole
        window, expected = expected_window(person, cut[i])
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
