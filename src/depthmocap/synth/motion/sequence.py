"""A procedural motion: stand, turn around on the spot, walk, raise the arms, bend, squat, reach and kick.

The score below gives the trunk and the arms as angles over time, and the feet as a list of steps. Feet that carry the
body are nailed to the floor: the legs follow from the pelvis and the ankles by two-bone inverse kinematics, so that
nothing slides or floats whatever the build of the body is. All curves are continuous in velocity.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from depthmocap.body.model import REST_POSTURE
from depthmocap.body.posture import POSTURE_INDEX, local_rotations
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry.transforms import rotation_between
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import PosedPerson

#: Length of the demo motion.
DEMO_SECONDS = 9.8

_SIDES = {"L": 1.0, "R": -1.0}  # the side's sign along +X
_FORWARD = np.array([0.0, -1.0, 0.0])
_DOWN = np.array([0.0, 0.0, -1.0])
#: Legs are never straighter than this share of their length: the knee would snap, and standing knees are soft.
_REACH = 0.996
#: Half the distance between the ankles of a relaxed stance (leg lengths), and how far the toes point out.
_STANCE, _TOES_OUT_DEG = 0.125, 7.0
#: Softness (leg lengths) of the limit that the legs put on the pelvis's height.
_SOFT = 0.004

_Keys = list[tuple[float, float]]

#: Angles (degrees) and shares of the leg length at times (s). Bending forward, lifting the arms and flexing are
#: positive, and so is what goes to the person's left.
_SCORE: dict[str, _Keys] = {
    "drop": [(6.55, 0), (7.1, 0.05), (7.35, 0.1), (7.75, 0.26), (8.3, 0)],
    "back": [(6.55, 0), (7.1, 0.13), (7.35, 0.13), (7.75, 0.12), (8.3, 0)],
    "lean": [(3.3, 0), (3.7, 4), (4.4, 4), (4.9, 0), (6.55, 0), (7.1, 40), (7.35, 37), (7.75, 18), (8.3, 0), (9.0, 0),
             (9.36, -5), (9.7, 0)],
    "bend": [(0, 3), (4.8, 3), (5.45, -7), (5.8, -7), (6.55, 3), (7.1, 46), (7.35, 42), (7.75, 18), (8.3, 3), (9.0, 3),
             (9.36, 10), (9.7, 3)],
    "sway": [(8.1, 0), (8.55, 7), (8.7, 7), (9.1, 0)],
    "twist": [(0.3, 0), (0.9, 14), (2.6, 14), (3.35, 0), (3.7, -5), (4.05, 5), (4.5, 0), (8.1, 0), (8.55, 14),
              (8.7, 14), (9.1, 0)],
    "nod": [(0, 2), (4.8, 2), (5.45, -12), (5.8, -12), (6.55, 2), (7.1, 14), (7.35, 12), (7.75, -12), (8.3, 2)],
    "look": [(0.2, 0), (0.7, 24), (2.5, 22), (3.3, 0), (8.1, 0), (8.55, 8), (8.7, 8), (9.1, 0)],
    "out.L": [(0, 9), (4.4, 9), (5.0, 86), (5.15, 91), (5.6, 163), (5.75, 163), (6.2, 90), (6.65, 10), (7.1, 6),
              (7.35, 8), (7.75, 16), (8.3, 9), (9.0, 9), (9.36, 24), (9.75, 9)],
    "out.R": [(0, 9), (4.4, 9), (5.03, 86), (5.18, 91), (5.63, 163), (5.77, 163), (6.22, 90), (6.65, 10), (7.1, 6),
              (7.35, 8), (7.75, 16), (8.15, 10), (8.55, 20), (8.7, 20), (9.2, 9), (9.4, 15), (9.75, 9)],
    "forward.L": [(0, 4), (0.7, -8), (1.4, 10), (2.1, -8), (2.8, 10), (3.3, 0), (3.65, -14), (4.05, 20), (4.4, 4),
                  (6.55, 4), (7.1, 76), (7.35, 74), (7.75, 74), (8.3, 4), (9.0, 4), (9.36, 22), (9.75, 4)],
    "forward.R": [(0, 4), (0.7, 10), (1.4, -8), (2.1, 10), (2.8, -8), (3.3, 4), (3.65, 20), (4.05, -12), (4.4, 4),
                  (6.55, 4), (7.1, 76), (7.35, 74), (7.75, 74), (8.1, 35), (8.6, 112), (8.7, 112), (9.35, -10),
                  (9.75, 4)],
    "inward.L": [(4.5, 25), (5.6, -40), (5.75, -40), (6.6, 25)],
    "inward.R": [(4.5, 25), (5.6, -40), (5.75, -40), (6.6, 25)],
    "elbow.L": [(0, 10), (0.7, 22), (2.8, 22), (3.3, 14), (4.05, 24), (4.5, 10), (5.1, 3), (5.75, 12), (6.65, 10),
                (7.1, 4), (7.75, 12), (8.3, 10), (9.0, 10), (9.36, 20), (9.75, 10)],
    "elbow.R": [(0, 10), (0.7, 22), (2.8, 22), (3.65, 26), (4.5, 10), (5.1, 3), (5.75, 12), (6.65, 10), (7.1, 4),
                (7.75, 12), (8.1, 34), (8.55, 4), (8.7, 4), (9.1, 24), (9.75, 10)],
}  # fmt: skip
#: Where the person starts and goes to (leg lengths), along y: forward is −Y.
_START_Y, _END_Y = 0.6, -0.26


@dataclasses.dataclass(frozen=True)
class _Step:
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


def _stand(side: str, x: float, y: float, yaw_deg: float = 0.0) -> tuple[float, float]:
    """Where a foot stands when the middle of a body with this heading is over a place."""
    yaw, half = np.deg2rad(yaw_deg), _SIDES[side] * _STANCE
    return float(x + half * np.cos(yaw)), float(y + half * np.sin(yaw))


def _demo_steps() -> list[_Step]:
    steps = []
    yaws = (50.0, 72.0, 122.0, 144.0, 194.0, 216.0, 266.0, 288.0, 330.0, 360.0, 360.0)
    for i, yaw in enumerate(yaws):
        side, start = "LR"[i % 2], 0.4 + 0.26 * i
        steps.append(_Step(side, start, start + 0.26, _stand(side, 0.0, _START_Y, yaw), yaw))
    walk = [("R", 3.35, 0.26), ("L", 3.67, -0.02), ("R", 3.99, _END_Y), ("L", 4.31, _END_Y)]
    steps.extend(
        _Step(side, start, start + 0.32, _stand(side, 0.0, y), 360.0, (0.0, 0.0, 0.1), 18.0, 0.4)
        for side, start, y in walk
    )
    steps.append(_Step("L", 8.0, 8.36, _stand("L", 0.28, _END_Y), 360.0))
    steps.append(_Step("L", 8.64, 9.0, _stand("L", 0.0, _END_Y), 360.0))
    steps.append(_Step("R", 9.02, 9.7, _stand("R", 0.0, _END_Y), 360.0, (0.05, -0.5, 0.3), -8.0, 0.9))
    return steps


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Postures of one body over time, and how far its pelvis is then from where it is at rest (metres)."""

    times_s: Float[ndarray, " n"]
    postures: Float[ndarray, "n 20 3"]
    offsets: Float[ndarray, "n 3"]


def demo_motion(dressed: DressedBody, times_s: Float[ndarray, " n"]) -> Motion:
    """The demo motion at any times (s) of 0 to ``DEMO_SECONDS``, for a body that turns behind the origin, steps
    forward and faces −Y for the rest; before and after, it stands. The feet are placed with the bones of this body,
    the soles of its shoes on the floor."""
    body = dressed.body
    rest = dict(zip(JOINT_INDEX, body.rest_heads[body.model.joint_bones], strict=True))
    floor = dressed.pose(REST_POSTURE).lowest_m
    thigh, shin = (
        float(np.mean([np.linalg.norm(rest[f"{s}{a}"] - rest[f"{s}{b}"]) for s in _SIDES]))
        for a, b in (("Hip", "Knee"), ("Knee", "Foot"))
    )
    leg = thigh + shin
    channels = _channels(times_s)
    steps = _demo_steps()
    feet = {side: _walk(side, steps, times_s) for side in _SIDES}
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


def _channels(times_s: Float[ndarray, " n"]) -> dict[str, Float[ndarray, " n"]]:
    channels: dict[str, ndarray] = {}
    for name, keys in _SCORE.items():
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


def _walk(side: str, steps: Sequence[_Step], times_s: Float[ndarray, " n"]) -> _Foot:
    here, yaw_deg = np.array([*_stand(side, 0.0, _START_Y), 0.0]), 0.0
    zero = np.zeros(len(times_s))
    foot = _Foot(np.tile(here, (len(times_s), 1)), zero.copy(), zero.copy(), zero + 1)
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
