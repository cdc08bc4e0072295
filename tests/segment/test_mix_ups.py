"""Who cannot be told apart, by where the tracks are."""

import numpy as np
import pytest

from depthmocap.segment.mix_ups import EVEN, find_mix_ups
from depthmocap.segment.person_tracks import PersonTrack


def track(number, x, area_m2=0.5):
    return PersonTrack(number, np.array([x, 0.0, 1.0]), 0.0, number=number, area_m2=area_m2)


@pytest.mark.parametrize(("apart_m", "doubt"), [(0.1, EVEN), (0.325, EVEN / 2), (0.5, 0.0), (2.0, 0.0)])
def test_the_nearer_two_are_the_less_they_are_told_apart(apart_m, doubt):
    found = find_mix_ups([track(1, 0.0), track(2, apart_m), track(3, 5.0)])
    assert set(found) == ({1, 2} if doubt else set())
    if doubt:
        assert found[1].others == (2,) and found[2].others == (1,)
        assert found[1].doubt == pytest.approx(doubt)


def test_somebody_hidden_beside_another_may_be_either():
    assert find_mix_ups([track(1, 0.0), track(2, 0.4, area_m2=0.0)])[1].doubt == EVEN
    assert not find_mix_ups([track(1, 0.0), track(2, 0.6, area_m2=0.0)])
    assert not find_mix_ups([track(1, 0.0, 0.0), track(2, 0.1, 0.0)])  # nobody is shown


def test_who_is_not_certain_to_be_a_person_is_mistaken_for_nobody():
    assert not find_mix_ups([track(1, 0.0), track(0, 0.1)])


def test_somebody_new_may_be_who_left_and_is_as_tall():
    new = track(3, 0.0)
    new.perhaps = (1, 2)
    assert find_mix_ups([new])[3].others == (1, 2) and find_mix_ups([new])[3].doubt == 0
