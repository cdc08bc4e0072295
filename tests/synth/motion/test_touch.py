"""Hands laid on the body."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.body.regions import MIRROR, REGION
from depthmocap.geometry.transforms import rotation_between
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX, turn_posture, world_rotations
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.postures import PosturePrior, Variation
from depthmocap.synth.motion.touch import _crosses_trunk, default_body_surface, hands_on_body

ARMS = [i for i, name in enumerate(POSTURE_BONES) if name.split(".")[0] in ("upper_arm", "forearm", "hand")]


def touched(count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [hands_on_body(turn_posture(REST_POSTURE, rng.uniform(-3, 3)), rng) for _ in range(count)]


def test_only_arms_move_and_stay_within_limits() -> None:
    prior, rng = PosturePrior.load(), np.random.default_rng(1)
    moved = 0
    for _ in range(40):
        posture, _ = prior.sample(rng)
        found = hands_on_body(posture, rng)
        others = np.setdiff1d(np.arange(len(POSTURE_BONES)), ARMS)
        np.testing.assert_array_equal(found[others], posture[others])
        changed = np.abs(found - posture).max() > 1e-6
        moved += changed
        assert not changed or within_limits(found[None])[0]
    assert moved > 30


def test_a_hand_comes_to_lie_on_the_skin(default_body: Body) -> None:
    model = default_body.model
    bones = np.array([bone.rpartition(".")[0] or bone for bone in model.bone_names])[model.skin_indices[:, 0]]
    arm = np.array([name.startswith(("upperarm", "lowerarm", "wrist", "finger", "metacarpal")) for name in bones])
    sides = np.array([bone[-1] for bone in model.bone_names])[model.skin_indices[:, 0]]
    palms = {side: model.skin_indices[:, 0] == model.bone_names.index(f"metacarpal3.{side}") for side in "RL"}
    near = []
    for posture in touched(30):
        posed = default_body.pose(posture)
        for side, palm in palms.items():
            # From the middle of the palm to what is not the same arm.
            others = posed.vertices[~arm | (sides != side)]
            near.append(np.linalg.norm(others - posed.vertices[palm].mean(0), axis=1).min())
    rest = default_body.pose(REST_POSTURE)
    far = np.linalg.norm(rest.vertices[~arm] - rest.vertices[palms["L"]].mean(0), axis=1)
    assert far.min() > 0.18
    # A hand at least a body; many bodies both.
    assert (np.array(near).reshape(-1, 2).min(1) < 0.12).mean() > 0.9
    assert (np.array(near).reshape(-1, 2).max(1) < 0.12).mean() > 0.3


def test_hands_that_nobody_sees_are_behind_as_often_as_before_the_body(default_body: Body) -> None:
    wrists = [default_body.model.bone_names.index(f"wrist.{side}") for side in "RL"]
    pelvis, neck = (default_body.model.bone_names.index(bone) for bone in ("root", "neck01"))
    counts = {"behind": 0, "before": 0}
    for posture in touched(120, seed=5):
        moved, trunk = default_body.bone_transforms(posture), world_rotations(posture)[POSTURE_INDEX["spine_up"]]
        hands = moved.heads[wrists]
        aside, back, _ = ((hands - (moved.heads[pelvis] + moved.heads[neck]) / 2) @ trunk).T
        if (np.abs(aside) < 0.25).all():  # within the trunk's width
            counts["behind"] += int((back > 0.04).all())
            counts["before"] += int((back < -0.05).all())
    assert min(counts.values()) > 12
    assert 0.5 < counts["behind"] / counts["before"] < 2


def test_elbows_stay_joined(default_body: Body) -> None:
    rest = default_body.pose(REST_POSTURE).joints
    for posture in touched(10):
        joints = default_body.pose(posture).joints
        for a, b in ((12, 13), (13, 14), (15, 16), (16, 17)):
            np.testing.assert_allclose(
                np.linalg.norm(joints[a] - joints[b]), np.linalg.norm(rest[a] - rest[b]), atol=1e-6
            )


def test_arms_do_not_pass_through_the_trunk() -> None:
    ends = np.array([[0.0, 0, 0], [0, 0, 0.5]])
    # The spine is nearer to the back than to the belly.
    for y, inside in ((-0.15, False), (-0.08, True), (0.04, True), (0.08, False)):
        assert _crosses_trunk(np.array([[0.0, y, 0.2]]), ends, np.eye(3)) == inside
    assert not _crosses_trunk(np.array([[0.0, 0, 0.7]]), ends, np.eye(3))  # above it
    # Turned by a quarter, what lay behind the narrow side lies in the wide one.
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert _crosses_trunk(np.array([[0.0, 0.12, 0.2]]), ends, turned)


def test_swings_turn_one_direction_into_another() -> None:
    rng = np.random.default_rng(0)
    for a, b in [*rng.normal(size=(20, 2, 3)), (np.array([1.0, 0, 0]), np.array([-2.0, 0, 0]))]:
        turn = rotation_between(a, b)
        np.testing.assert_allclose(turn @ a / np.linalg.norm(a), b / np.linalg.norm(b), atol=1e-6)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1)


def test_the_left_hands_places_are_the_rights_mirrored() -> None:
    for name, other in (("thigh R", "thigh L"), ("upper arm L", "upper arm R"), ("neck front", "neck front")):
        assert MIRROR[REGION[name]] == REGION[other]
    skin = default_body_surface()
    regions = np.asarray(skin.body.model.face_regions)
    for right, left in zip(skin.faces["R"], skin.faces["L"], strict=True):
        assert set(MIRROR[regions[right]]) == set(regions[left])
    assert REGION["thigh R"] in regions[skin.faces["R"][0]] and REGION["thigh R"] not in regions[skin.faces["L"][0]]


def test_who_walks_and_runs_does_not() -> None:
    rng = np.random.default_rng(0)
    prior = PosturePrior.load(simple=True, variation=Variation(touch=1.0))
    plain = PosturePrior.load(simple=True)
    for _ in range(5):
        seed = int(rng.integers(1000))
        np.testing.assert_array_equal(
            prior.sample(np.random.default_rng(seed))[0], plain.sample(np.random.default_rng(seed))[0]
        )
