"""The network's shape, and the loss's way round shuffling its output."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.kernels.head import label_groups

pytest.importorskip("torch")

import torch

from depthmocap.train.networks import (
    CLASSES,
    FastNet,
    _Groups,
    _upsample,
    masked_outputs,
)


def small_network() -> FastNet:
    torch.manual_seed(0)
    return FastNet((8, 12, 16, 16, 16), (0, 1, 0, 1, 0)).eval()


def random_windows(count: int, height: int = 64, width: int = 64) -> torch.Tensor:
    """Windows of which a third of the pixels are the person's."""
    x = torch.randn(count, 3, height, width, generator=torch.Generator().manual_seed(0))
    x[:, 1] = (x[:, 1] < -0.4).float()
    return x


@pytest.mark.parametrize("size", [64, 192])
def test_output_shape(size: int) -> None:
    x = torch.zeros(2, 3, size, size)
    x[1, 1, 5:8, 10] = 1  # of two groups
    with torch.no_grad():
        probabilities, joints = small_network()(x)
    assert (probabilities.shape, joints.shape) == ((2, 4, CLASSES), (2, 18, 4))
    torch.testing.assert_close(probabilities.sum(-1), torch.ones(2, 4))


def test_the_fast_network_is_small() -> None:
    assert 1e6 < sum(parameter.numel() for parameter in FastNet().parameters()) < 3e6


def test_pictures_of_a_batch_do_not_mix() -> None:
    network = small_network()
    x = random_windows(3)
    with torch.no_grad():
        probabilities, joints = network(x)
        alone = [network(window[None]) for window in x]
    torch.testing.assert_close(probabilities, torch.cat([each[0] for each in alone]), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(joints, torch.cat([each[1] for each in alone]), atol=1e-4, rtol=1e-4)


def dense_logits(network: FastNet, x: torch.Tensor) -> torch.Tensor:
    """Logits (n, h, w, 44) of all pixels, by the head as the convolution that it is. Channel 44·k + c is class c of
    pixel k; pixel_shuffle wants all k of a class together."""
    logits = network.head(network.features(x)[0])
    n, _, h, w = logits.shape
    by_class = logits.reshape(n, 4, CLASSES, h, w).transpose(1, 2).reshape(n, CLASSES * 4, h, w)
    return torch.nn.functional.pixel_shuffle(by_class, 2).permute(0, 2, 3, 1)


def test_labels_of_groups_are_those_of_the_dense_output() -> None:
    """Through the kernel that reads them, window after window."""
    network, x = small_network(), random_windows(2)
    mask = x[:, 1].numpy() > 0
    with torch.no_grad():
        dense = dense_logits(network, x).softmax(-1).numpy()
        for window, person, expected in zip(x, mask, dense, strict=True):
            labels, confidence = np.zeros(person.shape, np.uint8), np.zeros(person.shape, np.float32)
            label_groups(network(window[None])[0].numpy(), person, labels, confidence)
            np.testing.assert_array_equal(labels, np.where(person, expected.argmax(-1), 0))
            np.testing.assert_allclose(confidence, np.where(person, expected.max(-1), 0), rtol=1e-4)
            assert len(np.unique(labels)) > 3


def test_enlargement_and_groups_are_torchs_own() -> None:
    x = torch.randn(2, 5, 6, 8)
    torch.testing.assert_close(_upsample(x), torch.nn.functional.interpolate(x, scale_factor=2, mode="nearest"))
    assert torch.equal(_Groups()(x), torch.nn.functional.pixel_unshuffle(x, 2))


def test_masked_outputs_are_those_of_the_shuffled_output() -> None:
    generator = torch.Generator().manual_seed(0)
    network = small_network()
    x = torch.randn(3, 3, 32, 64, generator=generator)
    labels = torch.arange(3 * 32 * 64).reshape(3, 32, 64)  # every pixel its own number, to tell them apart
    mask = torch.rand(3, 32, 64, generator=generator) < 0.4
    with torch.no_grad():
        chosen, truth, joints = masked_outputs(network, x, labels, mask)
        full = dense_logits(network, x)
        all_joints = network(x)[1]
    assert joints is not None
    torch.testing.assert_close(joints, all_joints, atol=1e-4, rtol=1e-4)
    order = truth.argsort()
    assert torch.equal(truth[order], labels[mask])
    torch.testing.assert_close(chosen[order], full[mask], atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_pixel_of_a_group(row: int, column: int) -> None:
    network = small_network()
    with torch.no_grad():
        network.head.weight.zero_()
        assert network.head.bias is not None
        network.head.bias.zero_()
        network.head.bias[CLASSES * (2 * row + column) + 7] = 1
    mask = torch.zeros(1, 32, 32, dtype=torch.bool)
    mask[0, 2 + row, column] = True
    labels = torch.zeros(1, 32, 32, dtype=torch.uint8)
    labels[mask] = 9
    chosen, truth, _ = masked_outputs(network, torch.zeros(1, 3, 32, 32), labels, mask)
    assert chosen.argmax(1).tolist() == [7]
    assert truth.tolist() == [9]


def test_empty_mask() -> None:
    empty = torch.zeros(2, 32, 32, dtype=torch.uint8)
    chosen, truth, joints = masked_outputs(small_network(), torch.zeros(2, 3, 32, 32), empty, empty.bool())
    assert chosen.shape == (0, CLASSES)
    assert joints is not None and joints.isfinite().all()
    assert truth.shape == (0,)


def test_gradient_reaches_every_parameter() -> None:
    network = small_network().train()
    labels = torch.randint(0, CLASSES, (2, 64, 64))
    chosen, truth, joints = masked_outputs(network, torch.randn(2, 3, 64, 64), labels, labels > 20)
    assert joints is not None
    (torch.nn.functional.cross_entropy(chosen, truth) + joints.square().sum()).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


def test_cells_that_show_the_person_vote_for_joints() -> None:
    network = small_network()
    with torch.no_grad():
        votes = network.joint_votes[1]
        assert isinstance(votes, torch.nn.Conv2d) and votes.bias is not None
        for parameter in votes.parameters():
            parameter.zero_()
        votes.bias.view(18, 5)[4] = torch.tensor([0, 0, 1.0, 0, -2.0])  # of joint 4: 0.3 m farther down
    x = torch.zeros(1, 3, 64, 64)
    x[0, 2] = 1  # a pixel is 2 cm
    x[0, 1, 8:16, 40:48] = 1  # one cell, of which half a row is not the person
    x[0, 1, 8, 40:44] = 0
    x[0, 0, 8:16, 40:48] = 0.4 * x[0, 1, 8:16, 40:48]  # 0.2 m behind the middle
    with torch.no_grad():
        joints = network(x)[1][0]
    expected = torch.tensor([(44 - 32) * 0.02, (12 - 32) * 0.02, 0.2, 0]).repeat(18, 1)
    expected[4] += torch.tensor([0, 0.3, 0, -2])
    torch.testing.assert_close(joints, expected)
