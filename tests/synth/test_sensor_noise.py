"""The sensor's noise against its own description."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from depthmocap.synth.sensor import SensorNoise, apply_noise, random_noise

QUIET = SensorNoise(0.0, 0.0, lateral_px=0.0, edge_loss=0.0, flying=0.0, holes=0.0, quantise_m=0.0)


def flat_wall(depth_m: float, height: int = 120, width: int = 160) -> np.ndarray:
    return np.full((height, width), depth_m, dtype=np.float32)


def figure() -> np.ndarray:
    """A plate before nothing, with a step of half a metre down its middle."""
    depth = np.zeros((120, 160), dtype=np.float32)
    depth[20:100, 30:80] = 2.0
    depth[20:100, 80:130] = 2.5
    return depth


def edge_band() -> np.ndarray:
    """Pixels of the figure beside the step or beside nothing."""
    band = figure() > 0
    band[21:99, 31:79] = False
    band[21:99, 81:129] = False
    return band


def noisy(depth: np.ndarray, seed: int = 0, **changes: float) -> np.ndarray:
    return apply_noise(depth, dataclasses.replace(QUIET, **changes), np.random.default_rng(seed))


def test_a_perfect_sensor_changes_nothing() -> None:
    np.testing.assert_array_equal(noisy(figure()), figure())


@pytest.mark.parametrize("distance_m", [1.0, 3.0])
@pytest.mark.parametrize("noise", [SensorNoise(), SensorNoise(axial_m=0.002, axial_per_m=0.003, quantise_m=0.0)])
def test_axial_noise_on_a_flat_wall(distance_m: float, noise: SensorNoise) -> None:
    noise = dataclasses.replace(noise, holes=0.0)
    read = apply_noise(flat_wall(distance_m), noise, np.random.default_rng(1))
    assert read.dtype == np.float32
    sigma = np.hypot(noise.axial_m + noise.axial_per_m * (distance_m - 0.5), noise.quantise_m / np.sqrt(12))
    assert read.std() == pytest.approx(sigma, rel=0.15)
    assert read.mean() == pytest.approx(distance_m, abs=4 * sigma / np.sqrt(read.size))
    assert (read > 0).all()


def test_depth_comes_in_steps() -> None:
    read = noisy(flat_wall(2.0), axial_m=0.02, quantise_m=0.01)
    np.testing.assert_allclose(read / 0.01, np.round(read / 0.01), atol=1e-3)
    assert len(np.unique(read)) > 5


def test_nothing_stays_nothing() -> None:
    """Without a lateral shift no reading appears where there was none; with one, only beside the figure."""
    read = noisy(figure(), axial_m=0.01, flying=0.3, edge_loss=0.3, quantise_m=0.001)
    assert not read[figure() == 0].any()
    shifted = noisy(figure(), lateral_px=0.4)
    assert shifted[:20].any() or shifted[100:].any()
    assert not shifted[:17].any()
    assert not shifted[103:].any()
    assert not apply_noise(np.zeros((60, 80), dtype=np.float32), SensorNoise(holes=4.0), np.random.default_rng(0)).any()


@pytest.mark.parametrize("share", [0.25, 0.6])
def test_pixels_are_lost_beside_edges(share: float) -> None:
    read = np.stack([noisy(figure(), seed, edge_loss=share) for seed in range(5)])
    lost = (read == 0) & (figure() > 0)
    assert lost[:, edge_band()].mean() == pytest.approx(share, abs=0.05)
    assert not lost[:, ~edge_band()].any()


def test_flying_pixels_float_between_the_surfaces() -> None:
    read = np.stack([noisy(figure(), seed, flying=0.3) for seed in range(5)])
    changed = np.abs(read - figure()) > 1e-4
    assert not changed[:, ~edge_band()].any()
    assert changed[:, edge_band()].mean() == pytest.approx(0.3, abs=0.05)
    step = np.zeros(figure().shape, dtype=bool)
    step[21:99, 79:81] = True
    between = read[:, step][changed[:, step]]
    assert ((between > 2.0) & (between < 2.5)).all()
    assert 2.2 < between.mean() < 2.3
    outline = edge_band() & ~step
    assert (read[:, outline] - figure()[outline] < 0.51).all()
    assert (read[:, outline] >= 2.0).all()


def test_holes() -> None:
    lost = [np.count_nonzero(noisy(flat_wall(2.0), seed, holes=3.0) == 0) for seed in range(30)]
    assert min(lost) < 200
    # Three ellipses on average, with half-axes of 2 to 6 pixels.
    assert np.mean(lost) == pytest.approx(3 * np.pi * 4 * 4, rel=0.35)


def test_noise_depends_on_the_generator_alone() -> None:
    noise = SensorNoise(holes=2.0)
    first, again, other = (apply_noise(figure(), noise, np.random.default_rng(seed)) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_the_input_is_left_alone() -> None:
    depth = figure()
    apply_noise(depth, SensorNoise(holes=3.0), np.random.default_rng(0))
    np.testing.assert_array_equal(depth, figure())


def test_random_sensors_are_of_all_kinds() -> None:
    rng = np.random.default_rng(0)
    sensors = [random_noise(rng) for _ in range(200)]
    for field in dataclasses.fields(SensorNoise):
        values = np.array([getattr(sensor, field.name) for sensor in sensors])
        assert (values >= 0).all()
        assert values.max() > 2 * values.min()
    assert {sensor.quantise_m for sensor in sensors} == {0.001, 0.01, 0.0303}
    assert [random_noise(np.random.default_rng(3)) for _ in range(2)] == [random_noise(np.random.default_rng(3))] * 2
