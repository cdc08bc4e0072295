"""Postures that no recording shows."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.body.bones import POSTURE_INDEX, world_rotations
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.motion.extreme_postures import (
    FAMILIES,
    Family,
    capsule_points,
    extreme_posture,
    rest_on_floor,
    self_intersects,
)
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.postures import TRAINING_VARIATION, PosturePrior, Variation

PRIOR = PosturePrior.load()


def drawn(count: int, family: Family | None = None) -> np.ndarray:
    rng = np.random.default_rng(4)
    return np.stack([extreme_posture(PRIOR.sample(rng)[0], rng, family) for _ in range(count)])


def test_within_limits_and_not_through_themselves() -> None:
    postures = drawn(60)
    good = within_limits(postures) & [not self_intersects(posture) for posture in postures]
    assert good.mean() > 0.9  # what cannot be drawn in a few tries stays as it was given


def test_limbs_reach_where_recordings_do_not() -> None:
    """Thighs lifted above the level and far apart, backs bent backwards, a head below the hips."""
    bent = world_rotations(drawn(150))
    pelvis = bent[:, POSTURE_INDEX["pelvis"]]
    thighs = np.stack([-bent[:, POSTURE_INDEX[f"thigh.{side}"]] @ [0, 0, 1] for side in "RL"], 1)
    lifted = np.einsum("nji,nsj->nsi", pelvis, thighs)  # in the pelvis's frame
    assert (lifted[..., 2] > 0.2).mean() > 0.05
    assert (np.abs(lifted[..., 0]) > 0.8).mean() > 0.03
    assert (pelvis[:, 2, 2] < -0.5).mean() > 0.05


def test_elbows_and_knees_bend_the_right_way() -> None:
    for posture in drawn(40):
        for side in "RL":
            assert posture[POSTURE_INDEX[f"shin.{side}"], 0] >= -np.deg2rad(20)


def test_who_lies_on_the_floor_stays_lying() -> None:
    """The centre of mass is above what touches the floor; a push to the side lifts it."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        lying = rest_on_floor(PRIOR.sample(rng)[0], rng)
        points = capsule_points(lying)
        lowest = points[..., 2].min()
        touching = points[points[..., 2] < lowest + 0.12]
        middle = points.mean((0, 1))
        low, high = touching[:, :2].min(0) - 0.15, touching[:, :2].max(0) + 0.15
        assert (middle[:2] > low).all() and (middle[:2] < high).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_families(default_body: Body, family: Family) -> None:
    heights = []
    for posture in drawn(12, family):
        body = default_body.pose(posture)
        heights.append(body.joints[JOINT_INDEX["Hip"], 2] - body.vertices[:, 2].min())
    # Half of a leg and more under the hips of who stands; next to nothing under those who lie.
    assert (np.median(heights) < 0.45) == (family == "floor")


def test_the_share_of_training_and_of_a_test_set() -> None:
    rng = np.random.default_rng(0)
    kinds = [TRAINING_VARIATION.draw(rng) for _ in range(400)]
    assert np.mean([kind.beyond > 0 for kind in kinds]) == pytest.approx(TRAINING_VARIATION.beyond, abs=0.06)
    assert np.mean([kind.limb > 0 for kind in kinds]) == pytest.approx(0.3, abs=0.06)
    assert Variation(beyond=1.0, family="floor").of(simple=True).beyond == 0  # who walks goes on walking
    np.testing.assert_array_equal(REST_POSTURE, 0)
