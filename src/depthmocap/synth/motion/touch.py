"""Hands laid on the body: folded arms, hands on hips, in the lap, at the chin, behind the back.

People who stand and talk touch themselves all the time; people who perform for motion capture hardly do, since markers
would be hidden. So arms are bent towards a random point of the skin by inverse kinematics, as a variation of postures.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.regions import MIRROR, REGION
from depthmocap.geometry.transforms import rotation_between, unit
from depthmocap.synth.body.bones import POSTURE_INDEX, local_rotations, world_rotations
from depthmocap.synth.body.mesh import Body, BodyModel, BoneTransforms, Phenotype
from depthmocap.synth.motion.limits import within_limits

#: Where hands go and how often: regions of the right hand's own side and of the other (R and L exchanged for the left).
_PLACES: tuple[tuple[float, tuple[str, ...]], ...] = (
    (0.22, ("belly R", "lower back R", "thigh R")),
    (0.15, ("belly R", "belly L", "chest R", "chest L")),
    (0.25, ("upper arm L", "elbow L", "forearm L", "wrist L", "hand L")),
    (0.12, ("face R", "face L", "hair R", "forehead", "neck front", "nape")),
    (0.1, ("chest L", "shoulder front L", "collar L", "shoulder front R", "collar R")),
    (0.08, ("lower back R",)),
    (0.08, ("thigh R", "thigh L", "knee R", "knee L", "shin R")),
)
#: Share of bodies that hold both hands behind their back. Without it hands that nobody sees would tell a network that
#: somebody is seen from behind: from in front the hands before the body are seen.
_BEHIND = 0.35
#: Where those are, in the places' order.
_BACK = 5
#: There the skin's normal has at least so much of the backward direction.
_BACKWARDS = 0.8
#: Targets tried for an arm before it is left as it was.
_TRIES = 6
#: The palm lies between the wrist and this far beyond it (metres), and the wrist so far above the skin.
_PALM_M, _ABOVE_M = 0.09, (0.03, 0.09)
#: Half axes (metres) of the trunk, which arms do not pass through: to the sides, forwards and backwards of the spine.
_TRUNK_M = 0.15, 0.1, 0.05


class Skin:
    """Points of the default body's skin, by region, with their normals and the posture bones that carry them."""

    def __init__(self) -> None:
        model = BodyModel.load()
        self.body: Body = model.shape(Phenotype())
        corners = self.body.rest_vertices[model.faces].astype(np.float64)
        self.points = corners.mean(1)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        self.bones = model.skin_indices[model.faces[:, 0], 0]
        #: Bones of the arms, from the shoulder on.
        self.chain = {
            side: [model.bone_names.index(f"{bone}.{side}") for bone in ("upperarm01", "lowerarm01", "wrist")]
            for side in "RL"
        }
        self.fingers = {
            side: self.body.rest_heads[model.bone_names.index(f"finger3-1.{side}")] - self.body.rest_heads[wrist]
            for side, (_, _, wrist) in self.chain.items()
        }
        self.forearms = {
            side: self.body.rest_heads[wrist] - self.body.rest_heads[elbow]
            for side, (_, elbow, wrist) in self.chain.items()
        }
        self.pelvis, self.neck = (model.bone_names.index(bone) for bone in ("root", "neck01"))
        regions = np.asarray(model.face_regions)
        places = [np.array([REGION[name] for name in names]) for _, names in _PLACES]
        #: Triangles of every place, for the hand of a side; of the back those that face backwards, not the flanks.
        self.faces = {
            side: [np.flatnonzero(np.isin(regions, MIRROR[place] if side == "L" else place)) for place in places]
            for side in "RL"
        }
        for faces in self.faces.values():
            faces[_BACK] = faces[_BACK][self.normals[faces[_BACK], 1] > _BACKWARDS]


@functools.cache
def default_skin() -> Skin:
    """The default body's, made once a process."""
    return Skin()


def hands_on_body(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture with one or both hands on the body, where they reach it and no arm passes through the trunk."""
    sides = ["R", "L"] if rng.random() < 0.5 else ["L", "R"]
    behind = rng.random() < _BEHIND
    for side in sides[: 2 if behind or rng.random() < 0.6 else 1]:
        world, moved = world_rotations(posture), default_skin().body.bone_transforms(posture)
        for _ in range(_TRIES):
            place = _BACK if behind else int(rng.choice(len(_PLACES), p=[share for share, _ in _PLACES]))
            touching = _touch(posture, world.copy(), moved, side, place, rng)
            if touching is not None and within_limits(touching[None])[0]:
                posture = touching
                break
    return posture


def _touch(
    posture: Float[ndarray, "20 3"],
    world: Float[ndarray, "20 3 3"],
    moved: BoneTransforms,
    side: str,
    place: int,
    rng: np.random.Generator,
) -> Float[ndarray, "20 3"] | None:
    """One arm bent towards a random point of a place's skin; None where it does not reach or would pass through the
    trunk. ``world``, the rotations of the posture, is changed."""
    skin = default_skin()
    face = int(rng.choice(skin.faces[side][place]))
    bone = skin.bones[face]
    normal = moved.rotations[bone] @ skin.normals[face]
    point = moved.rotations[bone] @ skin.points[face] + moved.offsets[bone]
    shoulder = moved.heads[skin.chain[side][0]]
    # The fingers point away from the elbow, which is not known yet: about away from the shoulder, along the skin.
    ahead = unit(across(point - shoulder + rng.normal(0, 0.1, 3), normal))
    target = point + normal * rng.uniform(*_ABOVE_M) - ahead * rng.uniform(0, _PALM_M)
    arm = Arm.reaching(moved, skin, side, target)
    if arm is None:
        return None
    trunk = world[POSTURE_INDEX["spine_up"]]
    out = -1.0 if side == "R" else 1.0
    down, outwards = rng.uniform(0.2, 1), rng.uniform(0, 1.2)
    back = rng.uniform(0.2, 1) if place == _BACK else rng.uniform(-0.3, 0.6)
    if not arm.bend(world, trunk @ np.array([out * outwards, back, -down])):
        return None
    hand = arm.bones[2]
    fingers = unit(world[hand] @ skin.fingers[side])
    world[hand] = rotation_between(fingers, across(fingers, normal) + 0.3 * fingers) @ world[hand]
    return arm.taken_over(posture, world)


@dataclasses.dataclass(frozen=True, eq=False)
class Arm:
    """An arm that shall bring its wrist to a point: where it is now, and its posture bones from the shoulder on."""

    shoulder: Float[ndarray, "3"]
    elbow: Float[ndarray, "3"]
    wrist: Float[ndarray, "3"]
    target: Float[ndarray, "3"]
    ends: Float[ndarray, "2 3"]
    bones: tuple[int, int, int]

    @classmethod
    def reaching(cls, moved: BoneTransforms, skin: Skin, side: str, target: Float[ndarray, "3"]) -> Arm | None:
        """An arm of the default body; None where the point is too far away or too near."""
        shoulder, elbow, wrist = (moved.heads[bone] for bone in skin.chain[side])
        upper, lower = np.linalg.norm(elbow - shoulder), np.linalg.norm(wrist - elbow)
        if not abs(upper - lower) + 0.05 < np.linalg.norm(target - shoulder) < 0.98 * (upper + lower):
            return None
        first, second, last = (POSTURE_INDEX[f"{name}.{side}"] for name in ("upper_arm", "forearm", "hand"))
        ends = moved.heads[[skin.pelvis, skin.neck]]
        return cls(shoulder, elbow, wrist, target, ends, (first, second, last))

    def bend(self, world: Float[ndarray, "20 3 3"], towards: Float[ndarray, "3"]) -> bool:
        """Turn upper arm and forearm, in place, the elbow in a direction; the hand goes with them. False, with nothing
        done, where the arm would pass through the trunk."""
        upper, lower = np.linalg.norm(self.elbow - self.shoulder), np.linalg.norm(self.wrist - self.elbow)
        reach = self.target - self.shoulder
        distance = float(np.linalg.norm(reach))
        reach = reach / distance
        pole = unit(across(towards, reach))
        along = (upper**2 - lower**2 + distance**2) / (2 * distance)
        bent = self.shoulder + reach * along + pole * np.sqrt(max(upper**2 - along**2, 0.0))
        trunk = world[POSTURE_INDEX["spine_up"]]
        if _through_trunk(np.stack([bent, (bent + self.target) / 2, self.target]), self.ends, trunk):
            return False
        first, second, last = self.bones
        carried = world[second].T @ world[last]
        world[first] = rotation_between(self.elbow - self.shoulder, bent - self.shoulder) @ world[first]
        world[second] = rotation_between(self.wrist - self.elbow, self.target - bent) @ world[second]
        world[last] = world[second] @ carried
        return True

    def taken_over(self, posture: Float[ndarray, "20 3"], world: Float[ndarray, "20 3 3"]) -> Float[ndarray, "20 3"]:
        """The posture with this arm of the world's rotations."""
        out, bones = posture.copy(), list(self.bones)
        out[bones] = local_rotations(world)[bones]
        return out


def _through_trunk(points: Float[ndarray, "n 3"], ends: Float[ndarray, "2 3"], trunk: Float[ndarray, "3 3"]) -> bool:
    """Whether a point lies in a cylinder from the pelvis to the neck, of a half ellipse before and one behind."""
    axis = ends[1] - ends[0]
    share = ((points - ends[0]) @ axis) / (axis @ axis)
    aside, back, _ = ((points - ends[0] - share[:, None] * axis) @ trunk).T
    width, before, behind = _TRUNK_M
    inside = (aside / width) ** 2 + (back / np.where(back > 0, behind, before)) ** 2 < 1
    inside &= (share > 0) & (share < 1)
    return bool(inside.any())


def across(vector: Float[ndarray, "3"], axis: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    """The part of a vector that is at a right angle to a unit axis."""
    return vector - axis * (vector @ axis)
