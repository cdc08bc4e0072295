"""Algorithm 1: bodies, postures and cameras drawn together."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.geometry import is_rigid, transform_points
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.motion.postures import PosturePrior, trunk_angle
from depthmocap.synth.people.bodies import random_dressed_body
from depthmocap.synth.people.wardrobe import HELD_OUT_FAMILY
from depthmocap.synth.sample import (
    ANY_SENSOR,
    BENCH,
    CameraRange,
    Recipe,
    Sample,
    Sampler,
    Subset,
    draw_sample,
    random_camera,
)
from depthmocap.synth.sensing.sensors import HELD_OUT_SENSOR, SENSORS

KINECT2 = SENSORS["ubc3v"]


def draw(seed: int, subset: Subset = "open", **options: Any) -> Sample:
    recipe = Recipe(subset, **options)
    return draw_sample(np.random.default_rng(seed), recipe, PosturePrior.load())


@pytest.fixture(scope="module")
def samples(body_model: BodyModel) -> list[Sample]:
    return [draw(seed) for seed in range(12)]


def test_cameras_stand_within_the_range(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    posed = random_dressed_body(rng, "easy").pose(PosturePrior.load().sample(rng)[0]).body
    low, high = posed.vertices.min(0).astype(float), posed.vertices.max(0).astype(float)
    centre = (low + high) / 2
    places = CameraRange()
    cameras = [random_camera(rng, posed, places, KINECT2, "cam") for _ in range(300)]
    eyes = np.stack([camera.world_from_camera[:3, 3] for camera in cameras])
    distances = np.linalg.norm(eyes - centre, axis=1)
    heights = eyes[:, 2] - low[2]
    assert places.distance_m[0] <= distances.min() < 1.7
    assert 3.8 < distances.max() <= places.distance_m[1]
    assert places.height_m[0] <= heights.min() < 0.6
    assert 2.4 < heights.max() <= places.height_m[1]
    azimuths, _ = np.histogram(np.arctan2(*(eyes - centre)[:, :2].T), 8, (-np.pi, np.pi))
    assert azimuths.min() > 20
    # They look at the body's middle, within 4 deviations of the aim, and stand upright.
    for camera, distance in zip(cameras, distances, strict=True):
        assert is_rigid(camera.world_from_camera, 1e-9)
        x, y, z = transform_points(camera.camera_from_world, centre)
        assert np.hypot(x, y) < 0.5
        assert z > 0.8 * distance
        assert abs(camera.world_from_camera[2, 0]) < 1e-9
    assert (cameras[0].width, cameras[0].fx, cameras[0].cy) == (KINECT2.width, KINECT2.fx, KINECT2.cy)


def test_cameras_may_roll(body_model: BodyModel) -> None:
    rng = np.random.default_rng(1)
    posed = random_dressed_body(rng, "easy").pose(PosturePrior.load().sample(rng)[0]).body
    rolls = [
        np.arcsin(random_camera(rng, posed, CameraRange(aim_m=0.0, roll_rad=0.1), KINECT2, "c").world_from_camera[2, 0])
        for _ in range(100)
    ]
    assert 0.05 < np.std(rolls) < 0.12


def test_views_of_a_sample(samples: list[Sample]) -> None:
    for sample in samples:
        assert [view.camera.name for view in sample.views] == ["Cam1", "Cam2", "Cam3"]
        assert sample.joints.shape == (18, 3)
        for view in sample.views:
            assert view.mask is not None
            assert view.labels is not None
            np.testing.assert_array_equal(view.mask, view.depth_m > 0)
            assert not (view.labels[~view.mask] > 0).any()
            # Only cloth and hair that reach over the skin's outline have no label: of a gown to the ground, much of it.
            assert np.count_nonzero(view.labels) > 0.4 * np.count_nonzero(view.mask)
            assert view.labels.max() <= 43
            assert np.count_nonzero(view.mask) > 500


def test_joints_lie_in_the_picture_of_the_person(samples: list[Sample]) -> None:
    inside = total = 0
    for sample in samples:
        for view in sample.views:
            assert view.mask is not None
            u, v, z = view.camera.project(sample.joints).T
            rows, columns = np.nonzero(view.mask)
            seen = (u > 0) & (u < view.camera.width - 1) & (v > 0) & (v < view.camera.height - 1)
            boxed = (u > columns.min() - 1) & (u < columns.max() + 1) & (v > rows.min() - 1) & (v < rows.max() + 1)
            assert (boxed | ~seen).all()
            hit = view.depth_m[v[seen].round().astype(int), u[seen].round().astype(int)]
            # Where the body is seen, its surface is before the joint or, behind an edge, a limb's width off.
            assert (hit[hit > 0] < z[seen][hit > 0] + 0.1).all()
            inside += np.count_nonzero(hit)
            total += np.count_nonzero(seen)
    assert inside > 0.97 * total > 300


def test_views_agree_on_where_the_person_is(samples: list[Sample]) -> None:
    for sample in samples[:4]:
        clouds = [transform_points(v.camera.world_from_camera, v.camera.unproject(v.depth_m)) for v in sample.views]
        for cloud in clouds:
            reach = np.abs(cloud[:, None] - sample.joints[None].astype(np.float32)).max(2).min(1)
            assert np.quantile(reach, 0.95) < 0.25


def test_samples_depend_on_the_generator_alone(samples: list[Sample]) -> None:
    again = draw(3)
    np.testing.assert_array_equal(again.joints, samples[3].joints)
    assert again.group == samples[3].group
    for view, same in zip(again.views, samples[3].views, strict=True):
        np.testing.assert_array_equal(view.depth_m, same.depth_m)
        np.testing.assert_array_equal(view.camera.world_from_camera, same.camera.world_from_camera)
    assert np.abs(again.joints - samples[4].joints).max() > 0.05


def test_noise_keeps_labels_exact(samples: list[Sample]) -> None:
    noisy = draw(3, noise="sensor", sensors=("kinect2",))
    same = draw(3, sensors=("kinect2",))
    view, exact = noisy.views[0], same.views[0]
    assert view.mask is not None and exact.mask is not None
    np.testing.assert_array_equal(view.mask, view.depth_m > 0)
    np.testing.assert_array_equal(view.labels, exact.labels)
    assert not (view.mask & ~exact.mask).any()
    assert 0.6 < np.count_nonzero(view.mask) / np.count_nonzero(exact.mask) < 1
    difference = np.abs(view.depth_m - exact.depth_m)[view.mask]
    assert 0 < np.median(difference) < 0.02


def test_subsets(body_model: BodyModel) -> None:
    def bodies(subset: Subset) -> set[bytes]:
        return {random_dressed_body(np.random.default_rng(i), subset).body.rest_vertices.tobytes() for i in range(24)}

    counts = {subset: len(bodies(subset)) for subset in get_args(Subset)}
    assert counts["easy"] == counts["inter"] == 1
    assert 8 <= counts["hard"] <= 16
    assert counts["open"] == 24
    assert bodies("easy") == bodies("inter")


def test_sensors_of_a_recipe(body_model: BodyModel) -> None:
    assert Recipe(sensors=("kinect2", "itop")).presets == (SENSORS["kinect2"], SENSORS["itop"])
    assert SENSORS[HELD_OUT_SENSOR] not in Recipe(sensors=(ANY_SENSOR,)).presets
    sizes = {
        (view.camera.width, view.camera.height)
        for seed in range(4)
        for view in draw(seed, sensors=("kinect2", "itop")).views
    }
    assert sizes == {(512, 424), (320, 240)}


def test_scenes_are_background(body_model: BodyModel) -> None:
    for seed in range(3):
        for view in draw(seed, scene="full").views:
            assert view.mask is not None and view.labels is not None
            assert (view.depth_m > 0).mean() > 0.5  # floor and walls
            assert not (view.labels[~view.mask] > 0).any()
            assert 0 < view.mask.mean() < 0.5


def test_truncated_views_end_within_the_person(body_model: BodyModel) -> None:
    def on_the_border(truncated: float) -> float:
        cameras = CameraRange(truncated=truncated)
        masks = [view.mask for seed in range(6) for view in draw(seed, cameras=cameras).views]
        edges = [np.concatenate([m[0], m[-1], m[:, 0], m[:, -1]]).any() for m in masks if m is not None]
        return float(np.mean(edges))

    assert on_the_border(1.0) > on_the_border(0.0) + 0.2


def test_cameras_look_straight_down(body_model: BodyModel) -> None:
    overhead = CameraRange(distance_m=(0.5, 1.0), height_m=(2.4, 3.0), steepest_deg=90.0)
    down = [view.camera.world_from_camera[2, 2] for seed in range(4) for view in draw(seed, cameras=overhead).views]
    assert min(down) < -0.97 and max(down) < -0.9


def test_held_out_clothes(body_model: BodyModel) -> None:
    for subset in get_args(Subset):
        for i in range(12):
            for held_out in (False, True):
                dressed = random_dressed_body(np.random.default_rng(i), subset, held_out)
                assert any(g.family == HELD_OUT_FAMILY for g in dressed.clothes.garments) == held_out


def test_sampler_depends_on_seed_and_index(body_model: BodyModel) -> None:
    recipe = BENCH["seen"]
    assert recipe.split == "test" and BENCH["new clothes"].held_out_clothes
    assert BENCH["new sensor"].presets == (SENSORS[HELD_OUT_SENSOR],)


def test_hands_on_the_body_are_all_that_differs(body_model: BodyModel) -> None:
    plain, touching = (Sampler(BENCH[name], 5) for name in ("seen", "hands on body"))
    arms = [JOINT_INDEX[f"{side}{joint}"] for joint in ("Elbow", "Hand") for side in "RL"]
    others = np.setdiff1d(np.arange(len(JOINT_INDEX)), arms)
    moved = 0
    for i in range(6):
        a, b = plain(i).joints, touching(i).joints
        np.testing.assert_allclose(a[others], b[others], atol=1e-9)
        moved += np.abs(a[arms] - b[arms]).max() > 0.02
    assert moved >= 5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"views": 0}, "--views must be at least 1"),
        ({"sensors": ("kinetc2",)}, "no sensor 'kinetc2': expected one of kinect1, kinect2"),
        ({"sensors": ()}, "--sensors must name at least one"),
    ],
)
def test_recipes_that_cannot_be(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Recipe(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distance_m": (3.0, 2.0)}, "--distance-m must be a minimum and a maximum, got 3.0 and 2.0"),
        ({"height_m": (0.0, float("nan"))}, "--height-m must be a minimum and a maximum"),
        ({"distance_m": (0.1, 2.0)}, "--distance-m must be at least 0.5"),
        ({"height_m": (-1.0, 2.0)}, "--height-m must be at least 0"),
        ({"aim_m": float("nan")}, "--aim-m must be a number of at least 0, got nan"),
        ({"roll_rad": float("inf")}, "--roll-rad must be a number of at least 0, got inf"),
        ({"truncated": 1.5}, "--truncated must be from 0 to 1"),
        ({"steepest_deg": 91.0}, "--steepest-deg must be more than 0 and at most 90, got 91.0"),
    ],
)
def test_cameras_that_cannot_be(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        CameraRange(**options)


def test_nobody_in_range(body_model: BodyModel) -> None:
    far = Recipe(views=1, sensors=("azure-wfov",), noise="sensor", cameras=CameraRange(distance_m=(30.0, 31.0)))
    with pytest.raises(InputError, match="sample 2: no camera sees the person in 20 tries"):
        Sampler(far, 0)(2)


def test_a_person_of_whom_clothes_alone_are_seen_is_drawn_again(
    body_model: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As happens to people cut off below a camera at the ceiling: such a sample ended the making of a set."""
    recipe, draws = Recipe(views=1), []

    def drawn(*arguments: Any) -> Sample:
        sample = draw_sample(*arguments)
        draws.append(sample)
        if len(draws) < 3:
            labels = sample.views[0].labels
            assert labels is not None
            labels[:] = 0
        return sample

    monkeypatch.setattr("depthmocap.synth.sample.draw_sample", drawn)
    assert Sampler(recipe, 0)(2) is draws[2]
    monkeypatch.setattr("depthmocap.synth.sample._TRIES", 2)
    draws.clear()
    with pytest.raises(InputError, match="sample 2: no camera sees the person in 2 tries"):
        Sampler(recipe, 0)(2)


def test_everybody_sits_or_touches_themselves_however_varied_they_are() -> None:
    """No posture stays as recorded where all shall do something else."""
    postures = Sampler(Recipe("open", vary=True, seated=True, hands_on_body=True), 0)._postures
    assert isinstance(postures, PosturePrior)
    rng = np.random.default_rng(0)
    for _ in range(50):
        one = postures.variation.draw(rng)
        assert (one.sit, one.touch) == (1.0, 1.0)


def test_everybody_leans_where_asked_for() -> None:
    postures = Sampler(Recipe("open", leaning=True), 0)._postures
    rng = np.random.default_rng(0)
    assert all(trunk_angle(postures.sample(rng)[0]) > 0.6 for _ in range(30))
