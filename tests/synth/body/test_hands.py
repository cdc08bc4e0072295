"""Hands that are bent once, in the rest pose."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.body.regions import REGION
from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.hands import Grip, random_grip, with_hands
from depthmocap.synth.body.mesh import REST_POSTURE, Body, BodyModel

OPEN, FIST = Grip(), Grip((1.0, 1.0, 1.0, 1.0, 1.0))


def hand_vertices(model: BodyModel, side: str) -> np.ndarray:
    return np.unique(model.faces[model.face_regions == REGION[f"hand {side}"]])


def reach(body: Body, side: str) -> float:
    """How far the hand reaches beyond the wrist (metres)."""
    wrist = body.rest_heads[body.model.bone_names.index(f"wrist.{side}")]
    return float(np.linalg.norm(body.rest_vertices[hand_vertices(body.model, side)] - wrist, axis=1).max())


def test_an_open_hand_is_the_meshs(default_body: Body) -> None:
    same = with_hands(default_body, OPEN, OPEN)
    np.testing.assert_allclose(same.rest_vertices, default_body.rest_vertices, atol=1e-6)


def test_a_fist_is_shorter_and_the_rest_of_the_body_stays(default_body: Body) -> None:
    body = with_hands(default_body, FIST, OPEN)
    assert reach(body, "R") < 0.75 * reach(default_body, "R")
    assert reach(body, "L") == pytest.approx(reach(default_body, "L"), abs=1e-6)
    others = np.setdiff1d(np.arange(len(body.rest_vertices)), hand_vertices(body.model, "R"))
    moved = np.linalg.norm(body.rest_vertices[others] - default_body.rest_vertices[others], axis=1)
    assert moved.max() < 0.02  # the skin between hand and wrist follows a little


def test_both_sides_bend_alike(default_body: Body) -> None:
    grip = Grip((0.6, 0.2, 0.5, 0.8, 1.0), 0.1)
    body = with_hands(default_body, grip, grip)
    right, left = (body.rest_vertices[hand_vertices(body.model, side)] for side in "RL")
    mirrored = left * [-1, 1, 1]
    distances = np.linalg.norm(right[:, None] - mirrored[None], axis=-1)
    assert distances.min(1).max() < 0.004


def test_fingers_close_towards_the_palm(default_body: Body) -> None:
    # At rest palms look down and to the middle, so that fingertips of a fist lie nearer to the middle.
    model = default_body.model
    tips = np.flatnonzero(
        np.isin(model.skin_indices[:, 0], [model.bone_names.index(f"finger{i}-3.R") for i in range(2, 6)])
    )
    wrist = default_body.rest_heads[model.bone_names.index("wrist.R")]
    knuckle = default_body.rest_heads[model.bone_names.index("finger3-1.R")]
    closed = with_hands(default_body, FIST, FIST).rest_vertices[tips].mean(0)
    opened = default_body.rest_vertices[tips].mean(0)
    along = (knuckle - wrist) / np.linalg.norm(knuckle - wrist)
    assert (closed - knuckle) @ along < 0.02 < (opened - knuckle) @ along
    assert closed[0] > knuckle[0]


def test_a_spread_parts_the_fingers(default_body: Body) -> None:
    model = default_body.model
    index, little = (
        np.flatnonzero(model.skin_indices[:, 0] == model.bone_names.index(f"finger{i}-3.L")) for i in (2, 5)
    )

    def width(spread_rad: float) -> float:
        vertices = with_hands(default_body, OPEN, Grip(spread_rad=spread_rad)).rest_vertices
        return float(np.linalg.norm(vertices[index].mean(0) - vertices[little].mean(0)))

    assert width(-0.2) < width(0.0) < width(0.2)


def test_a_fist_turns_with_the_wrist(default_body: Body) -> None:
    body = with_hands(default_body, FIST, FIST)
    posture = REST_POSTURE.copy()
    posture[POSTURE_INDEX["hand.R"]] = [0.0, 0.0, 1.0]
    wrist = body.rest_heads[body.model.bone_names.index("wrist.R")]
    tips = np.flatnonzero(body.model.skin_indices[:, 0] == body.model.bone_names.index("finger3-3.R"))
    before, after = (np.linalg.norm(body.pose(each).vertices[tips] - wrist, axis=1) for each in (REST_POSTURE, posture))
    np.testing.assert_allclose(before, after, atol=1e-4)
    np.testing.assert_array_equal(body.pose(posture).joints, default_body.pose(posture).joints)


@pytest.mark.parametrize("seed", range(3))
def test_random_grips_stay_within_a_hands_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grips = [random_grip(rng) for _ in range(200)]
    curls = np.array([grip.curls for grip in grips])
    assert curls.min() >= -0.2 and curls.max() <= 1
    assert 40 < (curls[:, 1:].min(1) > 0.6).sum() < 90  # fists
    assert 1 <= ((curls[:, 1] < 0.2) & (curls[:, 2:].min(1) > 0.5)).sum() < 30  # pointing
