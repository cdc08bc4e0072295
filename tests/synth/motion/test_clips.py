"""Skeletons of other programs, ASF/AMC files, and folders with bad clips in them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.body.model import Body
from depthmocap.body.posture import POSTURE_INDEX
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.synth.motion.clips.amc import read_amc_motion, read_asf
from depthmocap.synth.motion.clips.bvh import read_bvh_motion
from depthmocap.synth.motion.clips.motion import Motion
from depthmocap.synth.motion.clips.retarget import retarget
from depthmocap.synth.motion.clips.skeletons import map_skeleton, read_mapping
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.mocap import (
    Clip,
    ClipFolder,
    ClipReading,
    SkippedClip,
    read_amc,
    read_bvh,
    without_heading,
)
from depthmocap.synth.motion.postures import load_clips

pytest.importorskip("bvhio")

#: (key, parent, offset in centimetres with Y up, facing +Z) of a person in a T-pose; sided parts once, for the left.
TRUNK = {
    "hips": (None, (0, 95, 0)),
    "spine1": ("hips", (0, 10, 0)),
    "spine2": ("spine1", (0, 12, 0)),
    "spine3": ("spine2", (0, 12, 0)),
    "neck": ("spine3", (0, 20, 0)),
    "head": ("neck", (0, 10, 0)),
}
LIMBS = {
    "clavicle": ("spine3", (4, 12, 0)),
    "arm": ("clavicle", (14, 2, 0)),
    "forearm": ("arm", (28, 0, 0)),
    "hand": ("forearm", (25, 0, 0)),
    "thigh": ("hips", (9, -4, 0)),
    "shin": ("thigh", (0, -43, 0)),
    "foot": ("shin", (0, -42, 0)),
    "toe": ("foot", (0, -6, 14)),
}
#: What programs call them: trunk ("-": not there), the left and right forms, limbs.
PROGRAMS = {
    "mixamo": (
        "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck mixamorig:Head",
        "mixamorig:Left{} mixamorig:Right{}",
        "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase",
    ),
    "xsens": (
        "Hips Chest Chest2 Chest4 Neck Head",
        "Left{} Right{}",
        "Collar Shoulder Elbow Wrist Hip Knee Ankle Toe",
    ),
    "unity": (
        "Hips Spine Chest UpperChest Neck Head",
        "Left{} Right{}",
        "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes",
    ),
    "unreal": (
        "pelvis spine_01 spine_02 spine_03 neck_01 head",
        "{}_l {}_r",
        "clavicle upperarm lowerarm hand thigh calf foot ball",
    ),
    "rigify": (
        "spine spine.001 spine.002 spine.003 spine.004 spine.006",
        "{}.L {}.R",
        "shoulder upper_arm forearm hand thigh shin foot toe",
    ),
    "biped": (
        "Bip01 Pelvis|Bip01 Spine|Bip01 Spine1|Bip01 Spine2|Bip01 Neck|Bip01 Head",
        "Bip01 L {}|Bip01 R {}",
        "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0",
    ),
    "optitrack": ("Hip Ab - Chest Neck Head", "L{} R{}", "Shoulder UArm FArm Hand Thigh Shin Foot Toe"),
    "biovision": ("Hips Chest - - Neck Head", "Left{} Right{}", "Collar UpArm LowArm Hand UpLeg LowLeg Foot Toe"),
    "guessed": ("base - back - - skull", "Jnt_L_{} Jnt_R_{}", "- upArm lowArm palm thighBone shinBone ankle toes"),
    "guessed short": ("root torso - - - head", "{}_left {}_right", "- arm elbow - leg knee - -"),
}


def split(text: str) -> list[str]:
    return text.split("|") if "|" in text else text.split()


def skeleton(program: str) -> list[tuple[str, str, int, np.ndarray]]:
    """(key, name, parent's index, offset) of a program's person; what it has not is left out, its offset kept."""
    trunk, sides, limbs = PROGRAMS[program]
    rows: list[tuple[str, str | None, str | None, np.ndarray]] = [
        (key, None if name == "-" else name, parent, np.array(offset, float))
        for (key, (parent, offset)), name in zip(TRUNK.items(), split(trunk), strict=True)
    ]
    for side, form, sign in zip("LR", split(sides), (1, -1), strict=True):
        for (key, (parent, offset)), name in zip(LIMBS.items(), limbs.split(), strict=True):
            above = parent if parent in TRUNK else f"{parent}.{side}"
            place = np.array(offset, float) * [sign, 1, 1]
            rows.append((f"{key}.{side}", None if name == "-" else form.format(name), above, place))
    joints: list[tuple[str, str, int, np.ndarray]] = []
    stands_for: dict[str | None, tuple[int, np.ndarray]] = {None: (-1, np.zeros(3))}
    for key, name, above, offset in rows:
        parent, carried = stands_for[above]
        if name is None:
            stands_for[key] = (parent, carried + offset)
        else:
            stands_for[key] = (len(joints), np.zeros(3))
            joints.append((key, name, parent, carried + offset))
    return joints


def write_bvh(path: Path, joints: list[tuple[str, str, int, np.ndarray]], frames: list[dict], spoil: str = "") -> None:
    """A BVH file; frames give XYZ Euler angles (degrees) by key."""
    lines, written = ["HIERARCHY"], []

    def add(index: int, depth: int) -> None:
        key, name, _, offset = joints[index]
        lines.append(f"{'JOINT' if depth else 'ROOT'} {name}\n{{\nOFFSET {offset[0]} {offset[1]} {offset[2]}")
        lines.append(f"CHANNELS {'3' if depth else '6 Xposition Yposition Zposition'} Xrotation Yrotation Zrotation")
        written.append(key)
        children = [i for i, joint in enumerate(joints) if joint[2] == index]
        for child in children:
            add(child, depth + 1)
        if not children:
            tip = np.sign(offset[0]) * 9 if "hand" in key or "forearm" in key else 0
            lines.append(f"End Site\n{{\nOFFSET {tip} {0 if tip else -9} 0\n}}")
        lines.append("}")

    add(0, 0)
    lines += ["MOTION", f"Frames: {len(frames)}", "Frame Time: 0.033333"]
    for frame in frames:
        angles = [angle for key in written for angle in frame.get(key, (0, 0, 0))]
        lines.append(" ".join(f"{number:.6f}" for number in (0, 95, 0, *angles)))
    old, _, new = spoil.partition("=>")
    path.write_text("\n".join(lines).replace(old, new) if spoil else "\n".join(lines))


def heads(body: Body) -> dict[str, np.ndarray]:
    return dict(zip(body.model.bone_names, body.rest_heads, strict=True))


def limb(joints: np.ndarray, start: str, end: str) -> np.ndarray:
    direction = joints[JOINT_INDEX[end]] - joints[JOINT_INDEX[start]]
    return direction / np.linalg.norm(direction)


LEFT, FORWARD, UP = np.array([1.0, 0, 0]), np.array([0.0, -1, 0]), np.array([0.0, 0, 1])
#: The left elbow bent upwards by a right angle, the right knee bent backwards.
POSE = {"forearm.L": (0, 0, 90), "shin.R": (90, 0, 0)}


def check_pose(body: Body, postures: np.ndarray) -> None:
    """The first posture is a T-pose, the second :data:`POSE`."""
    rest, bent = (body.pose(posture.astype(np.float64)).joints for posture in postures[:2])
    for side, out in (("L", LEFT), ("R", -LEFT)):
        for start, end in (("Shoulder", "Elbow"), ("Elbow", "Hand")):
            np.testing.assert_allclose(limb(rest, side + start, side + end), out, atol=2e-3)
        for start, end in (("Hip", "Knee"), ("Knee", "Foot")):
            np.testing.assert_allclose(limb(rest, side + start, side + end), -UP, atol=2e-3)
    np.testing.assert_allclose(limb(bent, "LElbow", "LHand"), UP, atol=2e-3)
    np.testing.assert_allclose(limb(bent, "LShoulder", "LElbow"), LEFT, atol=2e-3)
    np.testing.assert_allclose(limb(bent, "RKnee", "RFoot"), -FORWARD, atol=2e-3)
    np.testing.assert_allclose(limb(bent, "LKnee", "LFoot"), -UP, atol=2e-3)
    assert within_limits(postures[:2]).all()


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


# ASF/AMC

ASF_NAMES = (
    "root lowerback upperback thorax upperneck head lclavicle lhumerus lradius lhand lfemur ltibia lfoot ltoes "
    "rclavicle rhumerus rradius rhand rfemur rtibia rfoot rtoes"
)


def asf_text() -> str:
    """The mixamo person with CMU's names; every bone ends where its child's joint is, its axes turned about Z."""
    bones, tree, rows = [], [], skeleton("mixamo")
    names = dict(zip((row[0] for row in rows), ASF_NAMES.split(), strict=True))
    for key, _, parent, _ in rows[1:]:
        children = [row[3] for row in rows if row[2] >= 0 and rows[row[2]][0] == key]
        vector = children[0] if children else np.array([0.0, 0, 5])
        length = np.linalg.norm(vector)
        bones.append(
            f"begin\n id 1\n name {names[key]}\n direction {' '.join(map(str, vector / length))}\n length {length}\n"
            f" axis 0 0 30 XYZ\n dof rx ry rz\n limits (-1 1)\n (-1 1)\n (-1 1)\nend"
        )
        tree.append(f"{names[rows[parent][0]]} {names[key]}")
    return (
        "# made for a test\n:version 1.10\n:units\n length 0.45\n angle deg\n:root\n order TX TY TZ RX RY RZ\n"
        " axis XYZ\n position 0 0 0\n orientation 0 0 0\n:bonedata\n" + "\n".join(bones)
        + "\n:hierarchy\nbegin\n" + "\n".join(tree) + "\nend\n"
    )  # fmt: skip


def amc_text(frames: list[dict]) -> str:
    """Frames of XYZ angles by key, put into bone axes turned by 30 degrees about Z."""
    rows = skeleton("mixamo")
    names = dict(zip((row[0] for row in rows), ASF_NAMES.split(), strict=True))
    lines = ["#!OML:ASF x.asf", ":FULLY-SPECIFIED", ":DEGREES"]
    axis = Rotation.from_euler("z", 30, degrees=True)
    for number, frame in enumerate(frames, 1):
        lines.append(str(number))
        for key, name in names.items():
            turn = Rotation.from_euler("XYZ", frame.get(key, (0, 0, 0)), degrees=True)
            if key == "hips":
                angles, place = turn.as_euler("xyz", degrees=True), "0 17 0 "
            else:
                angles, place = (axis.inv() * turn * axis).as_euler("xyz", degrees=True), ""
            lines.append(f"{name} {place}{' '.join(f'{angle:.6f}' for angle in angles)}")
    return "\n".join(lines) + "\n"


def test_amc_gives_the_postures_of_the_same_bvh(tmp_path: Path, default_body: Body) -> None:
    rng = np.random.default_rng(3)
    frames = [{}, POSE, *({row[0]: rng.uniform(-60, 60, 3) for row in skeleton("mixamo")} for _ in range(6))]
    (tmp_path / "07.asf").write_text(asf_text())
    (tmp_path / "07_01.amc").write_text(amc_text(frames))
    write_bvh(tmp_path / "07_01.bvh", skeleton("mixamo"), frames)
    from_amc, frame_time = read_amc(tmp_path / "07_01.amc", tmp_path / "07.asf", heads(default_body))
    from_bvh, _ = read_bvh(tmp_path / "07_01.bvh", heads(default_body))
    assert frame_time == pytest.approx(1 / 120)
    check_pose(default_body, from_amc)
    for amc, bvh in zip(from_amc, from_bvh, strict=True):
        np.testing.assert_allclose(
            default_body.pose(amc.astype(float)).joints, default_body.pose(bvh.astype(float)).joints, atol=2e-3
        )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (":hierarchy", ":nothing", "no :hierarchy"),
        ("name lfoot", "name lefthoof", "lefthoof|lfoot"),
        ("direction", "directory", "direction"),
        ("length 28.0", "length long", "long"),
        ("dof rx", "dof rq", "channel RQ"),
        ("dof rx ry", "dof rx rx", "twice"),
        ("\nend\n:hier", "\naxis 0 0\nend\n:hier", "cut off"),
        ("lowerback upperback", "lowerback upperback root", "root hangs"),
    ],
)
def test_bad_asf_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "07.asf"
    assert old in asf_text()
    path.write_text(asf_text().replace(old, new, 1))
    with pytest.raises(InputError, match=f"not a readable ASF file.*({message})"):
        read_asf(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n3\n", "\n3\nrtail 1\n", "damaged or cut off"),
        ("lfoot", "lhoof", "hoof|lfoot"),
        ("0.000000", "nan", "not finite"),
        ("0.000000", "zero", "zero"),
        ("\n1\n", "\none\n", "no frames|not all of"),
    ],
)
def test_bad_amc_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "07.asf").write_text(asf_text())
    path = tmp_path / "07_01.amc"
    path.write_text(amc_text([{}] * 4).replace(old, new))
    with pytest.raises(InputError, match=f"not a readable AMC file.*({message})"):
        read_amc_motion(path, read_asf(tmp_path / "07.asf"))
    path.write_text(amc_text([{}] * 4)[:-60])
    with pytest.raises(InputError, match="damaged or cut off"):
        read_amc_motion(path, read_asf(tmp_path / "07.asf"))


# Folders


def test_bad_clips_are_skipped_and_counted(tmp_path: Path, default_body: Body) -> None:
    joints = skeleton("mixamo")
    write_bvh(tmp_path / "good.bvh", joints, [{}] * 3)
    spoils = {
        "nan": "0.000000=>nan",
        "no_length": "OFFSET 28.0 0.0 0.0=>OFFSET 0 0 0",
        "no_frames": "Frames: 3=>Frames: 30",
        "no_trunk": "OFFSET 0.0=>OFFSET x",
        "no_offset": "OFFSET 28.0=>OFFSET nan",
    }
    for name, spoil in spoils.items():
        write_bvh(tmp_path / f"{name}.bvh", joints, [{}] * 3, spoil)
    unknown = [(key, f"j{i}", parent, offset) for i, (key, _, parent, offset) in enumerate(joints)]
    write_bvh(tmp_path / "unknown.bvh", unknown, [{}])
    (tmp_path / "bytes.bvh").write_bytes(bytes(range(256)))
    (tmp_path / "folder.bvh").mkdir()
    (tmp_path / "08_01.amc").write_text(amc_text([{}]))
    (tmp_path / "good.amc").write_text("")
    results = list(ClipFolder.open(tmp_path).read(heads(default_body)))
    clips = [result for result in results if isinstance(result, Clip)]
    skipped = {result.name: result.reason for result in results if isinstance(result, SkippedClip)}
    assert [clip.name for clip in clips] == ["good"]
    assert len(clips[0].postures) == clips[0].frames == 3
    assert clips[0].skeleton.startswith("mixamo: pelvis=mixamorig:Hips")
    reasons = {
        "nan.bvh": "not finite", "no_length.bvh": "has no length", "no_frames.bvh": "3 of its 30 frames",
        "no_trunk.bvh": "numerics", "unknown.bvh": "--mapping", "bytes.bvh": "it is not text",
        "no_offset.bvh": "skeleton has a number that is not finite", "folder.bvh": "BVH file: Is a directory",
        "08_01.amc": "08.asf is missing", "good.amc": "of this name",
    }  # fmt: skip
    assert set(skipped) == set(reasons)
    for name, reason in reasons.items():
        assert reason in skipped[name], name
        assert "\n" not in skipped[name]
        assert str(tmp_path) not in skipped[name]
    (tmp_path / "good.bvh").unlink()
    with pytest.raises(InputError, match=r"none of its 10 clips is readable; 08_01\.amc"):
        load_clips(tmp_path)


def test_amc_rates_and_skeletons_of_others(tmp_path: Path, default_body: Body) -> None:
    (tmp_path / "07.asf").write_text(asf_text())
    (tmp_path / "08_01.amc").write_text(amc_text([{}] * 9))
    reading = ClipReading(skeletons={"08": "07.asf"})
    lengths = []
    for manifest in ("file,description\n", "file,description,fps\n08_01.amc,run,30\n"):
        (tmp_path / "manifest.csv").write_text(manifest)
        (clip,) = ClipFolder.open(tmp_path, reading).read(heads(default_body))
        assert isinstance(clip, Clip)
        lengths.append(len(clip.postures))
    assert lengths == [3, 9]
    assert clip.simple
    (tmp_path / "manifest.csv").write_text("file,description,fps\n08_01.amc,run,fast\n")
    with pytest.raises(InputError, match=r"manifest\.csv: fps must be a number above 0, got 'fast'"):
        ClipFolder.open(tmp_path)


@pytest.mark.parametrize(
    ("words", "simple"),
    [("Slow walk/stride", True), ("jogging", True), ("run, jump", True), ("crunches", False), ("trunk twist", False)],
)
def test_which_descriptions_are_easy(tmp_path: Path, default_body: Body, words: str, simple: bool) -> None:
    write_bvh(tmp_path / "a.bvh", skeleton("mixamo"), [{}])
    (tmp_path / "manifest.csv").write_text(f'file,description\na.bvh,"{words}"\n')
    (clip,) = load_clips(tmp_path)
    assert clip.simple is simple


def test_impossible_frames_are_left_out(tmp_path: Path, default_body: Body) -> None:
    """A foot turned backwards, a knee bent forwards, a head turned right round."""
    still = [{}] * 3
    bad = [{"foot.L": (0, 170, 0)}, {"shin.R": (-60, 0, 0)}, {"head": (0, 170, 0)}]
    for i, frame in enumerate(bad):
        write_bvh(tmp_path / f"{i}.bvh", skeleton("mixamo"), [frame] * 3)
    write_bvh(tmp_path / "good.bvh", skeleton("mixamo"), still)
    counts = {clip.name: (len(clip.postures), clip.impossible) for clip in load_clips(tmp_path)}
    assert counts == {"0": (0, 3), "1": (0, 3), "2": (0, 3), "good": (3, 0)}
