"""Surface landmarks: points of the skin that clinical marker sets and animators use, beside the 18 joints.

R is the subject's right, as in the names of joints. A landmark keeps its place in the frame of one bone, seen from one
joint: an epicondyle of the knee moves with the thigh and is seen from the knee.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from depthmocap.body.skeleton import JOINT_INDEX


@dataclasses.dataclass(frozen=True)
class Landmark:
    """A point of the skin.

    Attributes:
        name: of columns and markers.
        joint: that it is seen from.
        bone: the joint that the bone starts at with which it moves.
        words: what it is.
    """

    name: str
    joint: str
    bone: str
    words: str


#: Name, joint, bone, and what it is, of landmarks in the middle.
_MIDDLE = (
    ("Crown", "Head", "Head", "top of the head"),
    ("Nose", "Head", "Head", "tip of the nose"),
    ("C7", "Neck", "Spine2", "nape at the lowest vertebra of the neck"),
    ("T10", "Spine2", "Spine1", "back at the tenth vertebra of the chest"),
    ("JugularNotch", "Neck", "Spine2", "between the collarbones"),
    ("Xiphoid", "Spine2", "Spine1", "lower end of the breastbone"),
)
#: The same of those on both sides; joints and bones without a letter are in the middle.
_SIDED = (
    ("Ear", "Head", "Head", "outermost of the ear"),
    ("Acromion", ".Shoulder", "Spine2", "top of the shoulder"),
    ("ElbowLateral", ".Elbow", ".Shoulder", "lateral epicondyle of the upper arm"),
    ("ElbowMedial", ".Elbow", ".Shoulder", "medial epicondyle of the upper arm"),
    ("WristRadial", ".Hand", ".Elbow", "styloid process on the thumb's side"),
    ("WristUlnar", ".Hand", ".Elbow", "styloid process on the little finger's side"),
    ("KnuckleIndex", ".Hand", ".Hand", "back of the index finger's base"),
    ("KnuckleMiddle", ".Hand", ".Hand", "back of the middle finger's base"),
    ("KnuckleRing", ".Hand", ".Hand", "back of the ring finger's base"),
    ("KnuckleLittle", ".Hand", ".Hand", "back of the little finger's base"),
    ("ThumbTip", ".Hand", ".Hand", "tip of the thumb"),
    ("IndexTip", ".Hand", ".Hand", "tip of the index finger"),
    ("MiddleTip", ".Hand", ".Hand", "tip of the middle finger"),
    ("RingTip", ".Hand", ".Hand", "tip of the ring finger"),
    ("LittleTip", ".Hand", ".Hand", "tip of the little finger"),
    ("Asis", ".Hip", "Hip", "anterior superior iliac spine"),
    ("Psis", ".Hip", "Hip", "posterior superior iliac spine"),
    ("Trochanter", ".Hip", ".Hip", "greater trochanter"),
    ("KneeLateral", ".Knee", ".Hip", "lateral epicondyle of the thigh"),
    ("KneeMedial", ".Knee", ".Hip", "medial epicondyle of the thigh"),
    ("AnkleLateral", ".Foot", ".Knee", "lateral malleolus"),
    ("AnkleMedial", ".Foot", ".Knee", "medial malleolus"),
    ("Heel", ".Foot", ".Foot", "hindmost of the heel"),
    ("BigToeBase", ".Foot", ".Foot", "above the base of the big toe"),
    ("SmallToeBase", ".Foot", ".Foot", "above the base of the small toe"),
    ("Toe", ".Foot", ".Foot", "tip of the big toe"),
)

LANDMARKS: tuple[Landmark, ...] = (
    *(Landmark(*row) for row in _MIDDLE),
    *(
        Landmark(side + name, joint.replace(".", side), bone.replace(".", side), f"{words}")
        for side in "RL"
        for name, joint, bone, words in _SIDED
    ),
)
LANDMARK_NAMES: tuple[str, ...] = tuple(landmark.name for landmark in LANDMARKS)
LANDMARK_INDEX: dict[str, int] = {name: i for i, name in enumerate(LANDMARK_NAMES)}


def _mirror(name: str) -> str:
    mirrored = {"R": "L", "L": "R"}.get(name[0], name[0]) + name[1:]
    return mirrored if mirrored in LANDMARK_INDEX else name


#: ``landmarks[LANDMARK_MIRROR]`` swaps left and right.
LANDMARK_MIRROR = np.array([LANDMARK_INDEX[_mirror(name)] for name in LANDMARK_NAMES])

#: Landmarks that the voting network measures beside the joints, as they are seen: what turns the head, the pelvis, the
#: hands and the feet, which the joints leave open.
POINTS: tuple[str, ...] = (
    "Crown", "Nose", "REar", "LEar",
    *(side + name for side in "RL" for name in
      ("Asis", "Psis", "KnuckleIndex", "KnuckleLittle", "Heel", "BigToeBase", "Toe")),
)  # fmt: skip
#: Where they are among the landmarks.
POINT_ROWS = np.array([LANDMARK_INDEX[name] for name in POINTS])
#: The joint that each is seen from.
POINT_JOINTS = np.array([JOINT_INDEX[LANDMARKS[row].joint] for row in POINT_ROWS])
#: The bone that each is on, by the joint that it starts at.
POINT_BONES = np.array([JOINT_INDEX[LANDMARKS[row].bone] for row in POINT_ROWS])
#: ``points[POINT_MIRROR]`` swaps left and right.
POINT_MIRROR = np.array([POINTS.index(_mirror(name)) for name in POINTS])
