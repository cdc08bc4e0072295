"""Cameras that agree with each other."""

from __future__ import annotations

import pytest

from depthmocap.geometry import largest_group


@pytest.mark.parametrize(
    ("links", "group"),
    [
        ([("a", "b"), ("c", "b")], ["a", "b", "c"]),  # by way of another, in the order given
        ([("d", "c"), ("d", "x")], ["c", "d"]),  # x is no camera of these
        ([("a", "b"), ("c", "d")], []),  # neither is larger
        ([], []),
    ],
)
def test_the_largest_group(links: list[tuple[str, str]], group: list[str]) -> None:
    assert largest_group(["a", "b", "c", "d"], links) == group


def test_a_camera_alone() -> None:
    assert largest_group(range(1), []) == [0] and largest_group([], []) == []
