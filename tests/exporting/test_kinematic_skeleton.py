"""The skeleton of constant bones: lengths, hinges, limits and feet, offline and live."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_export import moving_skeleton

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS, PARENTS
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.bone_rotations import REST, joint_positions, rest_offsets
from depthmocap.exporting.constant_bones import with_constant_bones
from depthmocap.exporting.foot_contacts import LEGS, ContactSettings, hold_feet, reach_ankles, standing_feet
from depthmocap.exporting.joint_limits import beyond_limits, within_limits
from depthmocap.exporting.timeline import Timeline
from depthmocap.frames import Pose
from depthmocap.geometry import z_up_from
from depthmocap.streaming import running_skeleton
from depthmocap.streaming.running_skeleton import RunningSkeleton

FRAME_S = 1 / 30
FEET = [JOINT_INDEX["RFoot"], JOINT_INDEX["LFoot"]]
ADULT = rest_offsets(np.full((1, 18, 3), np.nan))


def lengths(joints: np.ndarray) -> np.ndarray:
    ends = np.array([[JOINT_INDEX[name] for name in bone] for bone in BONES])
    return np.linalg.norm(joints[:, ends[:, 1]] - joints[:, ends[:, 0]], axis=-1)


def y_up(frames: int, seed: int) -> np.ndarray:
    return moving_skeleton(frames, np.random.default_rng(seed), 0.4) @ z_up_from("y")


def timeline_of(joints: np.ndarray) -> Timeline:
    return Timeline(np.arange(len(joints)) * FRAME_S, joints, FRAME_S)


def posed(**turns: Rotation) -> tuple[np.ndarray, np.ndarray]:
    """Joints and world rotations of an adult of whom some bones are turned in their parents' frames."""
    local = np.tile(np.eye(3), (1, 18, 1, 1))
    for joint, turn in turns.items():
        local[0, JOINT_INDEX[joint]] = turn.as_matrix()
    world = local.copy()
    for joint, parent in PARENTS.items():
        if parent:
            world[:, JOINT_INDEX[joint]] = world[:, JOINT_INDEX[parent]] @ local[:, JOINT_INDEX[joint]]
    return joint_positions(local, np.array([[0.0, 0.95, 0.0]]), ADULT), world


def test_bones_get_their_lengths_with_joints_moved_little() -> None:
    joints = y_up(30, 0)
    np.testing.assert_allclose(with_constant_bones(joints, rest_offsets(joints)), joints, atol=1e-6)
    noisy = joints + np.random.default_rng(1).normal(0, 0.01, joints.shape)
    noisy[4, JOINT_INDEX["RHand"]] = np.nan
    steady = with_constant_bones(noisy, rest_offsets(joints))
    known = ~np.isnan(noisy).any(-1)
    np.testing.assert_array_equal(np.isnan(steady).any(-1), ~known)
    assert np.nanmax(np.abs(lengths(steady) - lengths(joints))) < 1e-3
    error, before = (np.linalg.norm(each - joints, axis=-1)[known].mean() for each in (steady, noisy))
    assert error < 0.9 * before


def test_joints_rotations_and_lengths_agree() -> None:
    joints = y_up(30, 2) + np.random.default_rng(3).normal(0, 0.008, (30, 18, 3))
    motion = solve_body(timeline_of(joints))
    positions, world = motion.positions(), motion.world_rotations()
    np.testing.assert_allclose(lengths(positions), lengths(positions)[[0]].repeat(30, 0), atol=1e-9)
    for parent, child in BONES:
        bone = positions[:, JOINT_INDEX[child]] - positions[:, JOINT_INDEX[parent]]
        turned = world[:, JOINT_INDEX[parent]] @ motion.offsets[JOINT_INDEX[child]]
        np.testing.assert_allclose(turned, bone, atol=1e-9)
    given = solve_body(timeline_of(joints), offsets=1.1 * motion.offsets)
    np.testing.assert_allclose(lengths(given.positions()), 1.1 * lengths(positions), atol=1e-9)


def test_bent_limbs_tell_their_twist() -> None:
    bent = {"RElbow": Rotation.from_euler("y", 70, degrees=True), "LElbow": Rotation.from_euler("y", -50, degrees=True)}
    bent |= {f"{side}Knee": Rotation.from_euler("x", 60, degrees=True) for side in "RL"}
    turned = {"RShoulder": (40, -30, 20), "LShoulder": (-50, 20, -40), "RHip": (-30, 25, 0), "LHip": (-20, -35, 0)}
    joints, world = posed(**bent, **{joint: Rotation.from_euler("xyz", a, degrees=True) for joint, a in turned.items()})
    found = solve_body(timeline_of(joints)).world_rotations()
    limbs = [JOINT_INDEX[joint] for joint in (*bent, *turned)]
    off = Rotation.from_matrix((np.swapaxes(world, -1, -2) @ found)[0, limbs]).magnitude()
    assert np.rad2deg(off).max() < 2


def test_limits_of_people_are_kept() -> None:
    names = ("Head", "RKnee", "RElbow", "LHand")
    bones = np.array([JOINT_INDEX[name] for name in names])
    within = Rotation.from_euler("y", [[20], [0], [30], [10]], degrees=True).as_matrix()[None]
    np.testing.assert_array_equal(within_limits(bones, within), within)
    beyond = np.stack([
        Rotation.from_euler("y", 120, degrees=True).as_matrix(),  # looks backwards
        Rotation.from_euler("x", -40, degrees=True).as_matrix(),  # the heel to the front
        Rotation.from_euler("x", 160, degrees=True).as_matrix(),  # pronation
        np.full((3, 3), np.nan),
    ])[None]  # fmt: skip
    assert beyond_limits(bones, beyond)[0].tolist() == [True, True, True, False]
    kept = within_limits(bones, beyond)
    assert not beyond_limits(bones, kept).any() and np.isnan(kept[0, 3]).all()
    angles = Rotation.from_matrix(kept[0, :3]).magnitude()
    np.testing.assert_allclose(np.rad2deg(angles), [60, 15, 110], atol=1e-3)
    joints, _ = posed(RKnee=Rotation.from_euler("x", -40, degrees=True))
    assert not beyond_limits(np.arange(18), solve_body(timeline_of(joints)).local).any()


def test_legs_whose_sides_are_wrong_leave_the_trunk_alone() -> None:
    joints, world = posed()
    legs = [JOINT_INDEX[side + name] for side in "RL" for name in ("Hip", "Knee", "Foot")]
    joints[:, legs] = joints[:, legs[3:] + legs[:3]]
    motion = solve_body(timeline_of(joints), offsets=ADULT)
    assert not beyond_limits(np.arange(18), motion.local).any()
    off = np.linalg.norm(motion.positions() - joints, axis=-1)[0]
    arms = [JOINT_INDEX[side + name] for side in "RL" for name in ("Shoulder", "Elbow", "Hand")]
    assert off[[JOINT_INDEX["Head"], *arms]].max() < 0.08 and off[legs].max() < 0.3
    chest = Rotation.from_matrix(motion.world_rotations()[0, JOINT_INDEX["Spine2"]].T @ world[0, JOINT_INDEX["Spine2"]])
    assert np.rad2deg(chest.magnitude()) < 15


def stepping(frames: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Joints of somebody whose right foot stands, with noise, and is moved by 40 cm in the middle; and the frames of
    the swing."""
    standing = posed(**{f"{side}Knee": Rotation.from_euler("x", 30, degrees=True) for side in "RL"})[0]
    joints = np.repeat(standing, frames, 0)
    swing = np.arange(frames // 2 - 6, frames // 2 + 6)
    share = np.clip((np.arange(frames) - swing[0]) / len(swing), 0, 1)
    foot = joints[:, FEET[0]] + 0.3 * (share**2 * (3 - 2 * share))[:, None] * [0.0, 0.0, 1.0]
    foot += 0.08 * np.sin(np.pi * share)[:, None] * [0.0, 1.0, 0.0]
    joints = reach_ankles(joints, LEGS[0], foot)
    return joints + rng.normal(0, 0.002, joints.shape), swing


def test_feet_that_stand_are_held_and_others_are_not() -> None:
    joints, swing = stepping(60, np.random.default_rng(0))
    steady = with_constant_bones(joints, rest_offsets(joints))
    stands = standing_feet(steady, FRAME_S)
    assert stands[:, 1].all() and stands[: swing[0] - 2, 0].all() and not stands[swing[2:-2], 0].any()
    held = hold_feet(steady, stands, FRAME_S)
    steps, before = (np.linalg.norm(np.diff(each[:, FEET], axis=0), axis=-1) for each in (held, steady))
    both = stands[1:] & stands[:-1]
    assert steps[both].mean() < 0.3 * before[both].mean() and steps[swing[3:-3], 0].min() > 0.01
    np.testing.assert_allclose(lengths(held), lengths(steady), atol=1e-6)
    assert np.linalg.norm(held - steady, axis=-1).max() < 0.015
    motion = solve_body(timeline_of(joints))
    np.testing.assert_array_equal(motion.standing, stands)
    np.testing.assert_allclose(motion.positions()[:, FEET], held[:, FEET], atol=1e-3)


def test_a_foot_that_is_not_seen_does_not_stand() -> None:
    joints, _ = stepping(40, np.random.default_rng(0))
    joints[5:12, FEET[0]] = np.nan
    assert not standing_feet(joints, FRAME_S)[5:12, 0].any()
    assert not standing_feet(joints[:2], FRAME_S).any()


def test_live_feet_stand_and_lengths_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running_skeleton, "LEARNT_S", 1.0)
    joints, _ = stepping(60, np.random.default_rng(0))
    skeleton = RunningSkeleton("y")
    found = []
    for i, each in enumerate(joints):
        found.append(skeleton(Pose(round(i * FRAME_S * 1e9), each, np.ones(len(JOINTS)))))
    positions = np.stack([one.positions() for one in found if one is not None])
    steps = 1e3 * np.linalg.norm(np.diff(positions[:, FEET[1]], axis=0), axis=-1)
    assert steps[10:].mean() < 1.8 < 1e3 * np.linalg.norm(np.diff(joints[:, FEET[1]], axis=0), axis=-1).mean()
    settled = round(1 / FRAME_S) + 2
    assert not skeleton.learning and np.ptp(lengths(positions[settled:]), axis=0).max() < 1e-9
    assert np.linalg.norm(positions[30, FEET[0]] - joints[30, FEET[0]]) < 0.05


@pytest.mark.parametrize("name", ["RHand", "LFoot"])
def test_lengths_may_be_given_live(name: str) -> None:
    skeleton = RunningSkeleton("y", 1.2 * ADULT)
    assert not skeleton.learning
    found = skeleton(Pose(0, posed()[0][0], np.ones(len(JOINTS))))
    assert found is not None
    bone = found.positions()[JOINT_INDEX[name]] - found.positions()[JOINT_INDEX[str(PARENTS[name])]]
    assert np.linalg.norm(bone) == pytest.approx(1.2 * REST[name][1], abs=1e-6)


def test_joints_that_are_all_in_one_place_are_no_error() -> None:
    motion = solve_body(timeline_of(np.ones((3, 18, 3))))
    np.testing.assert_allclose(motion.root, 1.0)
    assert np.isfinite(motion.world_rotations()).all()
    assert RunningSkeleton("z")(Pose(0, np.ones((18, 3)), np.ones(18))) is not None


def test_settings_of_contacts_count() -> None:
    joints, _ = stepping(40, np.random.default_rng(0))
    assert not standing_feet(joints, FRAME_S, ContactSettings(slow_mps=1e-6)).any()
