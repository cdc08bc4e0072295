"""Batches of windows of many sizes, and mirror images."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from depthmocap.body.regions import MIRROR, UNLABELLED  # noqa: E402
from depthmocap.body.skeleton import JOINT_INDEX  # noqa: E402
from depthmocap.synth.body.mesh import BodyModel  # noqa: E402
from depthmocap.synth.motion.postures import PosturePrior  # noqa: E402
from depthmocap.train.batches import mirror_window, pad_window, sorted_batches, training_batches  # noqa: E402
from depthmocap.train.networks import FastNet, masked_outputs  # noqa: E402
from depthmocap.train.windows import LabelledWindow, training_window  # noqa: E402


@pytest.fixture(scope="module")
def window(body_model: BodyModel) -> LabelledWindow:
    return training_window(0, 1, "easy", PosturePrior.load(), None)


def numbered(number: int, height: int, width: int) -> LabelledWindow:
    """A window that holds nothing but its number."""
    inputs = np.full((3, height, width), number, np.float32)
    return LabelledWindow(inputs, np.full((height, width), 1, np.uint8), np.full((18, 3), number, np.float32))


def test_a_wider_window_shows_the_same(window: LabelledWindow) -> None:
    height, width = window.labels.shape
    wide = pad_window(window, height + 64, width + 32)
    assert wide.inputs.shape == (3, height + 64, width + 32)
    inner = slice(32, 32 + height), slice(16, 16 + width)
    np.testing.assert_array_equal(wide.inputs[(slice(None), *inner)], window.inputs)
    np.testing.assert_array_equal(wide.labels[inner], window.labels)
    assert wide.inputs[:2].sum() == pytest.approx(window.inputs[:2].sum())
    assert np.ptp(wide.inputs[2]) == 0
    assert (wide.labels != UNLABELLED).sum() == (window.labels != UNLABELLED).sum()
    # Joints lie about the middle, so that a network which votes from nowhere else finds them at the same place.
    network = FastNet().eval()
    for parameter in network.joint_votes[-1].parameters():
        torch.nn.init.zeros_(parameter)
    with torch.no_grad():
        places = [
            masked_outputs(network, x, y, x[:, 1] > 0)[2]
            for x, y in (tuple(torch.from_numpy(each[None]) for each in w[:2]) for w in (window, wide))
        ]
    torch.testing.assert_close(places[0], places[1], atol=0.03, rtol=0)  # cells of 8 pixels lie otherwise


def test_mirror_image(window: LabelledWindow) -> None:
    other = mirror_window(window)
    person = window.labels != UNLABELLED
    np.testing.assert_array_equal(other.labels[:, ::-1][person], MIRROR[window.labels[person]])
    assert (other.labels == UNLABELLED).sum() == (~person).sum()
    np.testing.assert_array_equal(other.inputs[:, :, ::-1], window.inputs)
    left, right = JOINT_INDEX["LHand"], JOINT_INDEX["RHand"]
    np.testing.assert_array_equal(other.joints[left], window.joints[right] * [-1, 1, 1])
    for array, same in zip(mirror_window(other), window, strict=True):
        np.testing.assert_array_equal(array, same)


def test_alike_windows_come_together() -> None:
    windows = [numbered(i, 192, 64 if i % 2 else 128) for i in range(10)]
    batches = list(sorted_batches(windows, 4))
    assert [tuple(batch.labels.shape) for batch in batches] == [(4, 192, 64), (4, 192, 128), (2, 192, 128)]
    assert sorted(torch.cat([batch.joints[:, 0, 0] for batch in batches]).tolist()) == list(range(10))
    # The second batch holds one of the narrow ones, pad_window.
    assert batches[1].labels[0, 0].tolist() == [UNLABELLED] * 32 + [1] * 64 + [UNLABELLED] * 32


def test_every_window_is_shown_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("depthmocap.train.batches._MIRROR_DELAY", 20)
    few = ([numbered(4 * k + i + 1, 64, 192) for i in range(4)] for k in range(40))
    shown = torch.cat([batch.joints[:, 0, 0] for batch in training_batches(few, 4, seed=0)])
    plain, images = shown[shown > 0].tolist(), (-shown[shown < 0]).tolist()  # mirroring turns the sign
    assert len(plain) == len(set(plain)) and len(images) == len(set(images))
    assert set(images) < set(plain) == set(range(1, int(max(plain)) + 1))
    assert len(plain) - len(images) <= 20 + 1 + 32
    assert plain != sorted(plain)
