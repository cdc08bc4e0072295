"""The tables of regions and joints."""

from __future__ import annotations

import numpy as np

from depthmocap.body import skeleton
from depthmocap.body.regions import (
    DISPLAY_COLOURS,
    MIRROR,
    REGION,
    REGION_COUNT,
    REGION_NAMES,
    TURNED,
    UBC3V_COLOURS,
)
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX, POSTURE_PARENTS


def test_there_are_43_regions_and_the_background() -> None:
    assert REGION_COUNT == 43
    assert len(REGION_NAMES) == len(set(REGION_NAMES)) == 44
    assert REGION["background"] == 0
    assert [REGION[name] for name in REGION_NAMES] == list(range(44))
    # A few of UBC3V's own numbers.
    assert (REGION["chest R"], REGION["hand L"], REGION["forehead"], REGION["face L"]) == (1, 30, 39, 43)


def test_colours_tell_regions_apart() -> None:
    for colours in (UBC3V_COLOURS, DISPLAY_COLOURS):
        assert colours.shape == (44, 3)
        assert len(np.unique(colours, axis=0)) == 44
    # UBC3V's colours are matched within ±2 a channel.
    ubc3v = UBC3V_COLOURS.astype(int)
    apart = np.abs(ubc3v[:, None] - ubc3v[None]).max(2) + 255 * np.eye(44, dtype=int)
    assert apart.min() > 4
    assert tuple(UBC3V_COLOURS[REGION["hair L"]]) == (0, 0, 0)


def test_mirror_exchanges_sides() -> None:
    np.testing.assert_array_equal(MIRROR[MIRROR], np.arange(44))
    unpaired = {REGION_NAMES[i] for i in range(44) if MIRROR[i] == i}
    assert unpaired == {"background", "neck front", "nape", "forehead"}
    for i, name in enumerate(REGION_NAMES):
        if name not in unpaired:
            assert {name[-2:], REGION_NAMES[MIRROR[i]][-2:]} == {" R", " L"}
            assert name[:-2] == REGION_NAMES[MIRROR[i]][:-2]


def test_turning_round_exchanges_front_and_back() -> None:
    np.testing.assert_array_equal(TURNED[TURNED], np.arange(44))
    for name, turned in (
        ("chest R", "upper back L"), ("belly L", "lower back R"), ("face R", "hair L"), ("neck front", "nape"),
        ("shoulder back L", "shoulder front R"), ("hand R", "hand L"), ("forehead", "forehead"),
    ):  # fmt: skip
        assert REGION_NAMES[TURNED[REGION[name]]] == turned


def test_joint_tables() -> None:
    assert len(skeleton.JOINTS) == len(set(skeleton.JOINTS)) == 18
    np.testing.assert_array_equal(skeleton.MIRROR[skeleton.MIRROR], np.arange(18))
    for i, name in enumerate(skeleton.JOINTS):
        partner = skeleton.JOINTS[skeleton.MIRROR[i]]
        assert partner == ("L" + name[1:] if name.startswith("R") else "R" + name[1:] if name[0] == "L" else name)
    # One tree over all joints, parents first.
    assert set(skeleton.PARENTS) == set(skeleton.JOINTS)
    reached = {"Hip"}
    for parent, child in skeleton.BONES:
        assert parent in reached
        reached.add(child)
    assert reached == set(skeleton.JOINTS)
    # The tree is its own mirror image.
    for child, parent in skeleton.PARENTS.items():
        mirrored = {name: skeleton.JOINTS[skeleton.MIRROR[skeleton.JOINT_INDEX[name]]] for name in skeleton.JOINTS}
        assert skeleton.PARENTS[mirrored[child]] == (mirrored[parent] if parent else None)


def test_posture_bones_come_after_their_parents() -> None:
    assert len(POSTURE_BONES) == 20
    assert POSTURE_PARENTS[POSTURE_INDEX["pelvis"]] == -1
    assert all(parent < i for i, parent in enumerate(POSTURE_PARENTS))
