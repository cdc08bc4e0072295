"""The body: where its joints and regions are, and that postures move it as they should."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.body.regions import MIRROR, REGION, REGION_NAMES
from depthmocap.body.skeleton import BONES, JOINT_INDEX
from depthmocap.body.skeleton import MIRROR as JOINT_MIRROR
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.bones import (
    POSTURE_BONES,
    POSTURE_INDEX,
    heading,
    local_rotations,
    mirror_posture,
    turn_posture,
    world_rotations,
)
from depthmocap.synth.body.mesh import REST_POSTURE, Body, BodyModel, Phenotype
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import render_body

FLIP_X = np.array([-1.0, 1.0, 1.0])


def random_posture(seed: int) -> np.ndarray:
    return PosturePrior.load().sample(np.random.default_rng(seed))[0]


def joint(joints: np.ndarray, name: str) -> np.ndarray:
    return joints[JOINT_INDEX[name]]


def volume(body: Body) -> float:
    corners = body.rest_vertices[body.model.faces].astype(np.float64)
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6


def region_areas(body: Body) -> np.ndarray:
    corners = body.rest_vertices[body.model.faces].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return np.bincount(body.model.face_regions, areas, minlength=len(REGION_NAMES))


def region_centre(body: Body, name: str) -> np.ndarray:
    faces = body.model.faces[body.model.face_regions == REGION[name]]
    return body.rest_vertices[faces].mean((0, 1))


# The rest pose


def test_joints_at_rest(default_body: Body) -> None:
    joints = default_body.pose(REST_POSTURE).joints
    assert joints.shape == (18, 3)
    low, high = default_body.rest_vertices.min(0), default_body.rest_vertices.max(0)
    assert ((joints > low) & (joints < high)).all()
    assert 1.5 < high[2] - low[2] < 2.0
    for name in ("Hip", "Knee", "Foot", "Shoulder", "Elbow", "Hand"):
        assert joint(joints, f"L{name}")[0] > 0.05
        np.testing.assert_allclose(joint(joints, f"L{name}"), joint(joints, f"R{name}") * FLIP_X, atol=2e-3)
    for column in (("Hip", "Spine", "Spine1", "Spine2", "Neck", "Head"), ("LFoot", "LKnee", "LHip")):
        heights = [joint(joints, name)[2] for name in column]
        assert heights == sorted(heights)
        assert np.diff(heights).min() > 0.05
    assert joint(joints, "LFoot")[2] - low[2] < 0.12
    assert high[2] - joint(joints, "Head")[2] < 0.25
    # It faces −Y: the toes are there, and so is the nose.
    foot = default_body.rest_vertices[default_body.rest_vertices[:, 2] < low[2] + 0.05]
    assert foot[:, 1].min() < joint(joints, "LFoot")[1] - 0.12
    assert foot[:, 1].max() < joint(joints, "LFoot")[1] + 0.1


def test_posing_at_rest_changes_nothing(default_body: Body) -> None:
    posed = default_body.pose(REST_POSTURE)
    np.testing.assert_allclose(posed.vertices, default_body.rest_vertices, atol=1e-5)


def test_faces_are_seen_from_outside(default_body: Body) -> None:
    assert 0.04 < volume(default_body) < 0.11  # cubic metres; negative were the faces inside out


def test_phenotypes(body_model: BodyModel, default_body: Body) -> None:
    def stature(phenotype: Phenotype) -> float:
        return float(np.ptp(body_model.shape(phenotype).rest_vertices[:, 2]))

    assert 0.6 < stature(Phenotype(age=0.3)) < stature(Phenotype(height=0.2)) < stature(Phenotype(height=0.8)) < 2.3
    light, heavy = (volume(body_model.shape(Phenotype(weight=weight))) for weight in (0.0, 1.0))
    assert light * 1.1 < volume(default_body) < heavy / 1.1


# Regions


def test_every_region_is_drawn_on_both_sides_alike(default_body: Body) -> None:
    regions = default_body.model.face_regions
    assert set(np.unique(regions)) == set(range(1, 44))
    areas = region_areas(default_body)
    np.testing.assert_allclose(areas[1:], areas[MIRROR[1:]], rtol=0.05)
    for name in REGION_NAMES[1:]:
        if name[-2:] in (" R", " L"):
            assert (region_centre(default_body, name)[0] > 0) == (name[-1] == "L"), name


@pytest.mark.parametrize("side", ["R", "L"])
def test_regions_follow_each_other_along_the_limbs(default_body: Body, side: str) -> None:
    joints = default_body.pose(REST_POSTURE).joints
    arm = [f"{part} {side}" for part in ("hand", "wrist", "forearm", "elbow", "upper arm", "shoulder front", "chest")]
    out = [abs(float(region_centre(default_body, name)[0])) for name in arm]
    assert out == sorted(out, reverse=True)
    column = [f"{part} {side}" for part in ("forefoot", "ankle", "shin", "knee", "thigh", "belly", "chest", "collar")]
    column += ["neck front", f"face {side}", "forehead"]
    heights = [float(region_centre(default_body, name)[2]) for name in column]
    assert heights == sorted(heights)
    # Joints lie in or beside the regions that are named after them.
    for name, region in (("Elbow", "elbow"), ("Knee", "knee"), ("Hand", "wrist"), ("Foot", "ankle")):
        gap = np.linalg.norm(joint(joints, side + name) - region_centre(default_body, f"{region} {side}"))
        assert gap < 0.06, region


def test_front_and_back(default_body: Body) -> None:
    pairs = (("chest", "upper back"), ("belly", "lower back"), ("shoulder front", "shoulder back"), ("face", "hair"))
    for (front, back), side in itertools.product(pairs, "RL"):
        front_y, back_y = (region_centre(default_body, f"{name} {side}")[1] for name in (front, back))
        assert front_y < back_y - 0.04
    assert region_centre(default_body, "neck front")[1] < region_centre(default_body, "nape")[1] - 0.08


# Postures


def test_local_and_world_rotations_are_inverse() -> None:
    rng = np.random.default_rng(0)
    postures = rng.uniform(-1.7, 1.7, (4, 3, 20, 3))
    world = world_rotations(postures)
    assert world.shape == (4, 3, 20, 3, 3)
    np.testing.assert_allclose(local_rotations(world), postures, atol=1e-9)
    # Along the chain from the pelvis: each turn is in the frame of the parent.
    thigh, shin = POSTURE_INDEX["thigh.L"], POSTURE_INDEX["shin.L"]
    chain = Rotation.identity()
    for bone in (POSTURE_INDEX["pelvis"], thigh, shin):
        chain = chain * Rotation.from_rotvec(postures[0, 0, bone])
    np.testing.assert_allclose(world[0, 0, shin], chain.as_matrix(), atol=1e-12)


def test_turn_and_heading() -> None:
    rng = np.random.default_rng(1)
    posture = rng.uniform(-0.5, 0.5, (20, 3))
    posture[0] = 0
    angles = rng.uniform(-np.pi, np.pi, 9)
    turned = turn_posture(np.repeat(posture[None], 9, 0), angles)
    np.testing.assert_allclose(heading(turned), angles, atol=1e-9)
    np.testing.assert_array_equal(turned[:, 1:], np.repeat(posture[None, 1:], 9, 0))
    # A leaning pelvis has the heading that is left when the lean is taken away.
    posture[0] = [0.4, 0, 0]
    assert heading(turn_posture(posture, 1.1)) == pytest.approx(1.1)


def test_turning_turns_the_body_about_the_pelvis(default_body: Body) -> None:
    posture = random_posture(0)
    joints = default_body.pose(posture).joints
    turned = default_body.pose(turn_posture(posture, 0.7)).joints
    pivot = joint(joints, "Hip")
    about_z = Rotation.from_euler("z", 0.7)
    np.testing.assert_allclose(turned, about_z.apply(joints - pivot) + pivot, atol=1e-6)


def test_mirrored_posture(default_body: Body) -> None:
    posture = random_posture(1)
    np.testing.assert_allclose(mirror_posture(mirror_posture(posture)), posture)
    assert mirror_posture(posture.astype(np.float32)).dtype == np.float32
    joints = default_body.pose(posture).joints
    mirrored = default_body.pose(mirror_posture(posture)).joints
    assert np.linalg.norm(joints - mirrored, axis=1).max() > 0.1  # not a symmetric posture
    np.testing.assert_allclose(mirrored, joints[JOINT_MIRROR] * FLIP_X, atol=5e-3)


@pytest.mark.parametrize("seed", range(3))
def test_mirrored_picture(default_body: Body, seed: int) -> None:
    posture = random_posture(10 + seed)
    width, height = 300, 260
    eye = np.array([1.5, -2.2, 0.6])
    pose, mirrored_pose = look_at(eye, np.zeros(3)), look_at(eye * FLIP_X, np.zeros(3))
    camera, mirrored_camera = (
        DepthCamera("c", width, height, 300.0, 300.0, (width - 1) / 2, 130.0, p) for p in (pose, mirrored_pose)
    )
    depth, labels = render_body(default_body.pose(posture), camera)
    mirrored_depth, mirrored_labels = render_body(default_body.pose(mirror_posture(posture)), mirrored_camera)
    mirrored_depth, mirrored_labels = mirrored_depth[:, ::-1], MIRROR[mirrored_labels[:, ::-1]]
    person = (labels > 0) | (mirrored_labels > 0)
    assert np.count_nonzero(person) > 3000
    assert (labels == mirrored_labels)[person].mean() > 0.97
    both = (labels > 0) & (mirrored_labels > 0)
    assert np.quantile(np.abs(depth - mirrored_depth)[both], 0.99) < 0.01


def test_bones_keep_their_lengths(default_body: Body) -> None:
    rest = default_body.pose(REST_POSTURE).joints
    # Bones of the drawn skeleton that are rigid parts of the body; the others span several of its bones.
    rigid = [(f"{side}{a}", f"{side}{b}") for side in "RL"
             for a, b in (("Hip", "Knee"), ("Knee", "Foot"), ("Shoulder", "Elbow"), ("Elbow", "Hand"))]  # fmt: skip
    assert set(rigid) < set(BONES)
    for seed in range(5):
        posed = default_body.pose(random_posture(20 + seed))
        for a, b in rigid:
            length = np.linalg.norm(joint(posed.joints, a) - joint(posed.joints, b))
            assert length == pytest.approx(np.linalg.norm(joint(rest, a) - joint(rest, b)), abs=1e-6)
        np.testing.assert_allclose(joint(posed.joints, "Hip"), joint(rest, "Hip"))


def test_bending_one_elbow_moves_one_arm(default_body: Body) -> None:
    posture = REST_POSTURE.copy()
    rest = default_body.pose(posture).joints
    upper, lower = joint(rest, "LElbow") - joint(rest, "LShoulder"), joint(rest, "LHand") - joint(rest, "LElbow")
    axis = np.cross(upper, lower)
    posture[POSTURE_INDEX["forearm.L"]] = axis / np.linalg.norm(axis) * 0.8
    bent = default_body.pose(posture)
    moved = {name for name, i in JOINT_INDEX.items() if np.linalg.norm(bent.joints[i] - rest[i]) > 1e-9}
    assert moved == {"LHand"}

    def angle(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))

    assert angle(upper, joint(bent.joints, "LHand") - joint(bent.joints, "LElbow")) == pytest.approx(
        angle(upper, lower) + 0.8
    )
    # The skin goes along, and the right half of the body stays.
    shift = np.linalg.norm(bent.vertices - default_body.rest_vertices, axis=1)
    faces, regions = default_body.model.faces, default_body.model.face_regions
    assert shift[faces[regions == REGION["hand L"]]].min() > 0.1
    assert shift[default_body.rest_vertices[:, 0] < 0].max() < 1e-4


def test_skin_is_the_weighted_mean_of_the_bones(default_body: Body) -> None:
    posture = random_posture(3)
    model = default_body.model
    rotations = world_rotations(posture)[model.posture_of_bone]
    heads = default_body.rest_heads.copy()
    for bones, parents in model.levels:
        for bone, parent in zip(bones, parents, strict=True):
            offset = default_body.rest_heads[bone] - default_body.rest_heads[parent]
            heads[bone] = heads[parent] + rotations[parent] @ offset
    some = np.arange(0, len(default_body.rest_vertices), 37)
    rest = default_body.rest_vertices[some].astype(np.float64)
    bones = model.skin_indices[some]
    moved = np.einsum("vkij,vkj->vki", rotations[bones], rest[:, None] - default_body.rest_heads[bones]) + heads[bones]
    expected = (model.skin_weights[some, :, None] * moved).sum(1)
    np.testing.assert_allclose(default_body.pose(posture).vertices[some], expected, atol=1e-5)
    np.testing.assert_allclose(model.skin_weights.sum(1), 1, atol=1e-5)


def test_every_posture_bone_moves_some_skin(default_body: Body) -> None:
    assert len(POSTURE_BONES) == len(set(default_body.model.posture_of_bone))
    for bone, i in POSTURE_INDEX.items():
        posture = REST_POSTURE.copy()
        posture[i] = [0.3, 0.2, 0.1]
        shift = np.linalg.norm(default_body.pose(posture).vertices - default_body.rest_vertices, axis=1)
        assert shift.max() > 0.02, bone
