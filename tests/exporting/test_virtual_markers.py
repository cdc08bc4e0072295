"""Surface landmarks of a skeleton: in its bones' frames, in the files, with their confidence and error."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from two_people_take import LONG, LOST, SHORT, walking, write_take

from depthmocap.body.landmarks import LANDMARK_INDEX, LANDMARK_MIRROR, LANDMARK_NAMES
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.exporting import read_csv, read_trc
from depthmocap.exporting.body_motion import BodyMotion, solve_body
from depthmocap.exporting.bone_rotations import rest_offsets, rest_positions
from depthmocap.exporting.export_command import ExportSettings, export
from depthmocap.exporting.landmark_model import LandmarkModel
from depthmocap.exporting.opensim_model import model_xml
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP, Timeline
from depthmocap.exporting.virtual_markers import landmark_confidence, landmark_positions

RATE = 1 / 30


def walk(joints: np.ndarray | None = None) -> BodyMotion:
    joints = walking(30) @ Y_UP_FROM_Z_UP.T if joints is None else joints
    return solve_body(Timeline(np.arange(len(joints)) * RATE, joints, RATE))


def test_a_landmark_keeps_its_place_in_its_bones_frame() -> None:
    motion = walk()
    found = landmark_positions(motion)
    knee, hip = JOINT_INDEX["RKnee"], JOINT_INDEX["RHip"]
    for name in ("RKneeLateral", "RKneeMedial"):
        apart = found[:, LANDMARK_INDEX[name]] - motion.positions()[:, knee]
        inside = np.einsum("tji,tj->ti", motion.world_rotations()[:, hip], apart)
        np.testing.assert_allclose(inside, np.tile(inside[0], (30, 1)), atol=1e-9)
        assert 0.03 < np.linalg.norm(inside[0]) < 0.08
    assert np.linalg.norm(found[:, LANDMARK_INDEX["RToe"]] - found[:, LANDMARK_INDEX["RHeel"]], axis=-1).min() > 0.15


def test_sides_are_alike() -> None:
    offsets = rest_offsets(walking(30) @ Y_UP_FROM_Z_UP.T)
    even = (offsets + offsets[MIRROR] * [-1, 1, 1]) / 2
    found = LandmarkModel.load().offsets_m(even)
    np.testing.assert_allclose(found[LANDMARK_MIRROR] * [-1, 1, 1], found, atol=1e-6)
    errors = LandmarkModel.load().errors_m(even)
    assert errors[LANDMARK_INDEX["RHeel"]] < 0.005 < 0.03 < errors[LANDMARK_INDEX["RIndexTip"]] < 0.1


def test_what_is_not_known_has_no_landmarks() -> None:
    joints = walking(30) @ Y_UP_FROM_Z_UP.T
    joints[10:20, JOINT_INDEX["RFoot"]] = np.nan
    unknown = np.isnan(landmark_positions(walk(joints))[..., 0])
    assert unknown[10:20, LANDMARK_INDEX["RHeel"]].all() and not unknown[:10].any()
    assert not unknown[:, LANDMARK_INDEX["LHeel"]].any()
    confidence = np.ones((1, 18))
    confidence[0, JOINT_INDEX["RKnee"]] = 0.5
    sure = landmark_confidence(confidence)[0]
    assert sure[LANDMARK_INDEX["RKneeLateral"]] == sure[LANDMARK_INDEX["RAnkleMedial"]] == 0.5
    assert sure[LANDMARK_INDEX["Crown"]] == 1.0


def test_files_have_them_after_the_joints(tmp_path: Path) -> None:
    truth = np.delete(write_take(tmp_path / "take"), LOST, axis=1)
    settings = ExportSettings(tmp_path / "take", tmp_path / "out", formats=("csv", "trc", "npz"), landmarks=True)
    export(settings)
    folder = tmp_path / "out" / "person-1"
    arrays = np.load(folder / "pose.npz")
    assert arrays["landmark_names"].tolist() == list(LANDMARK_NAMES)
    header, *lines = (folder / "pose.csv").read_text().splitlines()
    names = header.split(",")
    assert names[names.index("LHand_expected_error") + 1] == "Crown_x"
    assert names[-2:] == ["LToe_confidence", "LToe_expected_error"]
    table = np.array([line.split(",") for line in lines], float)
    knuckle = [names.index(f"RKnuckleIndex_{field}") for field in ("x", "y", "z", "confidence")]
    assert np.isnan(table[SHORT][:, knuckle[:3]]).all() and (table[SHORT][:, knuckle[3]] == 0).all()
    np.testing.assert_allclose(
        table[:, knuckle[:3]], arrays["landmarks"][:, LANDMARK_INDEX["RKnuckleIndex"]], atol=1e-6
    )
    _, joints, _ = read_csv(folder / "pose.csv")
    np.testing.assert_allclose(read_trc(folder / "pose.trc")[1], joints, atol=1e-5)
    markers = (folder / "pose.trc").read_text().splitlines()[3].split()[2:]
    assert markers == [*JOINTS, *LANDMARK_NAMES]
    seen = [i for i in range(len(table)) if i not in SHORT and i not in LONG]
    reach = np.linalg.norm(table[seen][:, knuckle[:3]] - truth[0, seen, JOINT_INDEX["RHand"]], axis=-1)
    assert 0.05 < reach.min() < reach.max() < 0.15


def test_c3d_has_their_errors(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    write_take(tmp_path / "take")
    export(ExportSettings(tmp_path / "take", tmp_path / "out", formats=("c3d",), landmarks=True))
    file = ezc3d.c3d(str(tmp_path / "out" / "pose.c3d"))
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    both = [*JOINTS, *LANDMARK_NAMES]
    assert labels == [f"person-{number}:{name}" for number in (1, 2) for name in both]
    residuals = file["data"]["meta_points"]["residuals"][0]
    toe, tip = (labels.index(f"person-1:{name}") for name in ("LToe", "LIndexTip"))
    assert residuals[toe, 0] < residuals[tip, 0] - 10
    assert residuals[labels.index("person-1:RToe"), 0] == pytest.approx(residuals[toe, 0], abs=0.1)
    assert file["parameters"]["ROTATION"]["USED"]["value"] == [2 * len(JOINTS)]


def test_opensims_markers_are_at_the_same_places() -> None:
    offsets = rest_offsets(walking(30) @ Y_UP_FROM_Z_UP.T)
    plain, whole = (Xml.fromstring(model_xml(offsets, "a", landmarks)) for landmarks in (False, True))
    assert all(each.findtext("locked") == "false" for each in whole.iter("Coordinate"))
    assert len([each for each in plain.iter("Coordinate") if each.findtext("locked") == "true"]) == 7
    markers = {str(each.get("name")): each for each in whole.iter("Marker")}
    assert set(markers) == {*JOINTS, *LANDMARK_NAMES}

    def place(name: str) -> np.ndarray:
        return np.array([float(word) for word in str(markers[name].findtext("location")).split()])

    def body(name: str) -> str:
        return str(markers[name].findtext("socket_parent_frame"))

    # Ankles and knees of a body that stands: lateral is to the right of the right one. X is forward, Z right.
    assert body("RKneeLateral") == "/bodyset/femur_r" and place("RKneeLateral")[2] > 0 > place("RKneeMedial")[2]
    assert body("RToe") == "/bodyset/foot_r" and place("RToe")[0] > 0.1 > 0 > place("RHeel")[0]
    assert body("Crown") == "/bodyset/head" and place("Crown")[1] > 0.15
    # Arms hang: fingers are below, palms to the thighs, thumbs to the front.
    assert place("RIndexTip")[1] < -0.1 and place("LIndexTip")[1] < -0.1
    assert place("RThumbTip")[0] > 0.02 and place("LThumbTip")[0] > 0.02
    # On the way back from the hanging arm it is where the skeleton at rest has it.
    model, rest = LandmarkModel.load().offsets_m(offsets), rest_positions(offsets)
    for side, sign in (("R", 1), ("L", -1)):
        own = rest[JOINT_INDEX[f"{side}Elbow"]] + model[LANDMARK_INDEX[f"{side}ElbowLateral"]]
        x, y, z = own - rest[JOINT_INDEX[f"{side}Shoulder"]]
        np.testing.assert_allclose(place(f"{side}ElbowLateral"), [z, sign * x, sign * y], atol=1e-6)
