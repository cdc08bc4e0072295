"""Clips of other programs' skeletons as BVH and ASF/AMC files, and what a pose must become."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.limits import within_limits

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
    """A BVH file; frames give XYZ Euler angles (degrees) by key, and the root's place as "at"."""
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
        lines.append(" ".join(f"{number:.6f}" for number in (*frame.get("at", (0, 95, 0)), *angles)))
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
