"""Which views of a person are labelled where the machine is late."""

import numpy as np
import pytest

from depthmocap.offline.pipeline import in_turn


@pytest.mark.parametrize(
    ("seen", "labelled"), [("1111", 2), ("111", 2), ("11", 2), ("1", 1), ("0", 0), ("10111", 2), ("11111", 2)]
)
def test_every_view_has_its_turn_and_two_are_left(seen: str, labelled: int) -> None:
    masks = [np.full((2, 3), each == "1") for each in seen]
    nobody = [np.zeros((2, 3), bool) for _ in masks]
    turns = [[bool(mask.any()) for mask in in_turn(masks, nobody, turn)] for turn in range(6)]
    assert min(sum(turn) for turn in turns) == labelled
    assert np.array_equal(np.any(turns, 0), [each == "1" for each in seen])
