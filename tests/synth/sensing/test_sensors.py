"""The presets of real sensors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from depthmocap.datasets.ubc3v import KINECT2, decode_depth, encode_depth
from depthmocap.errors import InputError
from depthmocap.synth.render import Material
from depthmocap.synth.sensing.sensor import SensorModel, sense
from depthmocap.synth.sensing.sensors import HELD_OUT_SENSOR, SENSORS, find_sensor, random_model, random_preset


def field_of_view(size: int, focal: float) -> float:
    return float(np.rad2deg(2 * np.arctan(size / 2 / focal)))


@pytest.mark.parametrize(
    ("name", "degrees"),
    [
        ("kinect1", (57, 43)),
        ("kinect2", (70.6, 60)),
        ("itop", (58, 45)),
        ("realsense-d435", (87, 58)),
        ("realsense-d455", (87, 58)),
    ],
)
def test_fields_of_view_are_near_the_data_sheets(name: str, degrees: tuple[float, float]) -> None:
    preset = SENSORS[name]
    found = field_of_view(preset.width, preset.fx), field_of_view(preset.height, preset.fy)
    np.testing.assert_allclose(found, degrees, atol=3.5)


def test_the_modes_of_one_sensor_have_the_same_rays() -> None:
    for name in ("azure-nfov", "azure-wfov"):
        full, binned = SENSORS[name], SENSORS[f"{name}-binned"]
        assert (full.width, full.height) == (2 * binned.width, 2 * binned.height)
        np.testing.assert_allclose(full.fx, 2 * binned.fx)
        assert binned.range_m[1] > full.range_m[1]  # summed pixels see farther


def test_ubc3v_is_the_pinhole_of_the_data_set_and_counts_as_its_pictures_do() -> None:
    preset = find_sensor("ubc3v")
    camera = preset.camera("Cam1", np.eye(4))
    for field in ("width", "height", "fx", "fy", "cx", "cy"):
        assert getattr(camera, field) == getattr(KINECT2, field)
    exact = np.full((424, 512), 0, np.float32)
    exact[:, 100:400] = np.linspace(0.6, 8.2, 300)
    out = sense(exact, None, camera, preset.model, np.random.default_rng(0))
    stored = encode_depth(exact, exact > 0)
    assert len(np.unique(out)) <= 257
    np.testing.assert_allclose(out[:, 100:400], decode_depth(stored)[0][:, 100:400], atol=1e-4)


@pytest.mark.parametrize("name", list(SENSORS))
def test_every_preset_reads_a_wall_at_two_metres(name: str) -> None:
    preset = SENSORS[name]
    camera = preset.camera("cam", np.eye(4))
    exact = np.full((camera.height, camera.width), 2.0, np.float32)
    material = np.full(exact.shape, Material.CLOTH, np.uint8)
    out = sense(exact, material, camera, preset.model, np.random.default_rng(1))
    middle = out[camera.height // 3 : -camera.height // 3, camera.width // 3 : -camera.width // 3]
    assert (middle > 0).mean() > 0.98
    # Specified errors are within 2 % of the distance.
    assert abs(middle[middle > 0].mean() - 2) < 0.02 and middle[middle > 0].std() < 0.04


def test_a_longer_baseline_helps_stereo_and_time_of_flight_is_quieter_at_a_distance() -> None:
    def deviation(name: str) -> float:
        camera = SENSORS[name].camera("cam", np.eye(4))
        exact = np.full((camera.height, camera.width), 3.5, np.float32)
        material = np.full(exact.shape, Material.CLOTH, np.uint8)
        out = sense(exact, material, camera, SENSORS[name].model, np.random.default_rng(0))
        middle = out[camera.height // 3 : -camera.height // 3, camera.width // 3 : -camera.width // 3]
        return float(middle[middle > 0].std())

    assert deviation("realsense-d435") > deviation("realsense-d455") > deviation("kinect2") > deviation("azure-nfov")


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="no sensor 'kinect3': expected one of kinect1, kinect2, ubc3v"):
        find_sensor("kinect3")


def test_the_held_out_sensor_is_never_drawn_for_training() -> None:
    rng = np.random.default_rng(0)
    drawn = {id(random_preset(rng)) for _ in range(500)}
    held_out = SENSORS[HELD_OUT_SENSOR]
    assert id(held_out) not in drawn
    assert drawn == {id(preset) for name, preset in SENSORS.items() if name != HELD_OUT_SENSOR}
    assert random_preset(rng, held_out=True) is held_out


def test_random_models_spread_around_the_preset() -> None:
    rng = np.random.default_rng(0)
    preset = SENSORS["kinect2"]
    models = [random_model(rng, preset) for _ in range(300)]
    for name in ("grazing", "lateral_px", "flying", "multipath_m", "reach_m", "hole_spread"):
        values = np.array([getattr(model, name) for model in models])
        assert (values < getattr(preset.model, name)).mean() > 0.2 and (values > getattr(preset.model, name)).any()
    strengths = np.array([model.axial_m[0] for model in models]) / preset.model.axial_m[0]
    assert 0.3 < strengths.min() < 0.4 and 2.6 < strengths.max() < 3.01
    assert 0.1 < np.mean([model.blend > 0 for model in models]) < 0.3
    assert {model.range_m for model in models} == {preset.model.range_m}
    again = [random_model(np.random.default_rng(5), preset) for _ in range(2)]
    assert again[0] == again[1]


def test_random_models_of_ubc3v_are_exact_half_of_the_time_and_always_in_its_steps() -> None:
    rng = np.random.default_rng(0)
    models = [random_model(rng, SENSORS["ubc3v"]) for _ in range(200)]
    exact = np.mean([model == SENSORS["ubc3v"].model for model in models])
    assert 0.4 < exact < 0.6
    assert {(model.step_m, model.step_from_m) for model in models} == {(7.5 / 255 * 1.03, 0.515)}


def test_random_models_of_all_presets_can_be_sensed() -> None:
    rng = np.random.default_rng(2)
    for preset in SENSORS.values():
        small = dataclasses.replace(preset, width=64, height=48, cx=31.5, cy=23.5)
        model: SensorModel = random_model(rng, preset)
        exact = np.zeros((48, 64), np.float32)
        exact[10:40, 20:50] = 1.8
        out = sense(exact, np.full(exact.shape, Material.SKIN, np.uint8), small.camera("c", np.eye(4)), model, rng)
        assert not out[exact == 0].any()
        assert (out[15:35, 25:45] > 0).mean() > 0.5
