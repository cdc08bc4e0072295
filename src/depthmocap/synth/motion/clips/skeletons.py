"""Maps from posture bones to a file's joints: by naming scheme, by guessing, or from the user."""

from __future__ import annotations

import dataclasses
import itertools
import re
from pathlib import Path

from depthmocap.core.reading.json_text import read_json
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import POSTURE_BONES
from depthmocap.synth.motion.clips.clip_motion import Motion

_LIMB_BONES = ("clavicle", "upper_arm", "forearm", "hand", "thigh", "shin", "foot")
_TRUNK_BONES = ("pelvis", "spine_low", "spine_mid", "spine_up", "neck", "head")
#: A posture needs these; every other bone follows its parent where a file has none.
REQUIRED_BONES = (
    "pelvis",
    *(f"{bone}.{side}" for side in "RL" for bone in ("upper_arm", "forearm", "thigh", "shin")),
)

#: Names of a file's joints by posture bone.
Joints = dict[str, str]


def _scheme(trunk: str, right: str, left: str, limbs: str) -> Joints:
    """A naming scheme of trunk joints ("-" for none), the formats of right and left limbs, and their names."""
    table: Joints = dict(zip(_TRUNK_BONES, trunk.split(), strict=True))
    for side, form in (("R", right), ("L", left)):
        for bone, joint in zip(_LIMB_BONES, limbs.split(), strict=True):
            table[f"{bone}.{side}"] = joint if joint == "-" else form.format(joint)
    return {bone: joint for bone, joint in table.items() if joint != "-"}


_SIDES = ("Right{}", "Left{}")
#: Joints by naming scheme. A scheme fits if a file has all of its joints (without a common prefix such as
#: ``mixamorig:``). Forearms of CMU skeletons have two joints, so that the hand's rotation is not in the joint "Hand".
SCHEMES: dict[str, Joints] = {
    "cmu": _scheme("Hips LowerBack Spine Spine1 Neck1 Head", *_SIDES, "Shoulder Arm ForeArm FingerBase UpLeg Leg Foot"),
    "asf": _scheme(
        "root lowerback upperback thorax upperneck head", "r{}", "l{}", "clavicle humerus radius hand femur tibia foot"
    ),
    "daz": _scheme("hip abdomen - chest neck head", "r{}", "l{}", "Collar Shldr ForeArm Hand Thigh Shin Foot"),
    "motionbuilder": _scheme(
        "Hips lowerback Chest Chest2 Neck Head", *_SIDES, "Collar Shoulder Elbow Wrist Hip Knee Ankle"
    ),
    "mixamo": _scheme(  # also LaFAN1, OptiTrack's FBX names and MotionBuilder's HumanIK
        "Hips Spine Spine1 Spine2 Neck Head", *_SIDES, "Shoulder Arm ForeArm Hand UpLeg Leg Foot"
    ),
    "xsens": _scheme("Hips Chest Chest2 Chest4 Neck Head", *_SIDES, "Collar Shoulder Elbow Wrist Hip Knee Ankle"),
    "biovision": _scheme("Hips Chest - - Neck Head", *_SIDES, "Collar UpArm LowArm Hand UpLeg LowLeg Foot"),
    "unity": _scheme(
        "Hips Spine Chest UpperChest Neck Head", *_SIDES, "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot"
    ),
    "unreal": _scheme(
        "pelvis spine_01 spine_02 spine_03 neck_01 head", "{}_r", "{}_l",
        "clavicle upperarm lowerarm hand thigh calf foot",
    ),
    "rigify": _scheme(
        "spine spine.001 spine.002 spine.003 spine.004 spine.006", "{}.R", "{}.L",
        "shoulder upper_arm forearm hand thigh shin foot",
    ),
    "biped": _scheme(
        "Pelvis Spine Spine1 Spine2 Neck Head", "R_{}", "L_{}", "Clavicle UpperArm Forearm Hand Thigh Calf Foot"
    ),
    "makehuman": _scheme(  # its default rig; upper arms, legs and the rest are two joints each
        "root spine05 spine03 spine01 neck01 head", "{}.R", "{}.L",
        "clavicle upperarm01 lowerarm01 wrist upperleg01 lowerleg01 foot",
    ),
    "makehuman mocap": _scheme(
        "Hips Spine1 Spine2 Spine3 Neck Head", "{}_R", "{}_L", "Clavicle UpArm LoArm Hand UpLeg LoLeg Foot"
    ),
    "optitrack": _scheme("Hip Ab - Chest Neck Head", "R{}", "L{}", "Shoulder UArm FArm Hand Thigh Shin Foot"),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class SkeletonMap:
    """Index of the joint of every posture bone that the file has, and the naming scheme (or "guessed")."""

    joints: dict[str, int]
    scheme: str

    def describe(self, motion: Motion) -> str:
        """One line for a user to check."""
        pairs = ", ".join(f"{bone}={motion.names[joint]}" for bone, joint in self.joints.items())
        return f"{self.scheme}: {pairs}"


def read_mapping(path: Path) -> Joints:
    """A user's mapping: a JSON object from posture bones to joint names.

    Raises:
        InputError: when it is not such an object, or has unknown bones.
    """
    table = read_json(path)
    if not isinstance(table, dict) or not all(isinstance(joint, str) for joint in table.values()):
        raise InputError(f'{path} must be an object of posture bones and joint names, such as {{"pelvis": "Hips"}}')
    if unknown := sorted(set(table) - set(POSTURE_BONES)):
        raise InputError(
            f"{path}: no posture bone {unknown[0]!r}; they are {', '.join(POSTURE_BONES[:4])} … of body.posture"
        )
    return table


def map_skeleton(motion: Motion, overrides: Joints | None = None) -> SkeletonMap:
    """The joints of the posture bones: by a naming scheme that fits, otherwise guessed from words for sides and parts
    and from the tree. ``overrides`` takes precedence.

    Raises:
        InputError: when a required bone has no joint, or an override names a joint that the file lacks.
    """
    plain = _plain_names(motion.names)
    joints: dict[str, int] | None = None
    scheme = "guessed"
    for name, table in SCHEMES.items():
        if set(table.values()) <= set(plain):
            joints, scheme = {bone: plain.index(joint) for bone, joint in table.items()}, name
            break
    if joints is None:
        joints = _guess(motion, plain)
    for bone, joint in (overrides or {}).items():
        if joint not in motion.names:
            raise InputError(f"the mapping has joint {joint!r} for {bone}, the file has {', '.join(motion.names[:8])}…")
        joints[bone] = motion.names.index(joint)
    if missing := [bone for bone in REQUIRED_BONES if bone not in joints]:
        raise InputError(
            f"joints {list(motion.names[:6])}… fit no known naming scheme ({', '.join(SCHEMES)}), and guessing found "
            f"none for {', '.join(missing)}: name them in a --mapping file for postures build, and use its pool as "
            "--postures"
        )
    return SkeletonMap({bone: joints[bone] for bone in POSTURE_BONES if bone in joints}, scheme)


def _plain_names(names: tuple[str, ...]) -> list[str]:
    """Names without name space (``a:Hips``), path (``root/spine``) and common prefix; spaces become underscores."""
    plain = [re.split(r"[:/|\\]", name.rstrip(":/|\\"))[-1].replace(" ", "_") for name in names]
    prefixes = {match.group() for name in plain[1:] if (match := re.match(r"[A-Za-z]+\d*_", name))}
    if len(prefixes) == 1 and len(names) > 2:
        prefix = prefixes.pop()
        if all(name.startswith(prefix) for name in plain[1:]):
            plain = [name.removeprefix(prefix) for name in plain]
    return plain


_LEFT_WORDS, _RIGHT_WORDS = frozenset({"left", "l", "lft", "lt"}), frozenset({"right", "r", "rgt", "rt"})
_HEAD, _NECK = frozenset({"head", "skull"}), frozenset({"neck"})
_HAND, _FOOT = frozenset({"hand", "wrist", "palm"}), frozenset({"foot", "ankle"})
#: Words for the last joint of an arm without a hand.
_FOREARM = frozenset({"forearm", "lowerarm", "lowarm", "elbow", "radius", "farm"})
#: Words for the last joint of a leg without a foot.
_SHIN = frozenset({"shin", "calf", "lowerleg", "lowleg", "knee", "tibia"})
_PARTS = _HAND | _FOOT | _FOREARM | _SHIN
#: Words for helper joints: twist joints and handles of inverse kinematics.
_HELPERS = frozenset({"twist", "roll", "ik", "pole", "end", "nub", "site", "target"})
#: Words that may follow a side without a separator (``lfemur``).
_GLUED = _PARTS | frozenset({
    "femur", "humerus", "clavicle", "thigh", "hip", "leg", "upleg", "upperleg", "shoulder", "collar", "arm", "uparm",
    "upperarm", "shldr", "toe", "toes", "thumb", "fingers", "scapula", "fibula", "ulna", "buttock",
})  # fmt: skip


def _words(name: str) -> frozenset[str]:
    """Lower-case words of a name; pairs such as "lower arm" also as one word, and a side without a separator
    (``lfoot``) as its own word."""
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    words = [part.lower() for part in parts]
    for word in tuple(words):
        side = next((side for side in ("left", "right", "l", "r") if word.removeprefix(side) in _GLUED), "")
        if word.startswith(side) and side and word not in _GLUED:
            words += [side, word.removeprefix(side)]
    words += [a + b for a, b in itertools.pairwise(words)]
    return frozenset(words)


def _guess(motion: Motion, plain: list[str]) -> dict[str, int]:
    """Joints guessed from hands, feet and head upwards along the tree; unknown bones are left out."""
    words = [_words(name) for name in plain]
    joints: dict[str, int] = {}
    for side, sides in (("R", _RIGHT_WORDS), ("L", _LEFT_WORDS)):
        for last, fallback, chain in (
            (_HAND, _FOREARM, ("hand", "forearm", "upper_arm", "clavicle")),
            (_FOOT, _SHIN, ("foot", "shin", "thigh")),
        ):
            _guess_limb(motion, words, (sides, last, fallback), [f"{bone}.{side}" for bone in chain], joints)
    if not all(f"{bone}.{side}" in joints for bone in ("thigh", "upper_arm") for side in "RL"):
        return joints
    joints["pelvis"] = motion.common_ancestor([joints["thigh.R"], joints["thigh.L"]])
    chest = motion.common_ancestor([joints["upper_arm.R"], joints["upper_arm.L"]])
    above = motion.ancestors(chest)
    # If hips and spine are siblings below the root, the spine begins below the root.
    below = set(motion.ancestors(joints["pelvis"]))
    _spread_spine([joint for joint in above if joint not in below][::-1], joints)
    heads = [i for i, name in enumerate(words) if name & _HEAD and not name & _HELPERS]
    necks = [i for i, name in enumerate(words) if name & _NECK and not name & _HELPERS]
    if heads:
        joints["head"] = heads[0]
        necks = [i for i in motion.ancestors(heads[0])[1:] if i in necks]  # the nearest first
    if necks:
        joints["neck"] = necks[0]
    return joints


def _guess_limb(
    motion: Motion,
    words: list[frozenset[str]],
    name_parts: tuple[frozenset[str], frozenset[str], frozenset[str]],
    chain: list[str],
    joints: dict[str, int],
) -> None:
    """Bones of one limb from its end: the joint with such a name and its ancestors of the same side."""
    sides, end_words, fallback_words = name_parts
    of_side = [bool(name & sides) and not name & _HELPERS for name in words]
    for parts, bones in ((end_words, chain), (fallback_words, chain[1:])):
        ends = [i for i, name in enumerate(words) if of_side[i] and name & parts]
        if not ends:
            continue
        joint = min(ends, key=lambda i: len(motion.ancestors(i)))
        limb = [joint]
        for above in motion.ancestors(joint)[1:]:
            # A joint at the same position as the next one (hip joints of some files) has no bone.
            if of_side[above] and (motion.offsets[limb[-1]] ** 2).sum() > 1e-12:
                limb.append(above)
            elif not of_side[above] and not words[above] & _HELPERS:
                break
        joints.update(zip(bones, limb, strict=False))
        return


def _spread_spine(chain: list[int], joints: dict[str, int]) -> None:
    """Spine joints from the pelvis up: one is the low bone, two are the low and the high, more are spread evenly."""
    if chain:
        joints["spine_low"] = chain[0]
    if len(chain) > 1:
        joints["spine_up"] = chain[-1]
    if len(chain) > 2:
        joints["spine_mid"] = chain[len(chain) // 2]
