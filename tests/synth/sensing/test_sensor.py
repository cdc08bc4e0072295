"""What sensors do to exact depth, by its statistics."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.synth.render import Material
from depthmocap.synth.sensing.sensor import SensorModel, sense

CAMERA = DepthCamera("cam", 320, 240, 300.0, 300.0, 159.5, 119.5)
ALL = SensorModel(
    range_m=(0.5, 8.0),
    axial_m=(0.001, 0.0, 0.001),
    grazing=0.2,
    correlation=0.5,
    patch_px=4.0,
    wave=0.5,
    lateral_px=0.5,
    fatten_px=1.0,
    lost_px=(1.0, 1.0),
    flying=0.2,
    blend=0.2,
    multipath_m=0.03,
    reach_m=6.0,
    vignette=0.3,
    shadow_m=0.05,
    baseline_m=0.05,
    disparity_step_px=0.01,
    step_m=0.001,
)


def wall(depth_m: float) -> np.ndarray:
    return np.full((CAMERA.height, CAMERA.width), depth_m, dtype=np.float32)


def slanted(depth_m: float, angle_rad: float) -> np.ndarray:
    """A plane turned about the vertical by an angle."""
    x = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    row = depth_m / (1 - np.tan(angle_rad) * x)
    return np.tile(np.where((row > 0.3) & (row < 20), row, 0).astype(np.float32), (CAMERA.height, 1))


def plate(near_m: float = 2.0, far_m: float = 0.0) -> np.ndarray:
    """A plate in the middle before a wall, or before nothing."""
    depth = wall(far_m)
    depth[60:180, 100:220] = near_m
    return depth


def read(depth: np.ndarray, seed: int = 0, material: np.ndarray | None = None, **terms: Any) -> np.ndarray:
    return sense(depth, material, CAMERA, SensorModel(**terms), np.random.default_rng(seed))


def test_a_model_without_terms_changes_nothing() -> None:
    depth = plate(2.0, 3.3)
    np.testing.assert_array_equal(read(depth), depth)


@pytest.mark.parametrize("depth_m", [1.0, 2.0, 4.0])
def test_axial_deviation_follows_the_polynomial(depth_m: float) -> None:
    error = read(wall(depth_m), axial_m=(0.001, -0.0004, 0.0008)) - depth_m
    expected = 0.001 - 0.0004 * depth_m + 0.0008 * depth_m**2
    assert error.std() == pytest.approx(expected, rel=0.02)
    assert abs(error.mean()) < expected / 50
    # Nearly normal: as many beyond one and two deviations.
    assert np.mean(np.abs(error) > expected) == pytest.approx(0.32, abs=0.03)
    assert np.mean(np.abs(error) > 2 * expected) == pytest.approx(0.045, abs=0.015)


def test_deviation_grows_with_the_angle_of_incidence() -> None:
    middle = np.s_[:, 155:165]
    deviations = [
        (read(slanted(2.0, angle), axial_m=(0.002, 0.0, 0.0), grazing=0.5) - slanted(2.0, angle))[middle].std()
        for angle in np.deg2rad([0, 45, 60])
    ]
    np.testing.assert_allclose(deviations, 0.002 * (1 + 0.5 * np.array([0.0, 1.0, 3.0])), rtol=0.1)


def test_vignette_makes_corners_noisier_and_loses_them_first() -> None:
    error = read(wall(2.0), axial_m=(0.002, 0.0, 0.0), vignette=0.75) - 2
    assert error[:12, :12].std() == pytest.approx(0.0037, rel=0.15)
    assert error[110:130, 150:170].std() == pytest.approx(0.002, rel=0.15)
    seen = read(wall(4.0), reach_m=6.0, vignette=0.9) > 0
    assert seen[110:130, 150:170].mean() > 0.98 and seen[:8, :8].mean() < 0.2


def test_errors_within_a_patch_agree_and_far_ones_do_not() -> None:
    error = np.mean(
        [_autocorrelation(read(wall(2.0), seed, axial_m=(0.01, 0.0, 0.0), **_PATCHES)) for seed in range(3)], 0
    )
    assert error[0] == pytest.approx(1.0)
    assert error[1] > 0.7 and abs(error[30]) < 0.1
    alone = _autocorrelation(read(wall(2.0), axial_m=(0.01, 0.0, 0.0)))
    assert abs(alone[1]) < 0.02
    slow = _autocorrelation(read(wall(2.0), axial_m=(0.001, 0.0, 0.0), wave=10.0, wave_px=80.0))
    assert slow[10] > 0.8


_PATCHES: dict[str, Any] = {"correlation": 0.9, "patch_px": 8.0}


def _autocorrelation(picture: np.ndarray) -> np.ndarray:
    z = picture - picture.mean()
    return np.array([(z[:, : z.shape[1] - k] * z[:, k:]).mean() for k in range(40)]) / (z * z).mean()


@pytest.mark.parametrize("cell", [1.0, 3.7, 25.0])
def test_correlated_errors_have_the_same_deviation_everywhere(cell: float) -> None:
    terms = {"axial_m": (0.01, 0.0, 0.0), "correlation": 1.0, "patch_px": cell}
    error = np.stack([read(wall(2.0), seed, **terms) - 2 for seed in range(60)])[:, ::8, ::8]
    # Were lattice points less even than what is between them, columns would differ.
    np.testing.assert_allclose(error.std((0, 1)), 0.01, rtol=0.17)
    assert error.std() == pytest.approx(0.01, rel=0.02)


def test_disparity_is_counted_in_steps() -> None:
    ramp = np.tile(np.linspace(1, 5, CAMERA.width, dtype=np.float32), (CAMERA.height, 1))
    out = read(ramp, baseline_m=0.075, disparity_step_px=0.125)
    steps = CAMERA.fx * 0.075 / out[out > 0] / 0.125
    np.testing.assert_allclose(steps, np.rint(steps), atol=2e-3)
    # A step is z² / (f b) of an eighth of a pixel.
    levels = np.unique(out)
    coarse = np.diff(levels)[levels[1:] > 4.5].mean()
    assert coarse == pytest.approx(4.75**2 * 0.125 / (300 * 0.075), rel=0.1)
    assert np.abs(out - ramp).max() <= 0.6 * np.diff(levels).max()


def test_depth_is_counted_in_steps_from_an_offset() -> None:
    out = read(plate(2.0, 3.456), axial_m=(0.05, 0.0, 0.0), step_m=0.03, step_from_m=0.515)
    levels = (out[out > 0].astype(float) - 0.515) / 0.03
    np.testing.assert_allclose(levels, np.rint(levels), atol=1e-4)
    assert len(np.unique(out)) > 8


def test_readings_out_of_range_are_invalid() -> None:
    ramp = np.tile(np.linspace(0.2, 9, CAMERA.width, dtype=np.float32), (CAMERA.height, 1))
    out = read(ramp, range_m=(0.5, 4.5))
    np.testing.assert_array_equal(out > 0, (ramp >= 0.5) & (ramp <= 4.5))


def test_flying_pixels_lie_between_the_two_surfaces_and_crowd_at_the_near_one() -> None:
    exact = plate(2.0, 3.0)
    out = np.stack([read(exact, seed, flying=0.3) for seed in range(10)])
    between = (out > 2.001) & (out < 2.999)
    # Pixels on both sides of the plate's outline.
    silhouette = 2 * (120 + 120) * 2 - 4
    assert between.sum() / silhouette / 10 == pytest.approx(0.3, abs=0.03)
    assert np.median(out[between]) < 2.4
    assert not between[:, :58].any() and not between[:, 62:178, 102:218].any()
    alone = read(plate(2.0), flying=0.3, behind_m=0.2)
    assert alone.max() <= 2.2 and (alone > 2.001).sum() > 50


def test_pixels_are_lost_on_both_sides_of_a_silhouette() -> None:
    exact = plate(2.0, 3.0)
    out = read(exact, lost_px=(3.0, 1.0))
    far, near = (out == 0) & (exact == 3), (out == 0) & (exact == 2)
    assert 2 <= far[120].sum() / 2 <= 3 and near[120].sum() == 2
    assert (out == 0)[:50].sum() == 0
    assert not (read(exact, lost_px=(3.0, 0.0))[exact == 2] == 0).any()
    # At the picture's border nothing is known to be beyond, so nothing is lost.
    assert (read(wall(2.0), lost_px=(3.0, 3.0)) > 0).all()


def test_foreground_spreads_over_what_is_behind() -> None:
    exact = plate(2.0, 3.0)
    out = read(exact, fatten_px=2.0, patch_px=6.0)
    assert (out == 2).sum() > (exact == 2).sum() + 200
    assert (out[exact == 2] == 2).all() and set(np.unique(out)) == {2.0, 3.0}


def test_silhouettes_jitter_sideways() -> None:
    exact = plate(2.0, 3.0)
    out = read(exact, lateral_px=1.0)
    changed = out != exact
    assert changed[:, 98:103].sum() > 30 and not changed[:, 115:205][70:170].any()


@pytest.mark.parametrize("lamp_m", [0.06, -0.06])
def test_a_shadow_lies_on_the_other_side_of_the_lamp(lamp_m: float) -> None:
    out = read(plate(1.5, 3.0), shadow_m=lamp_m)
    lost = np.flatnonzero(out[120] == 0)
    width = CAMERA.fx * 0.06 * (1 / 1.5 - 1 / 3.0)
    assert len(lost) == pytest.approx(width, abs=1.5)
    assert (lost < 100).all() if lamp_m > 0 else (lost >= 220).all()


def test_dark_materials_are_lost_before_fair_ones_and_grazing_before_facing() -> None:
    material = np.full((CAMERA.height, CAMERA.width), Material.SKIN, np.uint8)
    material[:, :160] = Material.HAIR
    reflectance = tuple(0.1 if each == Material.HAIR else 1.0 for each in Material)
    terms: dict[str, Any] = {"reach_m": 8.0, "reflectance": reflectance}
    out = read(wall(2.5), 0, material, **terms)
    hair, skin = (out[:, :160] == 0).mean(), (out[:, 160:] == 0).mean()
    assert 0.3 < hair < 0.7 and skin == 0
    steep = slanted(2.0, np.deg2rad(80))[:, 155:165]
    lost = (read(slanted(2.0, np.deg2rad(80)), reach_m=3.0)[:, 155:165] == 0) & (steep > 0)
    assert lost.mean() > 0.9 and (read(wall(2.0), reach_m=4.0) > 0).mean() > 0.99
    noise = read(wall(2.0), 0, material, axial_m=(0.002, 0.0, 0.0), reflectance=reflectance) - 2
    assert noise[:, :160].std() / noise[:, 160:].std() == pytest.approx(10**0.5, rel=0.05)


def test_surfaces_that_face_each_other_read_too_far() -> None:
    # A corner seen from inside, its edge down the middle, and the same corner from outside.
    x = np.abs((np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx)
    inside = np.tile((2 / (1 + x)).astype(np.float32), (CAMERA.height, 1))
    outside = np.tile((2 / (1 - np.minimum(x, 0.5))).astype(np.float32), (CAMERA.height, 1))
    bias = read(inside, multipath_m=0.05) - inside
    assert 0.002 < bias[120, 150:170].mean() < 0.05
    assert bias.min() >= 0 and bias[120, 30:60].mean() < 0.1 * bias[120, 150:170].mean()
    assert np.abs(read(outside, multipath_m=0.05) - outside)[:, 70:250].max() < 1e-3


def test_blended_pixels_lie_between_nothing_and_the_surface() -> None:
    out = np.stack([read(plate(2.0), seed, blend=0.5) for seed in range(5)])
    rim = np.zeros(out.shape[1:], bool)
    rim[60:180, 100:220] = True
    rim[61:179, 101:219] = False
    assert (out[:, rim] < 1.999).mean() == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose(np.percentile(out[:, rim], [10, 20, 30]), [0.4, 0.8, 1.2], atol=0.12)
    assert (out[:, 61:179, 101:219] == 2).all()


def test_nothing_stays_nothing_and_the_input_is_left_alone() -> None:
    exact = plate(2.0)
    kept = exact.copy()
    for seed in range(3):
        out = sense(exact, None, CAMERA, ALL, np.random.default_rng(seed))
        assert out.dtype == np.float32 and out.shape == exact.shape
        assert not out[exact == 0].any() and (out > 0).any() and np.isfinite(out).all()
    np.testing.assert_array_equal(exact, kept)
    assert not sense(wall(0.0), None, CAMERA, ALL, np.random.default_rng(0)).any()


def test_a_seed_decides_and_what_is_drawn_next_differs() -> None:
    rng = np.random.default_rng(4)
    first, second = (sense(plate(2.0, 3.0), None, CAMERA, ALL, rng) for _ in range(2))
    again = sense(plate(2.0, 3.0), None, CAMERA, ALL, np.random.default_rng(4))
    np.testing.assert_array_equal(first, again)
    assert (first != second).mean() > 0.5


def test_bad_settings_are_told() -> None:
    for change, words in (
        ({"range_m": (3.0, 1.0)}, "range_m"),
        ({"flying": 1.5}, "flying is a share"),
        ({"lost_px": (-1.0, 0.0)}, "lost_px must not be negative"),
        ({"reflectance": (1.0,)}, "reflectance must be 9 numbers"),
        ({"patch_px": 0.0}, "patch_px"),
        ({"disparity_step_px": 0.1}, "needs a baseline_m"),
    ):
        with pytest.raises(InputError, match=words):
            dataclasses.replace(SensorModel(), **change)
    with pytest.raises(InputError, match=r"10×20 but camera 'cam' is 320×240"):
        sense(np.ones((20, 10), np.float32), None, CAMERA, ALL, np.random.default_rng(0))
