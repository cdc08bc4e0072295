"""Which cameras are left out where the machine is late."""

import pytest

from depthmocap.offline.pipeline import out_of_turn


@pytest.mark.parametrize(
    ("cameras", "seen", "left_out"),
    [("abcd", [], 2), ("abc", [], 1), ("ab", [], 0), ("a", ["a"], 0), ("abcde", ["abcde"], 2), ("", [], 0)],
)
def test_every_camera_has_its_turn(cameras: str, seen: list[str], left_out: int) -> None:
    turns = [out_of_turn(list(cameras), [list(each) for each in seen], turn) for turn in range(6)]
    assert min(len(turn) for turn in turns) == left_out
    assert set.intersection(*turns) == set()


@pytest.mark.parametrize("seen", [["ac", "bd"], ["ac"], ["abc", "d"], ["bcd", "ab"], ["abcd"], ["xa"], [""]])
def test_two_that_see_somebody_stay(seen: list[str]) -> None:
    for turn in range(8):
        stay = set("abcd") - out_of_turn(list("abcd"), [list(each) for each in seen], turn)
        for each in seen:
            assert len(stay & set(each)) >= min(2, len(set(each) & set("abcd")))
