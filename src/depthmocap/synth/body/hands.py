"""Hand poses: open, relaxed, fist, pointing. The pose of a hand is constant; it is part of a body's shape.

Every bone of a hand turns with the wrist, so that fingers can be bent once, in the rest pose, and skinned by the wrist
alone afterwards: no posture needs to tell more than the wrist."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.geometry.transforms import unit
from depthmocap.kernels.skin import skin
from depthmocap.synth.body.mesh import Body, BodyModel

#: Bends of the three bones of a finger in a fist, and of a thumb (radians), away from the mesh's rest pose, in which
#: fingers are nearly straight.
_FIST = np.radians([80.0, 95.0, 55.0])
_THUMB_FIST = np.radians([45.0, 25.0, 40.0])
#: How far each finger takes part in a spread: away from the little finger is positive.
_SPREAD = np.array([0.0, 1.0, 0.25, -0.5, -1.0])


@dataclasses.dataclass(frozen=True)
class Grip:
    """What a hand does.

    Attributes:
        curls: of thumb, index, middle, ring and little finger: 0 as in the rest pose, 1 in a fist, negative stretched.
        spread_rad: between neighbouring fingers, beyond the rest pose.
    """

    curls: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    spread_rad: float = 0.0


def random_grip(rng: np.random.Generator) -> Grip:
    """A relaxed hand, a fist, a flat or a pointing one."""
    kind = rng.choice(4, p=[0.4, 0.3, 0.25, 0.05])
    curl = rng.uniform(*((0.1, 0.6), (0.7, 1.0), (-0.2, 0.1), (0.7, 1.0))[kind])
    # Relaxed fingers bend more, the nearer they are to the little one.
    fingers = curl * np.linspace(0.75, 1.15, 4) if kind == 0 else np.full(4, curl)
    fingers = np.clip(fingers + rng.normal(0, 0.06, 4), -0.2, 1)
    if kind == 3:
        fingers[0] = rng.uniform(-0.2, 0.1)
    thumb = float(curl * rng.uniform(0.3, 1.0))
    # At rest the mesh's fingers are spread.
    spread = rng.uniform(-0.25, 0.2) if kind == 2 else rng.uniform(-0.2, 0.0)
    index, middle, ring, little = map(float, fingers)
    return Grip((thumb, index, middle, ring, little), float(spread))


def with_hands(body: Body, right: Grip, left: Grip) -> Body:
    """The body with other hands; its skeleton is the same, since fingers are no joints of it."""
    model = body.model
    rotations = np.tile(np.eye(3), (len(model.bone_names), 1, 1))
    heads = body.rest_heads.copy()
    for side, grip in (("R", right), ("L", left)):
        _bend(model, body.rest_heads, side, grip, rotations, heads)
    offsets = heads - np.einsum("bij,bj->bi", rotations, body.rest_heads)
    vertices, touched = body.rest_vertices.copy(), _finger_vertices(model)
    moved = np.empty((len(touched), 3), vertices.dtype)
    skin(
        vertices[touched], model.skin_indices[touched], model.skin_weights[touched],
        rotations.astype(np.float32), offsets.astype(np.float32), moved,
    )  # fmt: skip
    vertices[touched] = moved
    return body.with_vertices(vertices)


@functools.lru_cache(maxsize=1)
def _finger_vertices(model: BodyModel) -> Int[ndarray, "n"]:
    """The vertices that fingers move."""
    fingers = [i for i, name in enumerate(model.bone_names) if name.startswith("finger")]
    return np.flatnonzero((np.isin(model.skin_indices, fingers) & (model.skin_weights > 0)).any(1))


def _bend(
    model: BodyModel,
    rest: Float[ndarray, "b 3"],
    side: str,
    grip: Grip,
    rotations: Float[ndarray, "b 3 3"],
    heads: Float[ndarray, "b 3"],
) -> None:
    """Rotations of the finger bones of a hand away from rest, and where their heads then are."""
    fingers, wrist_bone = _finger_bones(model, side)
    wrist = rest[wrist_bone]
    along = unit(rest[fingers[2, 0]] - wrist)
    across = unit(rest[fingers[4, 0]] - rest[fingers[1, 0]])
    # Out of the palm: the side that the thumb's tip is on.
    palm = unit(np.cross(along, across))
    palm *= np.sign(palm @ (rest[fingers[0, 2]] - rest[fingers[1, 0]]))
    apart = palm * -np.sign(np.cross(palm, along) @ across)
    # The thumb closes over the middle of the bent fingers.
    target = rest[fingers[2, 0]] + palm * np.linalg.norm(rest[fingers[2, 1]] - rest[fingers[2, 0]])
    directions = rest[fingers[:, 2]] - rest[fingers[:, 0]]
    towards = np.concatenate([(target - rest[fingers[0, 0]])[None], np.tile(palm, (4, 1))])
    axes = np.cross(directions, towards)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.stack([_THUMB_FIST, *[_FIST] * 4]) * np.array(grip.curls)[:, None]
    # All rotations at once: the spread of each finger, then the bends of its three bones.
    vectors = np.concatenate(
        [apart * grip.spread_rad * _SPREAD[:, None], (axes[:, None] * angles[..., None]).reshape(-1, 3)]
    )
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    turn, bends, head = matrices[:5], matrices[5:].reshape(5, 3, 3, 3), rest[fingers[:, 0]]
    for j in range(3):
        turn = turn @ bends[:, j]
        rotations[fingers[:, j]], heads[fingers[:, j]] = turn, head
        if j < 2:
            head = head + np.einsum("fij,fj->fi", turn, rest[fingers[:, j + 1]] - rest[fingers[:, j]])


@functools.lru_cache(maxsize=2)
def _finger_bones(model: BodyModel, side: str) -> tuple[Int[ndarray, "5 3"], int]:
    """The bones of a hand's fingers, from the thumb on, and of its wrist."""
    names = model.bone_names
    fingers = [[names.index(f"finger{i}-{j}.{side}") for j in (1, 2, 3)] for i in range(1, 6)]
    return np.array(fingers), names.index(f"wrist.{side}")
