"""Skeletons of other programs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from clip_files import POSE, PROGRAMS, check_pose, heads, skeleton, write_bvh
from scipy.spatial.transform import Rotation

from depthmocap.body.model import Body
from depthmocap.body.posture import POSTURE_INDEX
from depthmocap.errors import InputError
from depthmocap.synth.motion.clips.bvh import read_bvh_motion
from depthmocap.synth.motion.clips.motion import Motion
from depthmocap.synth.motion.clips.retarget import retarget
from depthmocap.synth.motion.clips.skeletons import map_skeleton, read_mapping
from depthmocap.synth.motion.mocap import read_bvh, without_heading

pytest.importorskip("bvhio")


@pytest.mark.parametrize("program", PROGRAMS)
def test_skeletons_of_many_programs(tmp_path: Path, default_body: Body, program: str) -> None:
    path = tmp_path / "clip.bvh"
    joints = skeleton(program)
    write_bvh(path, joints, [{}, POSE])
    motion = read_bvh_motion(path)
    found = map_skeleton(motion)
    assert found.scheme == program.split()[0]
    if "short" not in program:
        wanted = {"pelvis": "hips", "head": "head", "upper_arm.L": "arm.L", "foot.R": "foot.R", "hand.L": "hand.L"}
        by_name = {name: key for key, name, _, _ in joints}
        for bone, key in wanted.items():
            assert by_name[motion.names[found.joints[bone]]] == key, bone
    check_pose(default_body, read_bvh(path, heads(default_body))[0])


def test_bones_that_are_missing_follow_their_parents(tmp_path: Path, default_body: Body) -> None:
    path = tmp_path / "clip.bvh"
    write_bvh(path, skeleton("guessed short"), [{"spine1": (30, 0, 0)}])
    postures, _ = read_bvh(path, heads(default_body))
    angles = np.rad2deg(np.linalg.norm(postures[0], axis=-1))
    assert angles[POSTURE_INDEX["spine_low"]] == pytest.approx(30, abs=0.1)
    for bone in ("spine_mid", "spine_up", "neck", "clavicle.L", "hand.R", "foot.L"):
        assert angles[POSTURE_INDEX[bone]] == pytest.approx(0, abs=0.1), bone


def turned(joints: list, rotation: np.ndarray) -> list:
    return [(key, name, parent, rotation @ offset) for key, name, parent, offset in joints]


@pytest.mark.filterwarnings("ignore:Gimbal lock")
@pytest.mark.parametrize("turn", [("x", 90.0), ("y", 90.0), ("y", 180.0), ("y", 40.0)])
def test_other_axes(tmp_path: Path, default_body: Body, turn: tuple[str, float]) -> None:
    """Files with Z up or that face elsewhere at rest: the rest pose tells."""
    rotation = Rotation.from_euler(*turn, degrees=True)
    names = {key: key for key, *_ in skeleton("mixamo")}
    pose = {key: rotation.apply(Rotation.from_euler("XYZ", POSE[key], degrees=True).as_rotvec()) for key in POSE}
    frame = {names[key]: Rotation.from_rotvec(v).as_euler("XYZ", degrees=True) for key, v in pose.items()}
    path = tmp_path / "clip.bvh"
    write_bvh(path, turned(skeleton("mixamo"), rotation.as_matrix()), [{}, frame])
    check_pose(default_body, without_heading(read_bvh(path, heads(default_body))[0]))


def test_offsets_in_the_bones_own_frames(tmp_path: Path, default_body: Body) -> None:
    """Files in whose zero pose nobody stands (each bone along its own X axis): the most upright frame is the rest."""
    joints = skeleton("mixamo")
    ends = {"hand": (9, 0, 0), "toe": (0, -1, 5), "head": (0, 12, 0)}

    def own_frame(index: int) -> Rotation:
        children = [joint[3] for joint in joints if joint[2] == index]
        key = joints[index][0]
        along = children[0] if children else np.array(ends[key.partition(".")[0]], float)
        if key in ("hips", "spine3"):
            along = np.array([0.0, 1, 0])
        return Rotation.align_vectors([along / np.linalg.norm(along), [0, 0, 1]], [[1.0, 0, 0], [0, 0, 1]])[0]

    frames_of = [own_frame(i) for i in range(len(joints))]
    offsets = np.array([
        frames_of[parent].inv().apply(offset) if parent >= 0 else offset for _, _, parent, offset in joints
    ])  # fmt: skip
    rotations = np.empty((2, len(joints), 3, 3))
    for n, pose in enumerate(({}, POSE)):
        world: list[Rotation] = []
        for i, (key, _, parent, _) in enumerate(joints):
            local = Rotation.from_euler("XYZ", pose.get(key, (0, 0, 0)), degrees=True)
            body = (world[parent] * frames_of[parent].inv() if parent >= 0 else Rotation.identity()) * local
            world.append(body * frames_of[i])
            rotations[n, i] = (world[parent].inv() * world[i] if parent >= 0 else world[i]).as_matrix()
    motion = Motion(
        tuple(joint[1] for joint in joints), tuple(joint[2] for joint in joints), offsets,
        np.zeros((len(joints), 3)), rotations, 1 / 30,
    )  # fmt: skip
    check_pose(default_body, retarget(motion, map_skeleton(motion), heads(default_body)))


def test_mapping_file(tmp_path: Path, default_body: Body) -> None:
    joints = [(key, f"j{i}", parent, offset) for i, (key, _, parent, offset) in enumerate(skeleton("unity"))]
    path, table = tmp_path / "clip.bvh", tmp_path / "mapping.json"
    write_bvh(path, joints, [{}, POSE])
    with pytest.raises(InputError, match="--mapping"):
        read_bvh(path, heads(default_body))
    names = {key: name for key, name, _, _ in joints}
    bones = {"pelvis": "hips", "spine_low": "spine1", "head": "head"}
    bones |= {f"{a}.{s}": f"{b}.{s}" for s in "LR" for a, b in (
        ("upper_arm", "arm"), ("forearm", "forearm"), ("hand", "hand"), ("thigh", "thigh"), ("shin", "shin"),
    )}  # fmt: skip
    table.write_text(json.dumps({bone: names[key] for bone, key in bones.items()}))
    check_pose(default_body, read_bvh(path, heads(default_body), read_mapping(table))[0])
    with pytest.raises(InputError, match="joint 'nose' for head"):
        read_bvh(path, heads(default_body), {"head": "nose"})


@pytest.mark.parametrize(
    ("text", "message"),
    [("{", "not a readable JSON"), ("[]", "must be an object"), ('{"tail": "x"}', "no posture bone 'tail'")],
)
def test_bad_mapping_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mapping.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as raised:
        read_mapping(path)
    assert str(path) in str(raised.value)
