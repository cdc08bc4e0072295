import numpy as np

from depthmocap.segment.background import FAR_M, NEEDS, Background

SHAPE = (12, 16)
NOBODY = np.zeros(SHAPE, np.bool_)


def looks(background: Background, depth_m, count: int, people=NOBODY, start_s: float = 0.0) -> None:
    for i in range(count):
        background.look(np.asarray(depth_m, np.float32), people, round((start_s + i * 0.2) * 1e9))


def full(depth_m: float) -> np.ndarray:
    return np.full(SHAPE, depth_m, np.float32)


def test_what_stays_becomes_the_background_and_people_do_not():
    background = Background(SHAPE)
    assert background.learning
    assert (background.limit_m > FAR_M).all()
    person = NOBODY.copy()
    person[:, :4] = True
    looks(background, full(3.0), NEEDS[0] - 1, person)
    assert background.learning
    looks(background, full(3.0), 1, person)
    assert not background.learning
    assert (background.limit_m[:, :4] > FAR_M).all()
    np.testing.assert_allclose(background.background_m[:, 10:], 3.0)
    assert (background.limit_m[:, 10:] < 2.97).all()


def test_a_known_background_drifts_slowly_and_by_jumps_only_after_a_while():
    background = Background(SHAPE, full(3.0))
    assert not background.learning
    looks(background, full(3.02), 200)
    np.testing.assert_allclose(background.background_m, 3.02, atol=0.002)
    looks(background, full(3.5), NEEDS[1] - 1)  # something was taken away
    np.testing.assert_allclose(background.background_m, 3.02, atol=0.002)
    looks(background, full(3.5), 1)
    np.testing.assert_allclose(background.background_m, 3.5)
    looks(background, full(2.0), NEEDS[2] - 1)  # something was put there
    np.testing.assert_allclose(background.background_m, 3.5)
    looks(background, full(2.0), 1)
    np.testing.assert_allclose(background.background_m, 2.0)


def test_passing_by_and_lost_pixels_teach_nothing():
    background = Background(SHAPE, full(3.0))
    for i in range(60):  # somebody walks by at changing depth, and half of the frames are lost
        looks(background, full(0.0 if i % 2 else 1.0 + 0.3 * (i % 5)), 1, start_s=i * 0.2)
    np.testing.assert_allclose(background.background_m, 3.0)


def test_where_nothing_is_seen_the_room_is_out_of_range():
    background = Background(SHAPE)
    looks(background, full(0.0), NEEDS[0])
    assert (background.limit_m == FAR_M).all()
    assert (Background(SHAPE, full(0.0)).limit_m == FAR_M).all()


def test_looks_are_apart_in_time():
    background = Background(SHAPE, full(3.0))
    assert background.is_due(0)
    background.look(full(3.0), NOBODY, 10**9)
    assert not background.is_due(10**9 + 10**8)
    assert background.is_due(10**9 + 2 * 10**8)
    assert background.is_due(0)  # time that went back
