"""The paper's network and its window."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from depthmocap.classify.window import (
    MIN_PIXELS,
    PAPER_MEAN,
    PAPER_PERSON,
    PAPER_WINDOW,
    Window,
    make_paper_window,
)
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import render_body

torch = pytest.importorskip("torch")

from torch import nn  # noqa: E402

from depthmocap.train.networks import CLASSES, NETWORKS, masked_outputs  # noqa: E402
from depthmocap.train.paper_network import PaperNet  # noqa: E402

CAMERA = DepthCamera("camera", 512, 424, 368.0, 368.0, 255.5, 211.5)


@pytest.fixture(scope="module")
def network() -> PaperNet:
    torch.manual_seed(0)
    return PaperNet().eval()


def test_layers_of_the_released_model(network: PaperNet) -> None:
    shapes = {name: tuple(p.shape) for name, p in network.named_parameters() if name.endswith("weight")}
    assert shapes == {
        "conv1.weight": (64, 1, 5, 5), "conv2.weight": (128, 64, 3, 3), "conv3.weight": (256, 128, 5, 5),
        "conv4.weight": (44, 256, 3, 3), "score1.weight": (44, 64, 1, 1), "score2.weight": (44, 128, 1, 1),
        "up3.weight": (44, 44, 3, 3), "up2.weight": (44, 44, 4, 4), "up1.weight": (44, 44, 19, 19),
    }  # fmt: skip
    assert sum(parameter.numel() for parameter in network.parameters()) == 1_752_360  # "1.75 M"
    for name, parameter in network.named_parameters():
        if name.endswith("weight"):
            assert parameter.std().item() == pytest.approx(0.01, rel=0.1), name
            assert abs(parameter.mean().item()) < 0.002, name
        else:
            assert (parameter == (0 if name.startswith("up") else 1)).all(), name


def test_sizes_are_the_papers(network: PaperNet) -> None:
    sizes = {}
    names = {module: name for name, module in network.named_children()}

    def note(module: Any, _: object, output: Any) -> None:
        sizes[names[module]] = tuple(output.shape[1:])

    hooks = [module.register_forward_hook(note) for module in names]
    with torch.no_grad():
        assert network(torch.zeros(1, *PaperNet.input_shape)).shape == (1, CLASSES, 250, 250)
    for hook in hooks:
        hook.remove()
    assert sizes["conv4"] == (44, 14, 14)
    assert sizes["conv1"] == (64, 125, 125)
    assert sizes["score1"][1:] == sizes["up2"][1:] == (34, 34)
    assert sizes["score2"][1:] == sizes["up3"][1:] == (16, 16)


def test_depth_alone_is_read(network: PaperNet) -> None:
    x = torch.rand(1, 2, 250, 250, generator=torch.Generator().manual_seed(0))
    without = x.clone()
    without[:, 1] = 0
    with torch.no_grad():
        assert torch.equal(network(x), network(without))


def test_dropout_is_of_training_alone() -> None:
    network = PaperNet()
    x = torch.rand(1, 2, 250, 250)
    with torch.no_grad():
        assert not torch.equal(network.train()(x), network(x))
        assert torch.equal(network.eval()(x), network(x))


def test_masked_outputs(network: PaperNet) -> None:
    x = torch.rand(2, 2, 250, 250)
    labels = torch.randint(0, CLASSES, (2, 250, 250))
    with torch.no_grad():
        full = network(x)
        for place in ((0, 0, 0), (1, 17, 201), (1, 249, 249)):
            mask = torch.zeros(2, 250, 250, dtype=torch.bool)
            mask[place] = True
            chosen, truth, _ = masked_outputs(network, x, labels, mask)
            torch.testing.assert_close(chosen, full[place[0], None, :, place[1], place[2]], rtol=0, atol=1e-5)
            assert truth == labels[place]
        mask = torch.rand(2, 250, 250) < 0.3
        chosen, truth, _ = masked_outputs(network, x, labels, mask)
    assert chosen.shape == (mask.sum(), CLASSES)
    entropy = nn.functional.cross_entropy(full.permute(0, 2, 3, 1)[mask], labels[mask])
    torch.testing.assert_close(nn.functional.cross_entropy(chosen, truth.long()), entropy)


def test_squares_train_as_the_transposed_convolution_does() -> None:
    torch.manual_seed(0)
    network = PaperNet().eval()
    x = torch.rand(1, 2, 250, 250)
    network(x).square().sum().backward()
    assert network.up1.weight.grad is not None
    expected = network.up1.weight.grad.clone()
    network.zero_grad()
    n, rows, columns, _, classes = (squares := network.squares(x)).shape
    scores = squares.unflatten(3, (7, 7)).permute(0, 5, 1, 3, 2, 4).reshape(n, classes, rows * 7, columns * 7)
    scores[..., :250, :250].square().sum().backward()
    torch.testing.assert_close(network.up1.weight.grad, expected, rtol=1e-4, atol=1e-3)


def test_both_networks_have_names_and_inputs() -> None:
    assert {name: kind.input_shape for name, kind in NETWORKS.items()} == {
        "fast": (3, 192, 192),
        "paper": (2, 250, 250),
    }


def made(depth_m: np.ndarray, mask: np.ndarray) -> Window:
    window = make_paper_window(depth_m, mask, CAMERA)
    assert window is not None
    return window


def picture(body: Body, distance_m: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    pose = look_at(np.array([0.5, -1.0, 0.2]) * distance_m, np.zeros(3))
    camera = DepthCamera("camera", 512, 424, 368.0, 368.0, 255.5, 211.5, pose)
    return render_body(body.pose(PosturePrior.load().sample(np.random.default_rng(seed))[0]), camera)


@pytest.mark.parametrize("height", [95, 190, 380])
@pytest.mark.parametrize("width", [40, 300])
def test_a_flat_rectangle(height: int, width: int) -> None:
    depth = np.full((424, 512), 3.0, np.float32)
    mask = np.zeros(depth.shape, bool)
    mask[20 : 20 + height, 100 : 100 + width] = True
    window = made(depth, mask)
    step = max(height, width) / PAPER_PERSON
    assert window.step == pytest.approx(step)
    level, person = window.inputs
    assert window.inputs.shape == (2, PAPER_WINDOW, PAPER_WINDOW)
    np.testing.assert_allclose(level[person > 0], PAPER_MEAN / 255, rtol=1e-5)
    assert (level[person == 0] == 1).all()
    rows, columns = np.nonzero(person)
    assert np.ptp(rows) + 1 == pytest.approx(height / step, abs=1)
    assert np.ptp(columns) + 1 == pytest.approx(width / step, abs=1)
    for places in (rows, columns):  # 30 pixels of margin on the longer side, and centred
        assert places.min() >= 30 and places.max() < 220
        assert (places.min() + places.max()) / 2 == pytest.approx((PAPER_WINDOW - 1) / 2, abs=1.5)


def test_depth_has_255_levels_over_750_cm() -> None:
    mask = np.zeros((424, 512), bool)
    mask[50:240, 50:240] = True
    depth = np.full(mask.shape, 2.0, np.float32)
    depth[:145] += 0.75  # half of the person 75 cm farther: 25.5 levels, rounded to whole ones
    level = np.unique(np.round(made(depth, mask).inputs[0, 40:120, 100] * 255, 3))
    other = np.unique(np.round(made(depth, mask).inputs[0, 130:210, 100] * 255, 3))
    assert len(level) == len(other) == 1
    assert level[0] - other[0] == pytest.approx(np.rint(2.25 / 7.5 * 255) - np.rint(1.5 / 7.5 * 255), abs=1e-2)
    # How far the person stands does not matter, up to the rounding.
    farther = made(depth + 1.0, mask).inputs[0] * 255
    assert np.abs(farther - made(depth, mask).inputs[0] * 255).max() <= 1.01


def test_background_does_not_bleed_into_the_person() -> None:
    mask = np.zeros((424, 512), bool)
    mask[50:400, 60:65] = True
    mask[200:230, 60:240] = True
    depth = np.where(mask, 2.0, 7.5).astype(np.float32)
    level, person = made(depth, mask).inputs
    np.testing.assert_allclose(level[person > 0] * 255, PAPER_MEAN, atol=1e-3)
    assert (level[person == 0] == 1).all()


@pytest.mark.parametrize("distance_m", [1.9, 4.5])
def test_labels_there_and_back(default_body: Body, distance_m: float) -> None:
    depth, labels = picture(default_body, distance_m)
    person = labels > 0
    window = made(depth, person)
    assert window.inputs[0][window.inputs[1] > 0].mean() == pytest.approx(PAPER_MEAN / 255, abs=1e-4)
    in_window = window.labels_from_image(labels)
    np.testing.assert_array_equal(in_window > 0, window.inputs[1] > 0)
    back, confidence = window.labels_to_image(in_window, np.ones(in_window.shape, np.float32), person)
    assert (back == labels)[person].mean() > 0.94
    np.testing.assert_array_equal(confidence, person)


def test_nobody_and_depth_that_is_none() -> None:
    mask = np.zeros((60, 80), bool)
    depth = np.full(mask.shape, 2.0, np.float32)
    assert make_paper_window(depth, mask, CAMERA) is None
    mask[20:30, 30 : 30 + MIN_PIXELS // 10] = True
    assert make_paper_window(depth, mask, CAMERA) is not None
    depth[25, 31] = np.nan
    assert make_paper_window(depth, mask, CAMERA) is None
    mask[10:40, 10:60] = True
    depth[12, 12], depth[13, 13], depth[14, 14] = np.nan, np.inf, -1.0
    window = made(depth, mask)
    assert np.isfinite(window.inputs).all()
    assert not window.inputs[1][window.labels_from_image((~np.isfinite(depth) | (depth <= 0)).view(np.uint8)) > 0].any()
