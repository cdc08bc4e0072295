"""Landmarks are where their names say on bodies of every shape."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.body.landmarks import LANDMARK_INDEX, LANDMARK_MIRROR
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX

pytest.importorskip("anny")

from depthmocap.synth.body.mesh import REST_POSTURE, BodyModel, Phenotype
from depthmocap.synth.body.mesh_landmarks import landmark_vertices, posed_landmarks


@pytest.mark.parametrize("phenotype", [Phenotype(), Phenotype(gender=1.0, age=0.35, weight=0.8)])
def test_they_are_where_their_names_say(phenotype: Phenotype) -> None:
    body = BodyModel.load().shape(phenotype)
    (points,) = posed_landmarks(body, REST_POSTURE[None])
    np.testing.assert_allclose(points, body.rest_vertices[landmark_vertices()], atol=1e-5)
    np.testing.assert_allclose(points[LANDMARK_MIRROR] * [-1, 1, 1], points, atol=2e-3)
    at = {name: points[i] for name, i in LANDMARK_INDEX.items()}
    assert at["Crown"][2] == pytest.approx(body.rest_vertices[:, 2].max(), abs=1e-3)
    forward = {name: -place[1] for name, place in at.items()}  # it faces -Y
    for front, back in (
        ("Nose", "REar"), ("JugularNotch", "C7"), ("Xiphoid", "T10"), ("RAsis", "RPsis"), ("RToe", "RBigToeBase"),
        ("RBigToeBase", "RAnkleMedial"), ("RAnkleMedial", "RHeel"),
    ):  # fmt: skip
        assert forward[front] > forward[back] + 0.02, front
    for outer, inner in (
        ("RKneeLateral", "RKneeMedial"), ("RAnkleLateral", "RAnkleMedial"), ("RAsis", "RPsis"),
        ("RElbowLateral", "RElbowMedial"), ("RSmallToeBase", "RBigToeBase"),
    ):  # fmt: skip
        assert at[outer][0] < at[inner][0] - 0.02, outer
    names = ("Index", "Middle", "Ring", "Little")
    for name in names:
        assert np.linalg.norm(at[f"R{name}Tip"] - at[f"RKnuckle{name}"]) > 0.03
    gaps = [np.linalg.norm(at["RThumbTip"] - at[f"R{name}Tip"]) for name in names]
    assert gaps == sorted(gaps)


def test_they_move_with_their_bones() -> None:
    body = BodyModel.load().shape(Phenotype())
    posture = np.zeros((len(POSTURE_BONES), 3))
    posture[POSTURE_INDEX["shin.R"], 0] = -1.0  # the heel goes back
    before, after = posed_landmarks(body, np.stack([REST_POSTURE, posture]))
    moved = np.linalg.norm(after - before, axis=-1)
    assert moved[LANDMARK_INDEX["RToe"]] > 0.2 > 0.02 > moved[LANDMARK_INDEX["RKneeLateral"]]
    assert moved[LANDMARK_INDEX["LToe"]] == 0
