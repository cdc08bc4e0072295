"""The network's shape, and the loss's way round shuffling its output."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from depthmocap.classify.networks import CLASSES, NETWORKS, FastNet, masked_outputs  # noqa: E402


def small_network() -> FastNet:
    torch.manual_seed(0)
    return FastNet((8, 12, 16, 16, 16), (0, 1, 0, 1, 0)).eval()


@pytest.mark.parametrize("size", [64, 192])
def test_output_shape(size: int) -> None:
    with torch.no_grad():
        assert small_network()(torch.zeros(2, 3, size, size))[0].shape == (2, 4 * CLASSES, size // 2, size // 2)


def test_default_network_fits_its_name() -> None:
    network = NETWORKS["fast"]()
    parameters = sum(parameter.numel() for parameter in network.parameters())
    assert 1e6 < parameters < 3e6
    with torch.no_grad():
        logits, joints = network.eval()(torch.zeros(1, 3, 64, 64))
    assert (logits.shape, joints.shape) == ((1, 4 * CLASSES, 32, 32), (1, 18, 4))


def test_pictures_of_a_batch_do_not_mix() -> None:
    network = small_network()
    x = torch.randn(3, 3, 64, 64)
    with torch.no_grad():
        for together, alone in zip(network(x), network(x[1:2]), strict=True):
            torch.testing.assert_close(together[1:2], alone, atol=1e-4, rtol=1e-4)


def shuffled(logits: torch.Tensor) -> torch.Tensor:
    """Logits (n, h, w, 44) of all pixels. Channel 44·k + c is class c of pixel k; pixel_shuffle wants all k of a class
    together."""
    n, _, h, w = logits.shape
    by_class = logits.reshape(n, 4, CLASSES, h, w).transpose(1, 2).reshape(n, CLASSES * 4, h, w)
    return torch.nn.functional.pixel_shuffle(by_class, 2).permute(0, 2, 3, 1)


def test_masked_outputs_are_those_of_the_shuffled_output() -> None:
    generator = torch.Generator().manual_seed(0)
    network = small_network()
    x = torch.randn(3, 3, 32, 64, generator=generator)
    labels = torch.arange(3 * 32 * 64).reshape(3, 32, 64)  # every pixel its own number, to tell them apart
    mask = torch.rand(3, 32, 64, generator=generator) < 0.4
    with torch.no_grad():
        chosen, truth, joints = masked_outputs(network, x, labels, mask)
        logits, all_joints = network(x)
        full = shuffled(logits)
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
        for parameter in network.joint_votes[1].parameters():
            parameter.zero_()
        network.joint_votes[1].bias.view(18, 5)[4] = torch.tensor(
            [0, 0, 1.0, 0, -2.0]
        )  # of joint 4: 0.3 m farther down
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
