"""Which joint of a file each of our posture bones follows: by naming scheme, guessed, or told by the user."""

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

Joints = dict[str, str]  # posture bone → the file's joint


def _scheme(trunk: str, right: str, left: str, limbs: str) -> Joints:
    """Joints of the trunk ("-": none), the two sides' forms of a limb's name, and the names of the limbs."""
    table: Joints = dict(zip(_TRUNK_BONES, trunk.split(), strict=True))
    for side, form in (("R", right), ("L", left)):
        for bone, joint in zip(_LIMB_BONES, limbs.split(), strict=True):
            table[f"{bone}.{side}"] = joint if joint == "-" else form.format(joint)
    return {bone: joint for bone, joint in table.items() if joint != "-"}


_SIDES = ("Right{}", "Left{}")
#: By naming scheme; one fits when a file has all of its joints (a common prefix such as ``mixamorig:`` left out). The
#: forearm of the CMU skeletons is two joints long, and so their hand's own rotation is not in the joint called hand.
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
    """The joint (by its index) of every posture bone that the file has, and where that was found."""

    joints: dict[str, int]
    scheme: str

    def describe(self, motion: Motion) -> str:
        """One line for a user to check."""
        pairs = ", ".join(f"{bone}={motion.names[joint]}" for bone, joint in self.joints.items())
        return f"{self.scheme}: {pairs}"


def read_mapping(path: Path) -> Joints:
    """A user's mapping: a JSON object of posture bones and joint names.

    Raises:
        InputError: when it is not one, or names bones that we do not have.
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
    """The joints of our posture bones: of a naming scheme all of whose joints are there, else guessed from side and
    part words and the tree. ``overrides`` goes before both.

    Raises:
        InputError: when a required bone is not found, or an override names a joint that the file has not.
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
    """Names without a name space (``a:Hips``), a path (``root/spine``) or a prefix that the joints share, spaces as
    underscores."""
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
#: Where a limb has no hand or foot it ends in one of these.
_FOREARM = frozenset({"forearm", "lowerarm", "lowarm", "elbow", "radius", "farm"})
_SHIN = frozenset({"shin", "calf", "lowerleg", "lowleg", "knee", "tibia"})
_PARTS = _HAND | _FOOT | _FOREARM | _SHIN
#: Joints beside the limb's own: twist helpers and inverse kinematics handles.
_HELPERS = frozenset({"twist", "roll", "ik", "pole", "end", "nub", "site", "target"})
#: What a side may be glued to (``lfemur``), beside the ends of limbs.
_GLUED = _PARTS | frozenset({
    "femur", "humerus", "clavicle", "thigh", "hip", "leg", "upleg", "upperleg", "shoulder", "collar", "arm", "uparm",
    "upperarm", "shldr", "toe", "toes", "thumb", "fingers", "scapula", "fibula", "ulna", "buttock",
})  # fmt: skip


def _words(name: str) -> frozenset[str]:
    """Lower-case words of a name; pairs such as "lower arm" also as one, and a glued side (``lfoot``) apart."""
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    words = [part.lower() for part in parts]
    for word in tuple(words):
        side = next((side for side in ("left", "right", "l", "r") if word.removeprefix(side) in _GLUED), "")
        if word.startswith(side) and side and word not in _GLUED:
            words += [side, word.removeprefix(side)]
    words += [a + b for a, b in itertools.pairwise(words)]
    return frozenset(words)


def _guess(motion: Motion, plain: list[str]) -> dict[str, int]:
    """Joints found from the hands, feet and head upwards along the tree; what is not found is left out."""
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
    joints["pelvis"] = motion.joined([joints["thigh.R"], joints["thigh.L"]])
    chest = motion.joined([joints["upper_arm.R"], joints["upper_arm.L"]])
    above = motion.ancestors(chest)
    # Where hips and spine hang from one root side by side, the spine begins below that.
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
    """Bones of one limb from its end: the joint named so and those above it, as far as they carry the side."""
    sides, last, fallback = name_parts
    of_side = [bool(name & sides) and not name & _HELPERS for name in words]
    for parts, bones in ((last, chain), (fallback, chain[1:])):
        ends = [i for i, name in enumerate(words) if of_side[i] and name & parts]
        if not ends:
            continue
        joint = min(ends, key=lambda i: len(motion.ancestors(i)))
        limb = [joint]
        for above in motion.ancestors(joint)[1:]:
            # A joint of no length to the next (as the hip joints of some files) turns nothing of its own.
            if of_side[above] and (motion.offsets[limb[-1]] ** 2).sum() > 1e-12:
                limb.append(above)
            elif not of_side[above] and not words[above] & _HELPERS:
                break
        joints.update(zip(bones, limb, strict=False))
        return


def _spread_spine(chain: list[int], joints: dict[str, int]) -> None:
    """Spine joints from the pelvis up: one is the low one, two the low and the high, more are spread evenly."""
    if chain:
        joints["spine_low"] = chain[0]
    if len(chain) > 1:
        joints["spine_up"] = chain[-1]
    if len(chain) > 2:
        joints["spine_mid"] = chain[len(chain) // 2]
