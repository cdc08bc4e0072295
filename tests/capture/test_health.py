"""Pictures of working cameras pass; what only a broken one gives does not."""

import numpy as np
import pytest
from depth_scene import make_camera, render, sense

from depthmocap.capture.health import EQUAL, HealthCheck


@pytest.fixture(scope="module")
def picture():
    depth_m, _ = render(make_camera(), [(0.0, 0.0)])
    return depth_m


def raw(depth_m, seed):
    return np.round(sense(depth_m, np.random.default_rng(seed)) * 1000).astype(np.uint16)


def test_a_noisy_room_is_fine_for_ever(picture):
    check = HealthCheck(make_camera())
    assert [check(raw(picture, seed)) for seed in range(2 * EQUAL)] == [""] * 2 * EQUAL


def test_a_person_without_a_room_is_fine():
    camera = make_camera()
    depth_m, person = render(camera, [(0.0, 0.0)])
    assert HealthCheck(camera)(np.where(person, raw(depth_m, 0), 0).astype(np.uint16)) == ""


def test_a_repeated_picture_is_frozen_until_it_changes(picture):
    check, same = HealthCheck(make_camera()), raw(picture, 0)
    assert [check(same) for _ in range(EQUAL + 3)] == [""] * EQUAL + ["frozen"] * 3
    assert check(raw(picture, 1)) == ""


def test_noise_darkness_and_another_size(picture):
    check = HealthCheck(make_camera())
    shape = picture.shape
    assert check(np.random.default_rng(0).integers(0, 2**16, shape, dtype=np.uint16)) == "noise"
    assert check(np.zeros(shape, np.uint16)) == "dark"
    assert check(raw(picture, 0)[:-2]) == "size"
