import numpy as np
import pytest

from depthmocap.segment.background import FAR_M, UPDATES_NEEDED, BackgroundModel, foreground_limit

SHAPE = (12, 16)
NOBODY = np.zeros(SHAPE, np.bool_)


def updates(background: BackgroundModel, depth_m, count: int, people=NOBODY, start_s: float = 0.0) -> None:
    for i in range(count):
        background.update(np.asarray(depth_m, np.float32), people, round((start_s + i * 0.2) * 1e9))


def full(depth_m: float) -> np.ndarray:
    return np.full(SHAPE, depth_m, np.float32)


def test_what_stays_becomes_the_background_and_people_do_not():
    background = BackgroundModel(SHAPE)
    assert background.learning
    assert (background.limit_m > FAR_M).all()
    person = NOBODY.copy()
    person[:, :4] = True
    updates(background, full(3.0), UPDATES_NEEDED[0] - 1, person)
    assert background.learning
    updates(background, full(3.0), 1, person)
    assert not background.learning
    assert (background.limit_m[:, :4] > FAR_M).all()
    np.testing.assert_allclose(background.background_m[:, 10:], 3.0)
    assert (background.limit_m[:, 10:] < 2.97).all()


def test_a_known_background_drifts_slowly_and_by_jumps_only_after_a_while():
    background = BackgroundModel(SHAPE, full(3.0))
    assert not background.learning
    updates(background, full(3.02), 200)
    np.testing.assert_allclose(background.background_m, 3.02, atol=0.002)
    updates(background, full(3.5), UPDATES_NEEDED[1] - 1)  # something was taken away
    np.testing.assert_allclose(background.background_m, 3.02, atol=0.002)
    updates(background, full(3.5), 1)
    np.testing.assert_allclose(background.background_m, 3.5)
    updates(background, full(2.0), UPDATES_NEEDED[2] - 1)  # something was put there
    np.testing.assert_allclose(background.background_m, 3.5)
    updates(background, full(2.0), 1)
    np.testing.assert_allclose(background.background_m, 2.0)


def test_people_passing_by_and_lost_pixels_do_not_change_the_background():
    background = BackgroundModel(SHAPE, full(3.0))
    for i in range(60):  # somebody walks by at changing depth, and half of the frames are lost
        updates(background, full(0.0 if i % 2 else 1.0 + 0.3 * (i % 5)), 1, start_s=i * 0.2)
    np.testing.assert_allclose(background.background_m, 3.0)


def test_where_nothing_is_seen_the_room_is_out_of_range():
    background = BackgroundModel(SHAPE)
    updates(background, full(0.0), UPDATES_NEEDED[0])
    assert (background.limit_m == FAR_M).all()
    assert (BackgroundModel(SHAPE, full(0.0)).limit_m == FAR_M).all()


def test_updates_are_apart_in_time():
    background = BackgroundModel(SHAPE, full(3.0))
    assert background.is_due(0)
    background.update(full(3.0), NOBODY, 10**9)
    assert not background.is_due(10**9 + 10**8)
    assert background.is_due(10**9 + 2 * 10**8)
    assert background.is_due(0)  # time that went back


def test_the_limit_is_nearer_than_the_scene_by_a_margin_and_pinholes_take_the_nearest_depth_around_them():
    background_m = full(3.0)
    background_m[4:, 3] = 2.0
    background_m[6, 5], background_m[:3, 8:] = 0, 0
    limit_m = foreground_limit(background_m)
    near, far = 2.0 - 0.04 - 0.004 * 4, 3.0 - 0.04 - 0.004 * 9
    np.testing.assert_allclose(limit_m[8:, [3, 4]], [[near, far]] * 4, rtol=1e-6)
    assert limit_m[6, 5] == pytest.approx(near)
    assert (limit_m[0, 10:] == FAR_M).all()
    assert limit_m[2, 12] == pytest.approx(far)
    learnt = BackgroundModel(SHAPE)
    updates(learnt, background_m, UPDATES_NEEDED[0])
    np.testing.assert_array_equal(learnt.limit_m, limit_m)
