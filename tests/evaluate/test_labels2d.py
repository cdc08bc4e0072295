"""Checking labels against 2D joints, on a rendered body whose joints are known."""

import json

import cv2
import numpy as np
import pytest

from depthmocap import InputError
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.evaluate.labels2d import Labels2dEvaluation, evaluate_labels2d
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.mesh import REST_POSTURE
from depthmocap.synth.render import render_body

JOINTS = [f"{side}{kind}" for side in "RL" for kind in ("Shoulder", "Elbow", "Hand", "Hip", "Knee", "Foot")]


@pytest.fixture
def folder(default_body, tmp_path):
    posed = default_body.pose(REST_POSTURE)
    pose = look_at(np.array([0.0, -2.6, 0.1]), np.array([0.0, 0.0, 0.05]))
    camera = DepthCamera("c", 320, 320, 340.0, 340.0, 159.5, 159.5, pose)
    depth, _ = render_body(posed, camera)
    cv2.imwrite(str(tmp_path / "a.png"), np.round(depth * 1000).astype(np.uint16))
    places = {joint: [*camera.project(posed.joints[JOINT_INDEX[joint]])[:2].tolist(), 1.0] for joint in JOINTS}
    (tmp_path / "joints2d.json").write_text(json.dumps({"a": places, "picture missing": places}))
    return tmp_path


def test_joints_lie_on_their_regions(folder):
    numbers = evaluate_labels2d(Labels2dEvaluation(folder, fx=340.0, json=folder / "out.json"))
    assert numbers["pictures"] == 1
    assert numbers["joints"] == len(JOINTS)
    assert numbers["on_own_region"] > 0.8
    assert len(numbers["on_other_side"]) <= 1
    assert json.loads((folder / "out.json").read_text()) == numbers


def test_a_mirrored_person_is_noticed(folder):
    people = json.loads((folder / "joints2d.json").read_text())
    swapped = {("L" if joint[0] == "R" else "R") + joint[1:]: place for joint, place in people["a"].items()}
    (folder / "joints2d.json").write_text(json.dumps({"a": swapped}))
    numbers = evaluate_labels2d(Labels2dEvaluation(folder, fx=340.0))
    assert numbers["on_own_region"] < 0.3
    assert len(numbers["on_other_side"]) > 8


def test_bad_folders(tmp_path):
    with pytest.raises(InputError, match=r"joints2d\.json"):
        evaluate_labels2d(Labels2dEvaluation(tmp_path))
    (tmp_path / "joints2d.json").write_text("{")
    with pytest.raises(InputError, match="JSON"):
        evaluate_labels2d(Labels2dEvaluation(tmp_path))
    (tmp_path / "joints2d.json").write_text("{}")
    with pytest.raises(InputError, match="no picture"):
        evaluate_labels2d(Labels2dEvaluation(tmp_path))
