"""What an avatar gets: bones that pose a skeleton as the person stands, in Unity's axes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy import ndarray
from receivers import OscReceiver, osc, wait_until
from samples import EMPTY_RIG, sample_of, standing_pose
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.errors import InputError
from depthmocap.exporting.bone_rotations import joint_positions, rest_offsets
from depthmocap.frames import Pose
from depthmocap.geometry import Rig
from depthmocap.streaming import running_skeleton
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.running_skeleton import RunningSkeleton
from depthmocap.streaming.stream_protocol import StreamSetup
from depthmocap.streaming.vmc_stream import BONES

__all__ = ["osc"]

#: Unity's humanoid: of each bone the one that it hangs from.
PARENTS = {
    "Spine": "Hips", "Chest": "Spine", "UpperChest": "Chest", "Neck": "UpperChest", "Head": "Neck",
    **{f"{side}{bone}": parent if parent in ("Hips", "UpperChest") else f"{side}{parent}" for side in ("Left", "Right")
       for bone, parent in (("Shoulder", "UpperChest"), ("UpperArm", "Shoulder"), ("LowerArm", "UpperArm"),
                            ("Hand", "LowerArm"), ("UpperLeg", "Hips"), ("LowerLeg", "UpperLeg"),
                            ("Foot", "LowerLeg"))},
}  # fmt: skip
#: The joint at the head of each bone.
JOINT = {
    "Hips": "Hip", "Spine": "Spine", "Chest": "Spine1", "Neck": "Neck", "Head": "Head",
    **{f"{side}{bone}": f"{side[0]}{joint}" for side in ("Left", "Right")
       for bone, joint in (("UpperArm", "Shoulder"), ("LowerArm", "Elbow"), ("Hand", "Hand"), ("UpperLeg", "Hip"),
                           ("LowerLeg", "Knee"), ("Foot", "Foot"))},
}  # fmt: skip


def unity_from_z_up(points: ndarray) -> ndarray:
    """Unity's axes: x to the right of somebody who faces z, y up; our subject faces -y, and the right is at -x."""
    return np.stack([-points[..., 0], points[..., 2], -points[..., 1]], -1)


def rotated(quaternion: ndarray, vector: ndarray) -> ndarray:
    """The formula that engines use; it is the same in left-handed axes."""
    axis, w = quaternion[:3], quaternion[3]
    twice = 2 * np.cross(axis, vector)
    return vector + w * twice + np.cross(axis, twice)


def product(a: ndarray, b: ndarray) -> ndarray:
    """Of two quaternions: first b, then a."""
    return np.array([*(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])), a[3] * b[3] - a[:3] @ b[:3]])


def posed(bones: dict[str, ndarray]) -> tuple[dict[str, ndarray], dict[str, ndarray]]:
    """World positions and rotations of bones, as a scene graph makes them from local ones."""
    places, turns = {"Hips": bones["Hips"][:3]}, {"Hips": bones["Hips"][3:]}
    for name, parent in PARENTS.items():
        places[name] = places[parent] + rotated(turns[parent], bones[name][:3])
        turns[name] = product(turns[parent], bones[name][3:])
    return places, turns


def sent(osc: OscReceiver, *poses: Pose, up: str = "z") -> dict[str, ndarray]:
    """The bones of the last pose."""
    stream = open_stream(f"vmc://127.0.0.1:{osc.port}")
    stream.start(StreamSetup(Rig((), up)))
    for pose in poses:
        stream.send(sample_of(pose))
    stream.close()
    wait_until(lambda: len(osc.of("/VMC/Ext/T")) == len(poses))
    messages = osc.of("/VMC/Ext/Bone/Pos")
    assert len(messages) == len(poses) * len(BONES)
    return {str(name): np.array(numbers) for name, *numbers in messages[-len(BONES) :]}


def rigid(pose: Pose, turn: Rotation) -> Pose:
    return dataclasses.replace(pose, joints=turn.apply(pose.joints))


@pytest.mark.parametrize("degrees", [0, 50, 170])
def test_an_avatar_stands_as_the_person(osc: OscReceiver, degrees: float) -> None:
    turn = Rotation.from_euler("zx", [degrees, 0.2 * degrees], degrees=True)
    pose = rigid(standing_pose(), turn)
    bones = sent(osc, pose)
    assert set(bones) == set(BONES) == {"Hips", *PARENTS}
    places, _ = posed(bones)
    wanted = unity_from_z_up(pose.joints)
    for name, joint in JOINT.items():
        np.testing.assert_allclose(places[name], wanted[JOINT_INDEX[joint]], atol=0.012, err_msg=name)
    for bone, to in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")):
        for side in ("Left", "Right"):
            way = wanted[JOINT_INDEX[JOINT[side + to]]] - wanted[JOINT_INDEX[JOINT[side + bone]]]
            np.testing.assert_allclose(places[side + to] - places[side + bone], way, atol=1e-6)


def test_the_rest_pose_is_the_identity(osc: OscReceiver) -> None:
    offsets = rest_offsets(np.full((1, 18, 3), np.nan))
    y_up = joint_positions(np.tile(np.eye(3), (1, 18, 1, 1)), np.array([[0.3, 1.0, 0.2]]), offsets)[0]
    bones = sent(osc, Pose(0, y_up, np.ones(18)), up="y")
    # The twist about straight limbs, and hands, feet and head, are what is likely of people in this pose.
    turned = np.rad2deg(Rotation.from_quat([each[3:] for each in bones.values()]).magnitude())
    trunk = [list(bones).index(name) for name in ("Hips", "Spine", "Chest", "Neck", "Head")]
    assert turned[trunk].max() < 20 and turned.max() < 80
    np.testing.assert_allclose(bones["Hips"][:3], [-0.3, 1.0, 0.2], atol=1e-6)
    assert bones["LeftUpperArm"][0] < 0 < bones["RightUpperArm"][0], "the subject's left is at -x"
    assert bones["LeftLowerArm"][0] == pytest.approx(-0.27)


def test_what_is_not_seen_holds_its_rotation(osc: OscReceiver) -> None:
    whole = standing_pose()
    blind = standing_pose(40_000_000)
    for name in ("LElbow", "LHand"):
        blind.joints[JOINT_INDEX[name]] = np.nan
    blind.confidence[JOINT_INDEX["RHand"]] = 0.1
    nothing = Pose(80_000_000, np.full((18, 3), np.nan), np.zeros(18))
    before = sent(osc, *[whole] * 3)
    for pose in (blind, nothing):
        osc.messages.clear()
        bones = sent(osc, *[whole] * 3, pose)
        for name in BONES:
            np.testing.assert_allclose(bones[name], before[name], atol=1e-6, err_msg=name)


def test_nobody_is_told_and_somebody_else_begins_anew(osc: OscReceiver) -> None:
    stream = open_stream(f"vmc://127.0.0.1:{osc.port}")
    stream.start(StreamSetup(EMPTY_RIG))
    first, other = sample_of(standing_pose(0)), sample_of(standing_pose(1_500_000_000))
    stream.send(first)
    stream.send(dataclasses.replace(first, people={}))
    stream.send(dataclasses.replace(other, people={7: other.people[1]}))
    stream.close()
    wait_until(lambda: len(osc.of("/VMC/Ext/T")) == 3)
    assert osc.of("/VMC/Ext/OK") == [(1, 3, 0, 1), (1, 3, 0, 0), (1, 3, 0, 1)]
    assert osc.of("/VMC/Ext/T") == [(0.0,), (0.0,), (1.5,)]
    assert osc.of("/VMC/Ext/Root/Pos") == [("root", 0, 0, 0, 0, 0, 0, 1)] * 2
    addresses = [address for address, _ in osc.messages]
    assert addresses[-1] == "/VMC/Ext/T" and addresses[-2] == "/VMC/Ext/OK"


def test_each_of_several_people_has_a_port_and_keeps_it(osc: OscReceiver) -> None:
    told: list[str] = []
    stream = open_stream(f"vmc://127.0.0.1:{osc.port - 1}")
    stream.start(StreamSetup(EMPTY_RIG, people=2, tell=told.append))
    first, aside = standing_pose(), rigid(standing_pose(), Rotation.identity())
    aside = dataclasses.replace(aside, joints=aside.joints + np.array([0.5, 0.0, 0.0]))
    sample = sample_of(first)
    for people in ({1: first, 2: aside}, {2: aside}, {1: first}):
        stream.send(dataclasses.replace(sample, people=people))
    stream.close()
    wait_until(lambda: len(osc.of("/VMC/Ext/T")) == 3)
    assert told == [f"2 people go to the ports {osc.port - 1} to {osc.port}, one to each"]
    assert osc.of("/VMC/Ext/OK") == [(1, 3, 0, 1), (1, 3, 0, 1), (1, 3, 0, 0)]
    hips = [numbers for name, *numbers in osc.of("/VMC/Ext/Bone/Pos") if name == "Hips"]
    assert len(hips) == 2
    np.testing.assert_allclose(hips[0][:3], unity_from_z_up(aside.joints)[JOINT_INDEX["Hip"]], atol=0.012)
    with pytest.raises(InputError, match="2 people take the ports from 65535 to 65536"):
        open_stream("vmc://127.0.0.1:65535").start(StreamSetup(EMPTY_RIG, people=2))


def test_the_rest_skeleton_is_learnt_and_then_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running_skeleton, "LEARNT_POSES", 64)
    skeleton, rng = RunningSkeleton("z"), np.random.default_rng(0)
    nobody = Pose(0, np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS)))
    assert skeleton(nobody) is None
    learnt = []
    for i in range(80):
        pose = standing_pose(i)
        found = skeleton(dataclasses.replace(pose, joints=pose.joints + rng.normal(0, 0.01, (18, 3))))
        assert found is not None
        learnt.append(found.offsets)
    length = np.linalg.norm(learnt[-1][JOINT_INDEX["LHand"]])
    joints = standing_pose().joints
    true = np.linalg.norm(joints[JOINT_INDEX["LHand"]] - joints[JOINT_INDEX["LElbow"]])
    assert length == pytest.approx(true, abs=0.005)
    np.testing.assert_array_equal(learnt[63], learnt[-1])
    held = skeleton(nobody)
    assert held is not None


def test_lengths_that_changed_while_they_were_learnt_are_noted(osc: OscReceiver) -> None:
    notes: list[str] = []
    stream = open_stream(f"vmc://127.0.0.1:{osc.port}")
    stream.start(StreamSetup(EMPTY_RIG, note=notes.append))
    for i in range(8):
        pose = standing_pose(i * 33_000_000)
        stream.send(sample_of(dataclasses.replace(pose, joints=pose.joints * (1.0 if i < 2 else 1.2))))
    stream.close()
    stream.close()
    (note,) = notes
    assert "bone lengths of person 1 changed" in note and " cm at once" in note
    stream.start(StreamSetup(EMPTY_RIG, note=notes.append))
    for i in range(4):
        stream.send(sample_of(standing_pose(i * 33_000_000)))
    stream.close()
    assert len(notes) == 1
