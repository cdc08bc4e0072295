"""Random scenes: where things may be, what they hide, and what the labels say of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.people.garments import clothe
from depthmocap.synth.people.wardrobe import Clothes, Garment
from depthmocap.synth.render import Layer, Material, PosedPerson, render_person
from depthmocap.synth.scenes import furniture
from depthmocap.synth.scenes.furniture import AGAINST_WALLS, FREE_STANDING, yaw
from depthmocap.synth.scenes.objects import held_object
from depthmocap.synth.scenes.placing import CAMERA_CLEARANCE_M
from depthmocap.synth.scenes.scene import (
    FULL,
    OFF,
    TRAINING,
    Scene,
    SceneSettings,
    random_scene,
    render_scene,
)
from depthmocap.synth.scenes.solids import NONE, join, shell
from depthmocap.synth.scenes.worn import worn_object

HIP = JOINT_INDEX["Hip"]
SEEDS = range(12)


@pytest.fixture(scope="module")
def people(default_body: Body) -> list[PosedPerson]:
    rng = np.random.default_rng(5)
    prior = PosturePrior.load()
    posed = [PosedPerson(default_body.pose(prior.sample(rng)[0])) for _ in SEEDS]
    # One of them wears something wide.
    coat = Layer(posed[0].vertices + np.float32(0.05), posed[0].body.faces, Material.CLOTH)
    return [PosedPerson(posed[0].body, (coat,)), *posed[1:]]


def cameras_around(person: PosedPerson, rng: np.random.Generator, count: int = 3) -> list[DepthCamera]:
    cameras = []
    for i in range(count):
        azimuth, distance = rng.uniform(-np.pi, np.pi), rng.uniform(1.5, 4)
        floor = person.vertices[:, 2].min()
        ground = person.joints[HIP, :2] + distance * np.array([np.cos(azimuth), np.sin(azimuth)])
        eye = np.array([*ground, floor + rng.uniform(0.4, 2.6)])
        cameras.append(
            DepthCamera(f"Cam{i}", 128, 106, 92.0, 92.0, 63.5, 52.5, look_at(eye, person.joints[HIP].astype(float)))
        )
    return cameras


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    person: PosedPerson
    cameras: list[DepthCamera]
    settings: SceneSettings
    scene: Scene


@pytest.fixture(scope="module")
def cases(people: list[PosedPerson]) -> list[Case]:
    crowded = dataclasses.replace(FULL, furniture=(8, 14), second_person=0.7, held_object=0.6, worn_object=0.6)
    loose = dataclasses.replace(TRAINING, furniture=(1, 4), second_person=0.5, held_object=0.8, worn_object=0.8)
    made = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        person, settings = people[seed], (crowded, loose)[seed % 3 == 2]
        cameras = cameras_around(person, rng)
        scene = random_scene(rng, person, cameras, settings, people[(seed + 1) % len(people)])
        made.append(Case(person, cameras, settings, scene))
    assert sum(len(case.scene.shell) for case in made) == 8
    assert sum(case.scene.second is not None for case in made) > 3
    assert sum(len(case.scene.objects) > 0 for case in made) > 5
    return made


def eyes_of(case: Case) -> np.ndarray:
    return np.stack([c.world_from_camera[:3, 3] for c in case.cameras])


def skin_and_clothes(person: PosedPerson) -> np.ndarray:
    return np.concatenate([person.vertices, *(layer.vertices for layer in person.layers)]).astype(float)


def test_furniture_touches_nobody(cases: list[Case]) -> None:
    for case in cases:
        assert len(case.scene.furniture) > 0
        assert not case.scene.furniture.hold_any(skin_and_clothes(case.person))
        if case.scene.second is not None:
            assert not case.scene.furniture.hold_any(skin_and_clothes(case.scene.second))


def test_nothing_stands_before_a_lens(cases: list[Case]) -> None:
    for case in cases:
        for solids in (case.scene.furniture, case.scene.objects):
            assert not solids.grown(CAMERA_CLEARANCE_M - 1e-6).hold_any(eyes_of(case))


def test_people_stand_apart_on_the_same_floor(cases: list[Case]) -> None:
    found = 0
    for case in cases:
        second = case.scene.second
        if second is None:
            continue
        found += 1
        mine, theirs = skin_and_clothes(case.person), skin_and_clothes(second)
        assert theirs[:, 2].min() == pytest.approx(mine[:, 2].min(), abs=1e-5)
        # Some upright plane has all of one before it and all of the other behind it.
        angles = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
        directions = np.stack([np.cos(angles), np.sin(angles)])
        ground = [points[ConvexHull(points[:, :2]).vertices, :2] @ directions for points in (mine, theirs)]
        assert (ground[1].min(0) > ground[0].max(0)).any()
        distance = np.linalg.norm((second.joints - case.person.joints)[HIP, :2])
        assert 0.4 <= distance < 3.0
    assert found > 3


def test_the_room_encloses_people_and_cameras(cases: list[Case]) -> None:
    for case in cases:
        scene = case.scene
        if not len(scene.shell):
            assert scene.contains(np.array([100.0, 0.0, 0.0]))
            continue
        floor = skin_and_clothes(case.person)[:, 2].min()
        assert scene.shell.corners[..., 2].min() == pytest.approx(floor, abs=1e-6)
        assert all(scene.contains(eye) for eye in eyes_of(case))
        away = case.person.joints[HIP] + np.array([30.0, 0, 0])
        assert not scene.contains(away)
        outside = DepthCamera("out", 8, 8, 9.0, 9.0, 3.5, 3.5, look_at(away.astype(float), np.zeros(3)))
        with pytest.raises(ValueError, match=r"'out' .* inside the room"):
            render_scene(scene, outside)
        # Furniture is within the walls, and a wall is no nearer than asked.
        walls = scene.shell.grown(0.015)  # round ends have square corners
        assert all(walls.hold_any(corner[None]) for corner in scene.furniture.corners.reshape(-1, 3))
        corners = scene.shell.corners[0]
        hip, nearest = case.person.joints[HIP], case.settings.walls_m[0]
        for axis in scene.shell.frames[0, :2, :2].T:
            axis = axis / np.linalg.norm(axis)
            along = (corners[:, :2] - hip[:2]) @ axis
            assert along.max() > nearest - 1e-6 and along.min() < -nearest + 1e-6


def test_the_person_stays_in_sight(cases: list[Case]) -> None:
    for case in cases:
        hidden = case.scene.solids.hide(eyes_of(case), case.person.joints)
        if len(case.scene.shell):  # the walls are behind everything
            assert not case.scene.shell.hide(eyes_of(case), case.person.joints).any()
        seen = 1 - hidden.mean(1)
        assert seen.max() >= case.settings.seen_by_one
        assert seen.min() >= case.settings.seen_by_each


def test_a_scene_only_ever_takes_pixels_from_the_person(cases: list[Case]) -> None:
    taken = 0
    for case in cases:
        for camera in case.cameras:
            alone = render_person(case.person, camera)
            background, material = render_scene(case.scene, camera)
            assert (background.dtype, material.dtype) == (np.float32, np.uint8)
            np.testing.assert_array_equal(background > 0, material > 0)
            assert set(np.unique(material)) <= {0, Material.SCENE, Material.OBJECT, Material.SECOND_PERSON}
            rendering = render_person(case.person, camera, background, material)
            assert not (rendering.person & ~alone.person).any()
            taken += int((alone.person & ~rendering.person).sum())
            assert not rendering.labels[~rendering.person].any()
            kept = rendering.person
            np.testing.assert_array_equal(rendering.depth_m[kept], alone.depth_m[kept])
            np.testing.assert_array_equal(rendering.depth_m[~kept], background[~kept])
            np.testing.assert_array_equal(rendering.material[~kept], material[~kept])
            if len(case.scene.shell):
                assert (background > 0).all()
    assert taken > 500


def test_the_same_seed_gives_the_same_scene(people: list[PosedPerson]) -> None:
    person = people[1]
    cameras = cameras_around(person, np.random.default_rng(0))
    settings = dataclasses.replace(FULL, second_person=1.0, held_object=1.0, worn_object=1.0)

    def picture(seed: int) -> np.ndarray:
        scene = random_scene(
            np.random.default_rng(seed), person, cameras, settings, lambda rng: people[rng.integers(12)]
        )
        return np.stack([render_scene(scene, camera)[0] for camera in cameras])

    np.testing.assert_array_equal(picture(3), picture(3))
    assert (picture(3) != picture(4)).mean() > 0.5


def test_nothing_is_around_a_person_with_the_scene_off(people: list[PosedPerson]) -> None:
    cameras = cameras_around(people[2], np.random.default_rng(0))
    scene = random_scene(np.random.default_rng(0), people[2], cameras, OFF)
    assert len(scene.solids) == 0 and scene.second is None
    depth, material = render_scene(scene, cameras[0])
    assert not depth.any() and not material.any()


def test_a_scene_without_cameras(people: list[PosedPerson]) -> None:
    settings = dataclasses.replace(FULL, second_person=0.0)
    assert len(random_scene(np.random.default_rng(0), people[2], [], settings).shell) == 1


def test_a_camera_below_the_feet_lowers_the_floor(people: list[PosedPerson]) -> None:
    person = people[3]
    low = person.joints[HIP].astype(float) + np.array([2.0, 0, -3.0])
    camera = DepthCamera("low", 32, 32, 20.0, 20.0, 15.5, 15.5, look_at(low, person.joints[HIP].astype(float)))
    scene = random_scene(np.random.default_rng(0), person, [camera], dataclasses.replace(FULL, second_person=0.0))
    assert scene.contains(low)


def test_a_second_person_has_to_come_from_somewhere(people: list[PosedPerson]) -> None:
    with pytest.raises(ValueError, match="second_person must be given"):
        random_scene(np.random.default_rng(0), people[0], [], FULL)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"furniture": (5, 2)}, "furniture has its minimum 5 above its maximum 2"),
        ({"walls_m": (3.0, 1.0)}, "walls_m has its minimum 3.0 above its maximum 1.0"),
        ({"second_person_m": (2.0, 0.4)}, "second_person_m has its minimum"),
        ({"furniture": (-1, 2)}, "furniture must be finite and not negative"),
        ({"walls_m": (1.0, float("inf"))}, "walls_m must be finite"),
        ({"walls_m": (float("nan"), 2.0)}, "walls_m must be finite"),
        ({"held_object": 1.5}, "held_object must be 0 to 1, got 1.5"),
        ({"seen_by_one": float("nan")}, "seen_by_one must be 0 to 1"),
    ],
)
def test_impossible_settings(settings: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SceneSettings(**settings)


def test_held_things_are_at_the_hands_and_worn_ones_on_the_body(people: list[PosedPerson]) -> None:
    rng = np.random.default_rng(2)
    held_count = worn_count = 0
    for person in people:
        floor = float(person.vertices[:, 2].min())
        held, worn = held_object(rng, person, floor), worn_object(rng, person)
        hands = person.joints[[JOINT_INDEX["RHand"], JOINT_INDEX["LHand"]]]
        arms = person.joints[[JOINT_INDEX["RElbow"], JOINT_INDEX["LElbow"]]]
        palms = hands + 0.085 * (hands - arms) / np.linalg.norm(hands - arms, axis=1, keepdims=True)
        if len(held):
            held_count += 1
            assert held.grown(0.15).hold_any(palms)
            assert held.corners[..., 2].min() >= floor
            trunk = person.joints[[JOINT_INDEX[j] for j in ("Hip", "Spine1", "Neck", "RKnee", "LKnee")]]
            assert not held.hold_any(trunk.astype(float))
        if len(worn):
            worn_count += 1
            assert worn.grown(0.02).hold_any(person.vertices.astype(float))
            assert not worn.hold_any(hands.astype(float))
        for thing in (held, worn):
            assert (thing.materials == Material.OBJECT).all()
            assert np.isfinite(thing.frames).all()
            assert len(thing) == 0 or np.ptp(thing.corners.reshape(-1, 3), axis=0).max() < 2.0
    assert held_count > 8 and worn_count > 8


@pytest.mark.parametrize("padded", [False, True])
def test_a_backpack_is_on_the_back(default_body: Body, padded: bool) -> None:
    """Facing −Y, it is seen from +Y and hides the back; its straps are seen from −Y, over a thick jacket, too."""
    from depthmocap.synth.scenes import worn

    jacket = Garment("puffer", 0.05, slack_m=0.02, sag=0.9, hem=0.05, neck=0.03, sleeve=1.95)
    clothes = Clothes((jacket,) if padded else ())
    person = clothe(default_body, clothes, np.random.default_rng(0)).pose(REST_POSTURE)
    trunk = worn._trunk(person)
    pack, straps = worn._backpack(np.random.default_rng(0), trunk)
    assert pack.frames[0, 1, 3] > person.joints[HIP, 1]
    assert not pack.hold_any(person.joints.astype(float))
    scene = Scene(objects=join([pack, straps]))
    seen = {}
    for name, y in (("front", -2.5), ("back", 2.5)):
        eye = np.array([0.0, y, 0.3])
        camera = DepthCamera(name, 128, 106, 92.0, 92.0, 63.5, 52.5, look_at(eye, np.array([0.0, 0.0, 0.3])))
        rendering = render_person(person, camera, *render_scene(scene, camera))
        seen[name] = int((rendering.material == Material.OBJECT).sum())
    assert seen["back"] > 3 * seen["front"] > 30


def test_who_sits_has_something_to_sit_on(default_body: Body) -> None:
    posture = REST_POSTURE.copy()
    for side in "RL":
        posture[POSTURE_INDEX[f"thigh.{side}"]] = [-np.pi / 2, 0, 0]
        posture[POSTURE_INDEX[f"shin.{side}"]] = [np.pi / 2, 0, 0]
    sitting = PosedPerson(default_body.pose(posture))
    knee, hip = (sitting.joints[JOINT_INDEX[f"R{j}"]] for j in ("Knee", "Hip"))
    assert knee[1] < hip[1] - 0.3 and abs(knee[2] - hip[2]) < 0.1
    settings = SceneSettings(furniture=(0, 1), hiding=0.0, seen_by_one=0.0, seen_by_each=0.0)
    turned = sitting.moved(yaw(1.0), np.array([3.0, -2.0, 0.5]))
    for seed in range(4):
        for person in (sitting, turned):
            scene = random_scene(
                np.random.default_rng(seed), person, [], dataclasses.replace(settings, furniture=(1, 1))
            )
            hips = (person.joints[JOINT_INDEX["RHip"]] + person.joints[JOINT_INDEX["LHip"]]) / 2
            below = hips - np.array([0, 0, 0.25])
            assert scene.furniture.hold_any(below[None])
            assert not scene.furniture.hold_any(skin_and_clothes(person))
    standing = PosedPerson(default_body.pose(REST_POSTURE))
    scene = random_scene(np.random.default_rng(0), standing, [], dataclasses.replace(settings, furniture=(1, 1)))
    assert not scene.furniture.hold_any(standing.joints[None, HIP] - np.array([0, 0, 0.5]))


def test_furniture_stands_on_the_floor() -> None:
    hung = {furniture.make_picture, furniture.make_radiator}
    rng = np.random.default_rng(0)
    for maker in dict.fromkeys((*AGAINST_WALLS, *FREE_STANDING)):
        for _ in range(10):
            piece = maker(rng)
            low, high = piece.corners.reshape(-1, 3).min(0), piece.corners.reshape(-1, 3).max(0)
            assert low[2] > -0.01 and high[2] < 2.4
            assert (low[2] < 0.09) != (maker in hung)
            assert (high - low)[:2].max() < 2.6
            assert np.linalg.norm(piece.frames[:, :, :3], axis=1).min() > 0.003  # nothing is flat or inside out
            assert (np.linalg.det(piece.frames[:, :, :3]) > 0).all()


def test_a_person_moves_with_all_they_wear(people: list[PosedPerson]) -> None:
    offset = np.array([1.0, 2.0, 3.0])
    moved = people[0].moved(yaw(0.7), offset)
    for before, after in (
        (people[0].vertices, moved.vertices),
        (people[0].joints, moved.joints),
        (people[0].layers[0].vertices, moved.layers[0].vertices),
    ):
        np.testing.assert_allclose(after, before @ yaw(0.7).T + offset, atol=1e-5)
        assert after.dtype == before.dtype


def test_an_empty_scene_and_a_bare_shell() -> None:
    camera = DepthCamera("cam", 16, 12, 10.0, 10.0, 7.5, 5.5, look_at(np.array([0.0, 0, 1]), np.array([1.0, 0, 1])))
    assert not render_scene(Scene(), camera)[0].any()
    depth, material = render_scene(Scene(shell=shell((-1.0, -1.0, 0.0), (2.0, 1.0, 2.5))), camera)
    assert depth[6, 8] == pytest.approx(2.0)
    assert (material == Material.SCENE).all()
    assert len(NONE) == 0
