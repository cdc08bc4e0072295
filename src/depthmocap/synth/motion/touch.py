"""Hands on the body: folded arms, hands on hips, in the lap, at the chin, behind the back.

People often touch themselves while they stand and talk, but rarely in motion capture, because that would hide markers.
Here inverse kinematics moves hands to random points of the skin.
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

#: Shares and regions of targets of the right hand; the left hand uses the mirrored regions.
_TARGET_REGIONS: tuple[tuple[float, tuple[str, ...]], ...] = (
    (0.22, ("belly R", "lower back R", "thigh R")),
    (0.15, ("belly R", "belly L", "chest R", "chest L")),
    (0.25, ("upper arm L", "elbow L", "forearm L", "wrist L", "hand L")),
    (0.12, ("face R", "face L", "hair R", "forehead", "neck front", "nape")),
    (0.1, ("chest L", "shoulder front L", "collar L", "shoulder front R", "collar R")),
    (0.08, ("lower back R",)),
    (0.08, ("thigh R", "thigh L", "knee R", "knee L", "shin R")),
)
#: Share of bodies with both hands behind the back. Without it, networks would learn that people with invisible hands
#: are seen from behind, because hands in front of the body are visible from the front.
_BEHIND_SHARE = 0.35
#: Index of the back in ``_TARGET_REGIONS``.
_BACK_INDEX = 5
#: Least backward component of the skin's normal at the back.
_LEAST_BACKWARD = 0.8
#: Largest number of targets that are tried for an arm.
_TRIES = 6
#: Largest distance from the wrist to the point of the palm that touches the target (metres).
_PALM_M = 0.09
#: Least and greatest height of the wrist above the skin (metres).
_WRIST_HEIGHT_M = (0.03, 0.09)
#: Half axes of the trunk's cross-section, sideways, forwards and backwards from the spine (metres); arms must not
#: intersect the trunk.
_TRUNK_HALF_AXES_M = 0.15, 0.1, 0.05


class BodySurface:
    """Centres of the triangles of the default body's skin, with normals and bones, and the targets of hands."""

    def __init__(self) -> None:
        model = BodyModel.load()
        self.body: Body = model.shape(Phenotype())
        corners = self.body.rest_vertices[model.faces].astype(np.float64)
        self.points = corners.mean(1)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        self.bones = model.skin_indices[model.faces[:, 0], 0]
        #: Bones of each arm from shoulder to wrist.
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
        places = [np.array([REGION[name] for name in names]) for _, names in _TARGET_REGIONS]
        #: Triangles of the targets by side of the hand; those of the back face backwards.
        self.faces = {
            side: [np.flatnonzero(np.isin(regions, MIRROR[place] if side == "L" else place)) for place in places]
            for side in "RL"
        }
        for faces in self.faces.values():
            faces[_BACK_INDEX] = faces[_BACK_INDEX][self.normals[faces[_BACK_INDEX], 1] > _LEAST_BACKWARD]


@functools.cache
def default_body_surface() -> BodySurface:
    """The surface of the default body; cached."""
    return BodySurface()


def hands_on_body(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture with one or both hands on the body, if they reach it and no arm intersects the trunk."""
    sides = ["R", "L"] if rng.random() < 0.5 else ["L", "R"]
    behind = rng.random() < _BEHIND_SHARE
    for side in sides[: 2 if behind or rng.random() < 0.6 else 1]:
        world, transforms = world_rotations(posture), default_body_surface().body.bone_transforms(posture)
        for _ in range(_TRIES):
            place = (
                _BACK_INDEX
                if behind
                else int(rng.choice(len(_TARGET_REGIONS), p=[share for share, _ in _TARGET_REGIONS]))
            )
            touching = _touch(posture, world.copy(), transforms, side, place, rng)
            if touching is not None and within_limits(touching[None])[0]:
                posture = touching
                break
    return posture


def _touch(
    posture: Float[ndarray, "20 3"],
    world: Float[ndarray, "20 3 3"],
    transforms: BoneTransforms,
    side: str,
    place: int,
    rng: np.random.Generator,
) -> Float[ndarray, "20 3"] | None:
    """The posture with a hand at a random point of a target region; None if it is out of reach or the arm would
    intersect the trunk. Changes ``world``, the world rotations of the posture."""
    skin = default_body_surface()
    face = int(rng.choice(skin.faces[side][place]))
    bone = skin.bones[face]
    normal = transforms.rotations[bone] @ skin.normals[face]
    point = transforms.rotations[bone] @ skin.points[face] + transforms.offsets[bone]
    shoulder = transforms.heads[skin.chain[side][0]]
    # Fingers point away from the elbow; as that is not known yet, away from the shoulder, along the skin.
    ahead = unit(perpendicular(point - shoulder + rng.normal(0, 0.1, 3), normal))
    target = point + normal * rng.uniform(*_WRIST_HEIGHT_M) - ahead * rng.uniform(0, _PALM_M)
    arm = Arm.reaching(transforms, skin, side, target)
    if arm is None:
        return None
    trunk = world[POSTURE_INDEX["spine_up"]]
    outward_sign = -1.0 if side == "R" else 1.0
    down, outwards = rng.uniform(0.2, 1), rng.uniform(0, 1.2)
    back = rng.uniform(0.2, 1) if place == _BACK_INDEX else rng.uniform(-0.3, 0.6)
    if not arm.bend(world, trunk @ np.array([outward_sign * outwards, back, -down])):
        return None
    hand = arm.bones[2]
    fingers = unit(world[hand] @ skin.fingers[side])
    world[hand] = rotation_between(fingers, perpendicular(fingers, normal) + 0.3 * fingers) @ world[hand]
    return arm.apply(posture, world)


@dataclasses.dataclass(frozen=True, eq=False)
class Arm:
    """An arm and the target of its wrist: current joints, ends of the trunk, and posture bones from the shoulder on."""

    shoulder: Float[ndarray, "3"]
    elbow: Float[ndarray, "3"]
    wrist: Float[ndarray, "3"]
    target: Float[ndarray, "3"]
    ends: Float[ndarray, "2 3"]
    bones: tuple[int, int, int]

    @classmethod
    def reaching(
        cls, transforms: BoneTransforms, skin: BodySurface, side: str, target: Float[ndarray, "3"]
    ) -> Arm | None:
        """An arm of the default body; None if the target is too far or too near."""
        shoulder, elbow, wrist = (transforms.heads[bone] for bone in skin.chain[side])
        upper, lower = np.linalg.norm(elbow - shoulder), np.linalg.norm(wrist - elbow)
        if not abs(upper - lower) + 0.05 < np.linalg.norm(target - shoulder) < 0.98 * (upper + lower):
            return None
        first, second, last = (POSTURE_INDEX[f"{name}.{side}"] for name in ("upper_arm", "forearm", "hand"))
        ends = transforms.heads[[skin.pelvis, skin.neck]]
        return cls(shoulder, elbow, wrist, target, ends, (first, second, last))

    def bend(self, world: Float[ndarray, "20 3 3"], towards: Float[ndarray, "3"]) -> bool:
        """Move the wrist to the target, in place, by two-bone inverse kinematics with the elbow in a direction. Returns
        False without changes if the arm would intersect the trunk."""
        upper, lower = np.linalg.norm(self.elbow - self.shoulder), np.linalg.norm(self.wrist - self.elbow)
        reach = self.target - self.shoulder
        distance = float(np.linalg.norm(reach))
        reach = reach / distance
        pole = unit(perpendicular(towards, reach))
        along = (upper**2 - lower**2 + distance**2) / (2 * distance)
        new_elbow = self.shoulder + reach * along + pole * np.sqrt(max(upper**2 - along**2, 0.0))
        trunk = world[POSTURE_INDEX["spine_up"]]
        if _crosses_trunk(np.stack([new_elbow, (new_elbow + self.target) / 2, self.target]), self.ends, trunk):
            return False
        first, second, last = self.bones
        carried = world[second].T @ world[last]
        world[first] = rotation_between(self.elbow - self.shoulder, new_elbow - self.shoulder) @ world[first]
        world[second] = rotation_between(self.wrist - self.elbow, self.target - new_elbow) @ world[second]
        world[last] = world[second] @ carried
        return True

    def apply(self, posture: Float[ndarray, "20 3"], world: Float[ndarray, "20 3 3"]) -> Float[ndarray, "20 3"]:
        """The posture with the arm's bones from world rotations."""
        out, bones = posture.copy(), list(self.bones)
        out[bones] = local_rotations(world)[bones]
        return out


def _crosses_trunk(points: Float[ndarray, "n 3"], ends: Float[ndarray, "2 3"], trunk: Float[ndarray, "3 3"]) -> bool:
    """Whether a point lies in a cylinder from pelvis to neck whose cross-section is two half ellipses."""
    axis = ends[1] - ends[0]
    share = ((points - ends[0]) @ axis) / (axis @ axis)
    aside, back, _ = ((points - ends[0] - share[:, None] * axis) @ trunk).T
    width, front, rear = _TRUNK_HALF_AXES_M
    inside = (aside / width) ** 2 + (back / np.where(back > 0, rear, front)) ** 2 < 1
    inside &= (share > 0) & (share < 1)
    return bool(inside.any())


def perpendicular(vector: Float[ndarray, "3"], axis: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    """The component of a vector perpendicular to a unit axis."""
    return vector - axis * (vector @ axis)
