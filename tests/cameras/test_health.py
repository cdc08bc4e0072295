"""Pictures of working cameras pass; what only a broken one gives does not."""

import numpy as np
import pytest
from depth_scene import make_camera, render, sense

from depthmocap.cameras.health import MAX_REPEATS, Fault, HealthCheck


@pytest.fixture(scope="module")
def picture():
    depth_m, _ = render(make_camera(), [(0.0, 0.0)])
    return depth_m


def raw(depth_m, seed):
    return np.round(sense(depth_m, np.random.default_rng(seed)) * 1000).astype(np.uint16)


class Check:
    """A check of pictures whose time advances."""

    def __init__(self) -> None:
        self._check, self._now_ns = HealthCheck(make_camera()), 0

    def __call__(self, raw, step_ns=33_000_000) -> Fault:
        self._now_ns += step_ns
        return self._check(raw, self._now_ns)


def test_a_noisy_room_is_fine_for_ever(picture):
    check = Check()
    assert [check(raw(picture, seed)) for seed in range(2 * MAX_REPEATS)] == [""] * 2 * MAX_REPEATS


def test_a_person_without_a_room_is_fine():
    camera = make_camera()
    depth_m, person = render(camera, [(0.0, 0.0)])
    assert Check()(np.where(person, raw(depth_m, 0), 0).astype(np.uint16)) == ""


def test_a_repeated_picture_is_frozen_until_it_changes(picture):
    check, same = Check(), raw(picture, 0)
    assert [check(same) for _ in range(MAX_REPEATS + 3)] == [""] * MAX_REPEATS + ["frozen"] * 3
    assert check(raw(picture, 1)) == ""


def test_noise_darkness_and_another_size(picture):
    check = Check()
    shape = picture.shape
    assert check(np.random.default_rng(0).integers(0, 2**16, shape, dtype=np.uint16)) == "noise"
    assert check(np.zeros(shape, np.uint16)) == "dark"
    assert check(raw(picture, 0)[:-2]) == "size"


@pytest.mark.parametrize("step_ns", [0, -33_000_000])
def test_time_that_does_not_advance_is_no_time(picture, step_ns):
    check = Check()
    check(raw(picture, 0))
    assert [check(raw(picture, seed), step_ns) for seed in range(1, MAX_REPEATS + 2)] == [
        *[""] * (MAX_REPEATS - 1),
        "clock",
        "clock",
    ]
    assert check(raw(picture, 0)) == ""


def test_a_clock_that_is_set_back_and_frames_that_come_twice_are_no_fault_of_the_picture(picture):
    check = Check()
    steps = [33_000_000, -(10**12), *[33_000_000] * 5, 0, *[66_000_000, -33_000_000] * MAX_REPEATS]
    assert {check(raw(picture, seed), step_ns) for seed, step_ns in enumerate(steps)} == {""}
