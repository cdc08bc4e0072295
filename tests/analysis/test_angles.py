"""Angles of postures that are known, transfers, and the centre of mass."""

from __future__ import annotations

import numpy as np
import pytest
from even_walk import FPS, posed

from depthmocap.analysis.centre_of_mass import SEGMENTS, centre_of_mass
from depthmocap.analysis.joint_angles import joint_angles
from depthmocap.analysis.sit_to_stand import transfers
from depthmocap.analysis.steady_joints import SteadyJoints
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP

LEFT, FORWARD, UP = np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), np.array([0, 0, 1.0])


def upright(frames: int = 20) -> np.ndarray:
    zero = {side: np.zeros(frames) for side in "LR"}
    return posed(np.zeros(frames), zero, zero, 0.0)


def steady(joints: np.ndarray) -> SteadyJoints:
    return SteadyJoints(np.arange(len(joints)) / FPS, joints @ Y_UP_FROM_Z_UP.T, 1 / FPS)


def angles(joints: np.ndarray) -> dict[str, float]:
    return {name: float(np.nanmedian(values)) for name, values in joint_angles(steady(joints)).items()
            if not np.isnan(values).all()}  # fmt: skip


def turned(degrees: float, towards: np.ndarray, down: np.ndarray = -UP) -> np.ndarray:
    """A direction that hangs and is lifted towards another one."""
    return np.cos(np.radians(degrees)) * down + np.sin(np.radians(degrees)) * towards


def put(joints: np.ndarray, name: str, parent: str, offset: np.ndarray) -> None:
    joints[:, JOINT_INDEX[name]] = joints[:, JOINT_INDEX[parent]] + offset


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("heading", [0.0, 90.0, 200.0])
def test_known_postures(side: str, heading: float) -> None:
    letter, outwards = (side[0].upper(), LEFT if side == "left" else -LEFT)
    joints = upright()
    put(joints, f"{letter}Knee", f"{letter}Hip", 0.45 * turned(40, FORWARD))
    put(joints, f"{letter}Foot", f"{letter}Knee", 0.43 * turned(-30, FORWARD))
    put(joints, f"{letter}Elbow", f"{letter}Shoulder", 0.3 * turned(80, outwards))
    put(joints, f"{letter}Hand", f"{letter}Elbow", 0.25 * FORWARD)
    cos, sin = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    joints = joints @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
    rest = angles(upright() @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]]))
    found = angles(joints)
    other = "right" if side == "left" else "left"
    # The pelvis' zero is that of the skeleton at rest: what counts is the difference.
    straight = np.degrees(np.arctan2(0.05, 0.43))
    assert found[f"hip_flexion_{side}"] - rest[f"hip_flexion_{other}"] == pytest.approx(40 - straight, abs=0.5)
    assert found[f"hip_adduction_{side}"] == pytest.approx(0, abs=0.5)
    assert found[f"knee_flexion_{side}"] == pytest.approx(70, abs=0.1)
    assert found[f"elbow_flexion_{side}"] == pytest.approx(90, abs=0.1)
    assert found[f"shoulder_elevation_{side}"] == pytest.approx(80, abs=12)
    assert found[f"shoulder_plane_{side}"] == pytest.approx(0, abs=12)
    # The forearm points forwards in front of an arm that is lifted sideways: hand and elbow level, so no turn inwards.
    assert abs(found[f"shoulder_rotation_{side}"]) < 100
    assert found["pelvis_obliquity"] == pytest.approx(0, abs=0.5)
    assert found["trunk_bend"] == pytest.approx(0, abs=0.5)


def test_arms_forwards_and_across() -> None:
    joints = upright()
    put(joints, "RElbow", "RShoulder", 0.3 * turned(90, FORWARD))
    put(joints, "LElbow", "LShoulder", 0.3 * turned(5, FORWARD))
    put(joints, "LHand", "LElbow", 0.25 * turned(5, FORWARD))
    found = angles(joints)
    assert found["shoulder_plane_right"] == pytest.approx(90, abs=12)
    # An arm that hangs has no plane of elevation, and a straight one does not show how it is turned.
    assert "shoulder_rotation_left" not in found


def test_abduction_is_negative_adduction_on_both_sides() -> None:
    joints = upright()
    for letter, outwards in (("L", LEFT), ("R", -LEFT)):
        put(joints, f"{letter}Knee", f"{letter}Hip", 0.45 * turned(20, outwards))
    found = angles(joints)
    for side in ("left", "right"):
        assert found[f"hip_adduction_{side}"] == pytest.approx(-20, abs=0.5)


def test_a_lean_forwards_and_a_bend_to_the_right() -> None:
    joints = np.concatenate([upright(30), upright(10)])
    trunk = [JOINT_INDEX[name] for name in ("Spine1", "Spine2", "Neck", "Head", "LShoulder", "RShoulder", "LElbow",
                                            "RElbow", "LHand", "RHand")]  # fmt: skip
    low = joints[30, JOINT_INDEX["Spine"]]
    moved = joints.copy()
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    forwards = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    moved[30:, trunk] = (joints[30:, trunk] - low) @ forwards.T + low
    lean = joint_angles(steady(moved))["trunk_lean"]
    assert lean[35] - lean[5] == pytest.approx(30, abs=1.0)
    right = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    moved[30:, trunk] = (joints[30:, trunk] - low) @ right.T + low
    bend = joint_angles(steady(moved))["trunk_bend"]
    assert bend[35] - bend[5] == pytest.approx(30, abs=2.0)  # turned as the last rotation, not as the first


def test_a_chair() -> None:
    frames = 150
    share = np.clip((np.arange(frames) / FPS - 1.0) / 1.5, 0, 1)  # stands up from 1 to 2.5 s
    joints = upright(frames)
    thigh = np.radians(85 * (1 - share))
    for letter in "LR":
        knee = joints[:, JOINT_INDEX[f"{letter}Knee"]]
        offset = 0.45 * (np.cos(thigh)[:, None] * UP - np.sin(thigh)[:, None] * FORWARD)
        joints[:, JOINT_INDEX[f"{letter}Hip"]] = knee + offset
    (found,) = transfers(steady(joints))
    rise = np.cos(thigh)
    rise = (rise - rise[0]) / (rise[-1] - rise[0])
    expected = np.interp([0.1, 0.9], rise[31:76], np.arange(31, 76) / FPS)
    assert found.kind == "sit_to_stand"
    np.testing.assert_allclose([found.start_s, found.end_s], expected, atol=0.02)
    (back,) = transfers(steady(joints[::-1].copy()))
    assert back.kind == "stand_to_sit" and back.seconds == pytest.approx(found.seconds, abs=1e-6)
    joints[60:70, JOINT_INDEX["LHip"]] = np.nan
    assert transfers(steady(joints)) == []


def test_the_centre_of_mass() -> None:
    for sex in (0, 1):
        assert sum(segment.masses[sex] for segment in SEGMENTS.values()) == pytest.approx(1, abs=2e-3)
    joints = upright()
    centre = centre_of_mass(steady(joints)) @ Y_UP_FROM_Z_UP
    np.testing.assert_allclose(centre[:, 0], 0, atol=1e-6)
    assert 0.85 < centre[0, 2] < 1.1
    joints[3, JOINT_INDEX["RHand"]] = np.nan
    assert np.isnan(centre_of_mass(steady(joints))[3]).all()
