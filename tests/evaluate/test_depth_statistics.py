"""Statistics of depth pictures on pictures made so that they are known."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.evaluate.depth_statistics import DISTANCES_M, STEPS_M, depth_statistics


def scene(near_m: float = 2.0, far_m: float = 3.0) -> np.ndarray:
    depth = np.full((120, 160), far_m, np.float32)
    depth[30:90, 60:100] = near_m
    return depth


def test_steps_are_counted_by_their_size() -> None:
    stats = depth_statistics([scene()])
    pairs = 2 * (60 + 40)
    expected = np.zeros(len(STEPS_M) - 1)
    expected[STEPS_M.index(0.8)] = 1
    np.testing.assert_allclose(stats.step_share, expected)
    assert stats.silhouette_px == pairs - 4 + pairs
    assert stats.steps_per_px == pytest.approx(pairs / stats.silhouette_px)
    assert stats.stray_share == stats.hole_share == 0 and np.isnan(stats.gap_px).all()


@pytest.mark.parametrize("deviation_m", [0.002, 0.01])
def test_noise_is_the_deviation_from_a_slanted_plane(deviation_m: float) -> None:
    rng = np.random.default_rng(0)
    plane = np.tile(np.linspace(1.6, 2.4, 160), (120, 1))
    stats = depth_statistics([(plane + rng.normal(0, deviation_m, plane.shape)).astype(np.float32)])
    for distance in (1.5, 2.0):
        assert stats.noise_m[DISTANCES_M.index(distance)] == pytest.approx(deviation_m, rel=0.05)
    assert np.isnan(stats.noise_m[DISTANCES_M.index(3.0)])


def test_strays_holes_and_gaps() -> None:
    depth = scene()
    depth[40:60:4, 70] = 2.5  # five strays
    depth[70:73, 75:78] = 0  # a hole
    depth[30:90, 56:60] = 0  # invalid on the left of the near surface
    depth[30:90, 100:102] = 0
    stats = depth_statistics([depth])
    assert stats.stray_share == pytest.approx(5 / stats.silhouette_px)
    assert stats.hole_share == pytest.approx(9 / (depth > 0).sum())
    assert stats.gap_px == (2.0, 4.0)


def test_a_mask_leaves_the_rest_out_but_for_gaps() -> None:
    depth = scene()
    depth[30:90, 57:60] = 0
    stats = depth_statistics([depth], [depth == 2])
    assert stats.step_share.sum() == 0 and stats.gap_px[1] == 3.0
    assert stats.silhouette_px == 2 * (60 + 40) - 4


def test_pictures_of_different_sizes_go_together() -> None:
    one, other = depth_statistics([scene()]), depth_statistics([scene(), scene()[10:100, 20:130]])
    assert other.silhouette_px == 2 * one.silhouette_px


def test_bad_input_is_told() -> None:
    with pytest.raises(InputError, match="as many masks"):
        depth_statistics([])
    with pytest.raises(InputError, match="got 1 and 2"):
        depth_statistics([scene()], [scene() > 0, scene() > 0])
