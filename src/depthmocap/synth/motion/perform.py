"""A body performs a score: trunk and arms are given as angles over time, the feet as a list of steps.

Feet that carry the body are nailed to the floor: the legs follow from the pelvis and the ankles by two-bone inverse
kinematics, so that nothing slides or floats whatever the build of the body is. All curves are continuous in velocity.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry.transforms import rotation_between
from depthmocap.synth.body.bones import POSTURE_INDEX, local_rotations
from depthmocap.synth.body.mesh import REST_POSTURE
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import PosedPerson

_SIDES = {"L": 1.0, "R": -1.0}  # the side's sign along +X
_FORWARD = np.array([0.0, -1.0, 0.0])
_DOWN = np.array([0.0, 0.0, -1.0])
#: Legs are never straighter than this share of their length: the knee would snap, and standing knees are soft.
_REACH = 0.996
#: Half the distance between the ankles of a relaxed stance (leg lengths), and how far the toes point out.
_STANCE, _TOES_OUT_DEG = 0.125, 7.0
#: Softness (leg lengths) of the limit that the legs put on the pelvis's height.
_SOFT = 0.004

#: Angles (degrees) and shares of the leg length at times (s). Bending forward, lifting the arms and flexing are
#: positive, and so is what goes to the person's left.
Score: TypeAlias = Mapping[str, Sequence[tuple[float | int, float | int]]]
#: Where a body stands, x, y (leg lengths), and its heading (degrees), 0 facing −Y.
Stance: TypeAlias = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Step:
    """One foot's way through the air to another place on the floor.

    Attributes:
        place: x, y of the ankle where it lands (leg lengths), in the world.
        yaw_deg: heading of the foot where it lands, the toes' outward angle not counted.
        detour: x (outwards), y (backwards), z by which the path leaves the straight line, in the foot's heading.
        toes_deg: how far the toes point down on the way.
        weight: share of the weight that the other foot takes over.
    """

    side: str
    start_s: float
    end_s: float
    place: tuple[float, float]
    yaw_deg: float = 0.0
    detour: tuple[float, float, float] = (0.0, 0.0, 0.09)
    toes_deg: float = 14.0
    weight: float = 0.6


def stand(side: str, x: float, y: float, yaw_deg: float = 0.0) -> tuple[float, float]:
    """Where a foot stands when the middle of a body with this heading is over a place."""
    yaw, half = np.deg2rad(yaw_deg), _SIDES[side] * _STANCE
    return float(x + half * np.cos(yaw)), float(y + half * np.sin(yaw))


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Postures of one body over time, and the displacement of its pelvis from the rest pose (metres)."""

    times_s: Float[ndarray, " n"]
    postures: Float[ndarray, "n 20 3"]
    offsets: Float[ndarray, "n 3"]


def leg_length(dressed: DressedBody) -> float:
    """Thigh and shin together (metres): what scores measure lengths in."""
    return sum(_leg_bones(dressed))


def _leg_bones(dressed: DressedBody) -> tuple[float, float]:
    body = dressed.body
    rest = dict(zip(JOINT_INDEX, body.rest_heads[body.model.joint_bones], strict=True))
    thigh, shin = (
        float(np.mean([np.linalg.norm(rest[f"{s}{a}"] - rest[f"{s}{b}"]) for s in _SIDES]))
        for a, b in (("Hip", "Knee"), ("Knee", "Foot"))
    )
    return thigh, shin


def perform(
    dressed: DressedBody, times_s: Float[ndarray, " n"], score: Score, steps: Sequence[Step], start: Stance
) -> Motion:
    """The motion at any times (s); before the first and after the last step the body stands. The feet are placed with
    the bones of this body, the soles of its shoes on the floor.

    Args:
        score: of drop, back, lean, bend, sway, twist, nod, look; out, forward, inward, elbow of both sides (.L, .R).
        steps: each foot's in order of time.
        start: where the body stands at first.
    """
    body = dressed.body
    rest = dict(zip(JOINT_INDEX, body.rest_heads[body.model.joint_bones], strict=True))
    floor = dressed.pose(REST_POSTURE).lowest_m
    thigh, shin = _leg_bones(dressed)
    leg = thigh + shin
    channels = _channels(times_s, score)
    feet = {side: _walk(side, steps, start, times_s) for side in _SIDES}
    heading = (feet["L"].yaw + feet["R"].yaw) / 2

    world = np.tile(np.eye(3), (len(times_s), len(POSTURE_INDEX), 1, 1))
    _pose_trunk(world, channels, heading)
    for side in _SIDES:
        _pose_arm(world, channels, side, rest)

    # The pelvis is over the feet, as far as they carry, and as high as the legs let it be.
    loads = feet["L"].load + feet["R"].load
    support = sum(foot.place * foot.load[:, None] for foot in feet.values()) / loads[:, None] * leg
    upright = _turns("z", heading)
    ankles_rest = (rest["LFoot"] + rest["RFoot"]) / 2
    shift = np.zeros((len(times_s), 3)) + (rest["Hip"] - ankles_rest)
    shift[:, 1] += channels["back"] * leg
    pelvis = support + np.einsum("nij,nj->ni", upright, shift)
    pelvis_rotation = world[:, POSTURE_INDEX["pelvis"]]
    ankles = {side: foot.place * leg + [0, 0, rest[f"{side}Foot"][2] - floor] for side, foot in feet.items()}
    hips = {side: pelvis_rotation @ (rest[f"{side}Hip"] - rest["Hip"]) for side in _SIDES}
    limits = [rest["Hip"][2] - floor - channels["drop"] * leg]
    for side in _SIDES:
        across = np.linalg.norm((pelvis + hips[side] - ankles[side])[:, :2], axis=1)
        height = np.sqrt(np.maximum((_REACH * leg) ** 2 - across**2, (0.3 * leg) ** 2))
        limits.append(ankles[side][:, 2] + height - hips[side][:, 2])
    soft = _SOFT * leg
    pelvis[:, 2] = -soft * np.log(np.exp(-np.stack(limits) / soft).sum(0))

    for side, foot in feet.items():
        outward = foot.yaw + np.deg2rad(_SIDES[side] * _TOES_OUT_DEG)
        knees = np.einsum("nij,j->ni", _turns("z", 0.6 * outward + 0.4 * heading), _FORWARD)
        reach = ankles[side] - pelvis - hips[side]
        thigh_to, shin_to = _bend_leg(reach, knees, thigh, shin)
        hinge = np.cross(knees, reach)
        for bone, (a, b), direction in (("thigh", ("Hip", "Knee"), thigh_to), ("shin", ("Knee", "Foot"), shin_to)):
            at_rest = _limb_frame(rest[f"{side}{b}"] - rest[f"{side}{a}"], np.array([1.0, 0.0, 0.0]))
            world[:, POSTURE_INDEX[f"{bone}.{side}"]] = _limb_frame(direction, hinge) @ at_rest.T
        world[:, POSTURE_INDEX[f"foot.{side}"]] = _turns("z", outward) @ _turns("x", foot.pitch)
    return Motion(times_s, local_rotations(world), pelvis - rest["Hip"])


def pose_sequence(dressed: DressedBody, motion: Motion) -> Iterator[PosedPerson]:
    """The person in every posture of a motion, where they then are, on the floor z = 0."""
    for posture, offset in zip(motion.postures, motion.offsets, strict=True):
        yield dressed.pose(posture).moved(np.eye(3), offset)


def _channels(times_s: Float[ndarray, " n"], score: Score) -> dict[str, Float[ndarray, " n"]]:
    channels: dict[str, ndarray] = {}
    for name, keys in score.items():
        at, values = np.array(keys, dtype=float).T
        clamped = np.clip(times_s, at[0], at[-1])
        # Pchip never overshoots, and stands still at the keys where a curve turns back: eased in and out.
        channels[name] = PchipInterpolator(np.r_[at[0] - 1, at, at[-1] + 1], np.r_[values[0], values, values[-1]])(
            clamped
        )
    return channels


def _ease(s: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    s = np.clip(s, 0, 1)
    return s * s * (3 - 2 * s)


def _bump(s: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    return np.sin(np.pi * np.clip(s, 0, 1)) ** 2


@dataclasses.dataclass(eq=False)
class _Foot:
    """An ankle's place over the floor (leg lengths), heading, pitch (radians, toes down) and load 0–1 over time."""

    place: Float[ndarray, "n 3"]
    yaw: Float[ndarray, " n"]
    pitch: Float[ndarray, " n"]
    load: Float[ndarray, " n"]


def _walk(side: str, steps: Sequence[Step], start: Stance, times_s: Float[ndarray, " n"]) -> _Foot:
    here, yaw_deg = np.array([*stand(side, *start), 0.0]), start[2]
    zero = np.zeros(len(times_s))
    foot = _Foot(np.tile(here, (len(times_s), 1)), zero + np.deg2rad(yaw_deg), zero.copy(), zero + 1)
    for step in (step for step in steps if step.side == side):
        s = (times_s - step.start_s) / (step.end_s - step.start_s)
        there = np.array([*step.place, 0.0])
        turn = np.deg2rad(step.yaw_deg - yaw_deg)
        foot.yaw += turn * _ease(s)
        x, y, z = step.detour
        detour = Rotation.from_rotvec([0, 0, np.deg2rad(step.yaw_deg)]).apply([_SIDES[side] * x, y, z])
        foot.place += (there - here) * _ease(s)[:, None] + detour * _bump(s)[:, None]
        foot.pitch += np.deg2rad(step.toes_deg) * _bump(s)
        # The weight goes over to the other foot before this one is lifted.
        foot.load *= 1 - step.weight * _bump((s + 0.25) / 1.5)
        here, yaw_deg = there, step.yaw_deg
    return foot


def _turns(axis: str, angles: Float[ndarray, " n"]) -> Float[ndarray, "n 3 3"]:
    return Rotation.from_euler(axis, angles[:, None]).as_matrix()


def _limb_frame(direction: Float[ndarray, "*n 3"], hinge: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3 3"]:
    """Orthonormal frame of a bone's direction and, as nearly as possible, its hinge."""
    d = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    side = np.cross(d, hinge)
    side = side / np.linalg.norm(side, axis=-1, keepdims=True)
    return np.stack([d, np.cross(side, d), side], -1)


def _pose_trunk(
    world: Float[ndarray, "n 20 3 3"], channels: dict[str, Float[ndarray, " n"]], heading: Float[ndarray, " n"]
) -> None:
    lean, bend, sway, twist, nod, look = (
        np.deg2rad(channels[name]) for name in ("lean", "bend", "sway", "twist", "nod", "look")
    )
    world[:, POSTURE_INDEX["pelvis"]] = _turns("z", heading) @ _turns("x", lean)
    parent = "pelvis"
    for bone, flexion, turn in (
        ("spine_low", bend / 3, twist / 3),
        ("spine_mid", bend / 3, twist / 3),
        ("spine_up", bend / 3, twist / 3),
        ("neck", nod / 2, look / 2),
        ("head", nod / 2, look / 2),
    ):
        local = _turns("z", turn) @ _turns("x", flexion)
        if bone.startswith("spine"):
            local = local @ _turns("y", sway / 3)
        world[:, POSTURE_INDEX[bone]] = world[:, POSTURE_INDEX[parent]] @ local
        parent = bone


def _pose_arm(
    world: Float[ndarray, "n 20 3 3"],
    channels: dict[str, Float[ndarray, " n"]],
    side: str,
    rest: dict[str, Float[ndarray, "3"]],
) -> None:
    sign = _SIDES[side]
    out, forward, inward, elbow = (
        np.deg2rad(channels[f"{name}.{side}"]) for name in ("out", "forward", "inward", "elbow")
    )
    chest = world[:, POSTURE_INDEX["spine_up"]]
    upper = rest[f"{side}Elbow"] - rest[f"{side}Shoulder"]
    hanging = rotation_between(upper, _DOWN)
    # Above the shoulder, a third of an arm's rise is the shoulder blade's; below, hardly any.
    raised = np.maximum(out, forward)
    rise = 0.16 * raised * _ease(raised / np.pi * 1.5)
    world[:, POSTURE_INDEX[f"clavicle.{side}"]] = chest @ _turns("y", -sign * rise)
    arm = chest @ _turns("x", -forward) @ _turns("y", -sign * out) @ _turns("z", -sign * inward) @ hanging
    fore = rest[f"{side}Hand"] - rest[f"{side}Elbow"]
    hinge = np.cross(upper, fore)  # the elbow is bent at rest
    at_rest = np.arctan2(np.linalg.norm(hinge), upper @ fore)
    flexion = Rotation.from_rotvec((elbow - at_rest)[:, None] * hinge / np.linalg.norm(hinge)).as_matrix()
    world[:, POSTURE_INDEX[f"upper_arm.{side}"]] = arm
    world[:, POSTURE_INDEX[f"forearm.{side}"]] = arm @ flexion
    world[:, POSTURE_INDEX[f"hand.{side}"]] = arm @ flexion


def _bend_leg(
    reach: Float[ndarray, "n 3"], knees: Float[ndarray, "n 3"], thigh: float, shin: float
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3"]]:
    """Directions (not unit) of thigh and shin that span ``reach``, the knee towards ``knees``."""
    length = np.linalg.norm(reach, axis=1, keepdims=True)
    along = reach / length
    front = knees - (knees * along).sum(1, keepdims=True) * along
    front = front / np.linalg.norm(front, axis=1, keepdims=True)
    length = np.clip(length, abs(thigh - shin) + 1e-6, (thigh + shin) * (1 - 1e-6))
    cos = np.clip((thigh**2 + length**2 - shin**2) / (2 * thigh * length), -1, 1)
    knee = thigh * (cos * along + np.sqrt(1 - cos**2) * front)
    return knee, length * along - knee
