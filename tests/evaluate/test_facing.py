"""Bodies turned round, front for back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import MIRROR
from depthmocap.evaluate.facing import SECTORS, facing_numbers, heading_sectors, turned_round
from depthmocap.synth.body.mesh import REST_POSTURE, Body


@pytest.fixture(scope="module")
def standing(default_body: Body) -> np.ndarray:
    return default_body.pose(REST_POSTURE).joints.astype(np.float64)


def test_headings(standing: np.ndarray) -> None:
    """A body at rest faces −Y: an eye there sees sector 0; one at its right (−X) sees the right side, sector 2."""
    eyes = np.array([[0, -3, 1], [-3, 0, 1], [0, 3, 1], [3, 0, 1], [-2, -2, 2.5]], dtype=float)
    truths = np.repeat(standing[None], len(eyes), 0)
    assert heading_sectors(truths, eyes).tolist() == [0, 2, 4, 6, 1]
    # However body and eye are turned together.
    turn = Rotation.from_rotvec([0.7, -1.1, 2.0])
    turned = turn.apply(truths.reshape(-1, 3)).reshape(truths.shape)
    assert heading_sectors(turned, turn.apply(eyes)).tolist() == [0, 2, 4, 6, 1]


def test_turned_round(standing: np.ndarray) -> None:
    nobody = np.full_like(standing, np.nan)
    estimates = np.stack([standing, standing[MIRROR], standing + 0.1, nobody])
    truths = np.repeat(standing[None], 4, 0)
    assert turned_round(estimates, truths).tolist() == [False, True, False, False]
    confidences = np.full((4, 18), 0.95)
    eyes = np.tile([0.0, -3.0, 1.0], (4, 1))
    numbers = facing_numbers(estimates, truths, confidences, eyes)
    assert (numbers["turned_round"], numbers["turned_round_surely"]) == (0.25, 0.25)
    assert numbers["turned_round_by_heading"] == [0.25, *[None] * (SECTORS - 1)]
    unsure = facing_numbers(estimates, truths, confidences - 0.1, None)
    assert unsure["turned_round_surely"] == 0 and "bodies_by_heading" not in unsure
