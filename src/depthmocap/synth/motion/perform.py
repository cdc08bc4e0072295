"""Procedural motion: a score of joint angles over time for trunk and arms, and a list of steps for the feet.

Standing feet do not move. The legs follow from pelvis and ankles by two-bone inverse kinematics, so that bodies of all
builds neither slide nor float. All curves are continuous in velocity.
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
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.people.shell import smoothstep
from depthmocap.synth.render import PosedPerson

#: Sign of each side along +X.
_SIDES = {"L": 1.0, "R": -1.0}
_FORWARD = np.array([0.0, -1.0, 0.0])
_DOWN = np.array([0.0, 0.0, -1.0])
#: Largest reach of a leg as a share of its length: a straight knee would snap, and people stand with soft knees.
_LARGEST_REACH = 0.996
#: Half the distance between the ankles of a relaxed stance (leg lengths).
_STANCE = 0.125
#: Outward angle of the toes (degrees).
_TOES_OUT_DEG = 7.0
#: Softness of the limit of the pelvis's height (leg lengths).
_SOFTNESS = 0.004

#: Keys of each channel: time (s) and angle (degrees) or share of the leg length. Bending forward, lifting the arms,
#: flexing and motion to the person's left are positive.
Score: TypeAlias = Mapping[str, Sequence[tuple[float | int, float | int]]]
#: Position x, y of a standing body (leg lengths) and its heading (degrees), 0 facing −Y.
Stance: TypeAlias = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Step:
    """One step of a foot.

    Attributes:
        place: x, y of the ankle after the step (leg lengths), in the world.
        yaw_deg: heading of the foot after the step, without the toes' outward angle.
        detour: largest deviation from the straight line: outwards, backwards, upwards (leg lengths).
        toes_deg: largest downward pitch of the toes.
        weight: share of the weight that moves to the other foot.
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
    """Position of a foot of a body that stands at x, y (leg lengths) with this heading."""
    yaw, half = np.deg2rad(yaw_deg), _SIDES[side] * _STANCE
    return float(x + half * np.cos(yaw)), float(y + half * np.sin(yaw))


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Postures of one body over time, and the displacement of its pelvis from the rest pose (metres)."""

    times_s: Float[ndarray, " n"]
    postures: Float[ndarray, "n 20 3"]
    offsets: Float[ndarray, "n 3"]


def leg_length(body: Body) -> float:
    """Length of thigh and shin together (metres): the unit of lengths in scores."""
    return sum(_leg_bones(body))


def _leg_bones(body: Body) -> tuple[float, float]:
    rest = dict(zip(JOINT_INDEX, body.rest_heads[body.model.joint_bones], strict=True))
    thigh, shin = (
        float(np.mean([np.linalg.norm(rest[f"{s}{a}"] - rest[f"{s}{b}"]) for s in _SIDES]))
        for a, b in (("Hip", "Knee"), ("Knee", "Foot"))
    )
    return thigh, shin


def perform(
    dressed: DressedBody, times_s: Float[ndarray, " n"], score: Score, steps: Sequence[Step], start: Stance
) -> Motion:
    """The motion at any times (s); the body stands before the first and after the last step. The soles of the shoes
    stand on the floor.

    Args:
        score: channels drop, back, lean, bend, sway, twist, nod, look; out, forward, inward, elbow of both sides
            (.L, .R).
        steps: in order of time for each foot.
        start: stance before the first step.
    """
    body = dressed.body
    rest = dict(zip(JOINT_INDEX, body.rest_heads[body.model.joint_bones], strict=True))
    floor = dressed.pose(REST_POSTURE).lowest_m
    thigh, shin = _leg_bones(dressed.body)
    leg = thigh + shin
    channels = _channels(times_s, score)
    feet = {side: _foot_motion(side, steps, start, times_s) for side in _SIDES}
    heading = (feet["L"].yaw + feet["R"].yaw) / 2

    world = np.tile(np.eye(3), (len(times_s), len(POSTURE_INDEX), 1, 1))
    _pose_trunk(world, channels, heading)
    for side in _SIDES:
        _pose_arm(world, channels, side, rest)

    # The pelvis is above the feet, weighted by their loads, and as high as the legs allow.
    loads = feet["L"].load + feet["R"].load
    support = sum(foot.place * foot.load[:, None] for foot in feet.values()) / loads[:, None] * leg
    upright = _rotations("z", heading)
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
        height = np.sqrt(np.maximum((_LARGEST_REACH * leg) ** 2 - across**2, (0.3 * leg) ** 2))
        limits.append(ankles[side][:, 2] + height - hips[side][:, 2])
    softness = _SOFTNESS * leg
    pelvis[:, 2] = -softness * np.log(np.exp(-np.stack(limits) / softness).sum(0))

    for side, foot in feet.items():
        foot_yaw = foot.yaw + np.deg2rad(_SIDES[side] * _TOES_OUT_DEG)
        knees = np.einsum("nij,j->ni", _rotations("z", 0.6 * foot_yaw + 0.4 * heading), _FORWARD)
        reach = ankles[side] - pelvis - hips[side]
        thigh_to, shin_to = _bend_leg(reach, knees, thigh, shin)
        hinge = np.cross(knees, reach)
        for bone, (a, b), direction in (("thigh", ("Hip", "Knee"), thigh_to), ("shin", ("Knee", "Foot"), shin_to)):
            rest_frame = _limb_frame(rest[f"{side}{b}"] - rest[f"{side}{a}"], np.array([1.0, 0.0, 0.0]))
            world[:, POSTURE_INDEX[f"{bone}.{side}"]] = _limb_frame(direction, hinge) @ rest_frame.T
        world[:, POSTURE_INDEX[f"foot.{side}"]] = _rotations("z", foot_yaw) @ _rotations("x", foot.pitch)
    return Motion(times_s, local_rotations(world), pelvis - rest["Hip"])


def pose_sequence(dressed: DressedBody, motion: Motion) -> Iterator[PosedPerson]:
    """The person in every posture of a motion, at its position on the floor z = 0."""
    for posture, offset in zip(motion.postures, motion.offsets, strict=True):
        yield dressed.pose(posture).moved(np.eye(3), offset)


def _channels(times_s: Float[ndarray, " n"], score: Score) -> dict[str, Float[ndarray, " n"]]:
    channels: dict[str, ndarray] = {}
    for name, keys in score.items():
        key_times, values = np.array(keys, dtype=float).T
        clamped = np.clip(times_s, key_times[0], key_times[-1])
        # PCHIP does not overshoot, and its velocity is 0 at turning points.
        channels[name] = PchipInterpolator(
            np.r_[key_times[0] - 1, key_times, key_times[-1] + 1], np.r_[values[0], values, values[-1]]
        )(clamped)
    return channels


def _bump(s: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    return np.sin(np.pi * np.clip(s, 0, 1)) ** 2


@dataclasses.dataclass(eq=False)
class _Foot:
    """A foot over time: position of the ankle (leg lengths), heading, pitch (radians, toes down) and load (0–1)."""

    place: Float[ndarray, "n 3"]
    yaw: Float[ndarray, " n"]
    pitch: Float[ndarray, " n"]
    load: Float[ndarray, " n"]


def _foot_motion(side: str, steps: Sequence[Step], start: Stance, times_s: Float[ndarray, " n"]) -> _Foot:
    position, yaw_deg = np.array([*stand(side, *start), 0.0]), start[2]
    zero = np.zeros(len(times_s))
    foot = _Foot(np.tile(position, (len(times_s), 1)), zero + np.deg2rad(yaw_deg), zero.copy(), zero + 1)
    for step in (step for step in steps if step.side == side):
        s = (times_s - step.start_s) / (step.end_s - step.start_s)
        target = np.array([*step.place, 0.0])
        turn = np.deg2rad(step.yaw_deg - yaw_deg)
        foot.yaw += turn * smoothstep(s)
        x, y, z = step.detour
        detour = Rotation.from_rotvec([0, 0, np.deg2rad(step.yaw_deg)]).apply([_SIDES[side] * x, y, z])
        foot.place += (target - position) * smoothstep(s)[:, None] + detour * _bump(s)[:, None]
        foot.pitch += np.deg2rad(step.toes_deg) * _bump(s)
        # The weight moves to the other foot before this one is lifted.
        foot.load *= 1 - step.weight * _bump((s + 0.25) / 1.5)
        position, yaw_deg = target, step.yaw_deg
    return foot


def _rotations(axis: str, angles: Float[ndarray, " n"]) -> Float[ndarray, "n 3 3"]:
    return Rotation.from_euler(axis, angles[:, None]).as_matrix()


def _limb_frame(direction: Float[ndarray, "*n 3"], hinge: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3 3"]:
    """Orthonormal frame of a bone's direction and the component of its hinge axis perpendicular to it."""
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
    world[:, POSTURE_INDEX["pelvis"]] = _rotations("z", heading) @ _rotations("x", lean)
    parent = "pelvis"
    for bone, flexion, turn in (
        ("spine_low", bend / 3, twist / 3),
        ("spine_mid", bend / 3, twist / 3),
        ("spine_up", bend / 3, twist / 3),
        ("neck", nod / 2, look / 2),
        ("head", nod / 2, look / 2),
    ):
        local = _rotations("z", turn) @ _rotations("x", flexion)
        if bone.startswith("spine"):
            local = local @ _rotations("y", sway / 3)
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
    # Scapulohumeral rhythm: above the shoulder the clavicle takes a third of an arm's elevation; below, hardly any.
    raised = np.maximum(out, forward)
    rise = 0.16 * raised * smoothstep(raised / np.pi * 1.5)
    world[:, POSTURE_INDEX[f"clavicle.{side}"]] = chest @ _rotations("y", -sign * rise)
    arm = chest @ _rotations("x", -forward) @ _rotations("y", -sign * out) @ _rotations("z", -sign * inward) @ hanging
    fore = rest[f"{side}Hand"] - rest[f"{side}Elbow"]
    hinge = np.cross(upper, fore)  # the elbow is bent in the rest pose
    at_rest = np.arctan2(np.linalg.norm(hinge), upper @ fore)
    flexion = Rotation.from_rotvec((elbow - at_rest)[:, None] * hinge / np.linalg.norm(hinge)).as_matrix()
    world[:, POSTURE_INDEX[f"upper_arm.{side}"]] = arm
    world[:, POSTURE_INDEX[f"forearm.{side}"]] = arm @ flexion
    world[:, POSTURE_INDEX[f"hand.{side}"]] = arm @ flexion


def _bend_leg(
    reach: Float[ndarray, "n 3"], knees: Float[ndarray, "n 3"], thigh: float, shin: float
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3"]]:
    """Two-bone inverse kinematics: vectors of thigh and shin that span ``reach``, with the knee towards ``knees``."""
    length = np.linalg.norm(reach, axis=1, keepdims=True)
    along = reach / length
    front = knees - (knees * along).sum(1, keepdims=True) * along
    front = front / np.linalg.norm(front, axis=1, keepdims=True)
    length = np.clip(length, abs(thigh - shin) + 1e-6, (thigh + shin) * (1 - 1e-6))
    cos = np.clip((thigh**2 + length**2 - shin**2) / (2 * thigh * length), -1, 1)
    knee = thigh * (cos * along + np.sqrt(1 - cos**2) * front)
    return knee, length * along - knee
