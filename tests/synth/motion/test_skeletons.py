"""Skeletons of other programs."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from clip_files import ASF_NAMES, POSE, PROGRAMS, check_pose, heads, skeleton, write_bvh
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.clips.bvh_clips import read_bvh_motion
from depthmocap.synth.motion.clips.clip_motion import Motion
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
    # One joint of the spine: its bend is shared out among ours, about one axis.
    spine = [angles[POSTURE_INDEX[bone]] for bone in ("spine_low", "spine_mid", "spine_up")]
    assert sum(spine) == pytest.approx(30, abs=0.1) and max(spine) < 29
    for bone in ("neck", "clavicle.L", "hand.R", "foot.L"):
        assert angles[POSTURE_INDEX[bone]] == pytest.approx(0, abs=0.1), bone


@pytest.mark.parametrize("program", ["biovision", "optitrack", "guessed short"])
def test_spines_of_few_joints_bend_as_far(tmp_path: Path, default_body: Body, program: str) -> None:
    """The shoulders come as far over the hips as in the file, whichever joint of the trunk bends."""
    path = tmp_path / "clip.bvh"
    joints = skeleton(program)
    spine = [key for key, *_ in joints if key.startswith("spine")]
    write_bvh(path, joints, [{key: (75 / len(spine), 0, 0) for key in spine}])
    motion = read_bvh_motion(path)
    theirs = np.array(motion.heads(motion.world_rotations()[0]))
    of = {key: theirs[motion.names.index(name)] for key, name, *_ in joints}
    shoulders, hips = (np.mean([of[f"{key}.{side}"] for side in "LR"], 0) for key in ("arm", "thigh"))
    _, up, forwards = shoulders - hips
    (posture,), _ = read_bvh(path, heads(default_body))
    ours = default_body.pose(posture.astype(np.float64)).joints
    shoulders, hips = (
        np.mean([ours[JOINT_INDEX[f"{side}{joint}"]] for side in "LR"], 0) for joint in ("Shoulder", "Hip")
    )
    _, backwards, above = shoulders - hips
    assert np.rad2deg(np.arctan2(-backwards, above) - np.arctan2(forwards, up)) == pytest.approx(0, abs=6)


def test_names_with_paths_and_glued_sides(tmp_path: Path, default_body: Body) -> None:
    """Acclaim's names in a BVH: as paths, and without the joints of the trunk, so that they are guessed."""
    names = dict(zip((row[0] for row in skeleton("mixamo")), ASF_NAMES.split(), strict=True))
    for form, scheme, left_out in (("root/{}", "asf", ()), ("{}", "guessed", ("spine1", "neck"))):
        joints = [(key, form.format(names[key]), parent, offset) for key, _, parent, offset in skeleton("mixamo")]
        joints = without(joints, left_out)
        path = tmp_path / "clip.bvh"
        write_bvh(path, joints, [{}, POSE])
        motion = read_bvh_motion(path)
        found = map_skeleton(motion)
        assert found.scheme == scheme
        key_of = {name: key for key, name, *_ in joints}
        for bone, key in (("thigh.L", "thigh.L"), ("upper_arm.R", "arm.R"), ("shin.R", "shin.R"), ("hand.L", "hand.L")):
            assert key_of[motion.names[found.joints[bone]]] == key
        check_pose(default_body, read_bvh(path, heads(default_body))[0])


def without(joints: list, left_out: tuple[str, ...]) -> list:
    """The joints but for some, whose offsets go to their children."""
    for key in left_out:
        at = next(i for i, joint in enumerate(joints) if joint[0] == key)
        _, _, above, offset = joints[at]
        joints = [
            (k, name, above if parent == at else parent, offset + own if parent == at else own)
            for i, (k, name, parent, own) in enumerate(joints) if i != at
        ]  # fmt: skip
        joints = [(k, name, parent - (parent > at), own) for k, name, parent, own in joints]
    return joints


def test_the_makehuman_rig_has_a_scheme() -> None:
    """Its limbs are two joints a bone, which guessing from the end upwards takes for two bones."""
    side = "clavicle.{0} shoulder01.{0} upperarm01.{0} upperarm02.{0} lowerarm01.{0} lowerarm02.{0} wrist.{0}"
    leg = "pelvis.{0} upperleg01.{0} upperleg02.{0} lowerleg01.{0} lowerleg02.{0} foot.{0} toe1-1.{0}"
    trunk = [*(f"spine0{i}" for i in range(5, 0, -1)), *(f"neck0{i}" for i in range(1, 4)), "head"]
    names, parents = ["root"], [-1]

    def hang(chain: Iterable[str], parent: str) -> None:
        for name in chain:
            parents.append(names.index(parent))
            names.append(name)
            parent = name

    hang(trunk, "root")
    for letter in "LR":
        hang(side.format(letter).split(), "spine01")
        hang(leg.format(letter).split(), "root")
    still = np.zeros((1, len(names), 3))
    motion = Motion(
        tuple(names), tuple(parents), np.ones((len(names), 3)), still[0],
        np.tile(np.eye(3), (1, len(names), 1, 1)), 1 / 30, still[:, 0],
    )  # fmt: skip
    found = map_skeleton(motion)
    assert found.scheme == "makehuman"
    assert names[found.joints["upper_arm.L"]] == "upperarm01.L" and names[found.joints["thigh.R"]] == "upperleg01.R"


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
        np.zeros((len(joints), 3)), rotations, 1 / 30, np.zeros((len(rotations), 3)),
    )  # fmt: skip
    check_pose(default_body, retarget(motion, map_skeleton(motion), heads(default_body)).postures)


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
    [("{", "not valid JSON"), ("[]", "must be an object"), ('{"tail": "x"}', "no posture bone 'tail'")],
)
def test_bad_mapping_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mapping.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as raised:
        read_mapping(path)
    assert str(path) in str(raised.value)
