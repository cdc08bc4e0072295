"""The model for OpenSim is whole, and made for the person; its own program reads it in tests/interop."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from two_people_take import walking

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.errors import InputError
from depthmocap.exporting.bone_rotations import rest_offsets
from depthmocap.exporting.file_formats import check_formats
from depthmocap.exporting.opensim_model import _MASSES, COORDINATES, MODEL, model_xml
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP


def numbers(element: Xml.Element, tag: str) -> np.ndarray:
    return np.array([float(word) for word in (element.findtext(tag) or "").split()])


def test_every_joint_is_a_marker_and_bones_have_the_persons_lengths() -> None:
    offsets = rest_offsets(walking(30) @ Y_UP_FROM_Z_UP.T)
    root = Xml.fromstring(model_xml(offsets, "anna & ben"))
    assert root.find("Model[@name='anna & ben']") is not None
    markers = {str(each.get("name")): each for each in root.iter("Marker")}
    assert set(markers) == set(JOINTS)
    bodies = {str(each.get("name")) for each in root.iter("Body")}
    assert bodies == {joint.body for joint in MODEL}
    assert {
        marker.findtext("socket_parent_frame", "").removeprefix("/bodyset/") for marker in markers.values()
    } == bodies
    assert [str(each.get("name")) for each in root.iter("Coordinate")][3:6] == ["pelvis_tx", "pelvis_ty", "pelvis_tz"]
    assert {str(each.get("name")) for each in root.iter("Coordinate")} == set(COORDINATES)
    for body, parent, child in (("tibia_r", "femur_r", "RKnee"), ("radius_l", "humerus_l", "LElbow")):
        (joint,) = (each for each in root.iter("CustomJoint") if each.get("name") == f"{body}_joint")
        (frame,) = (each for each in joint.iter("PhysicalOffsetFrame") if each.get("name") == f"{parent}_offset")
        length = np.linalg.norm(offsets[JOINT_INDEX[child]])
        np.testing.assert_allclose(numbers(frame, "translation"), [0, -length, 0], atol=1e-6)
    for each in root.iter("CustomJoint"):  # every coordinate turns or moves something once
        used = [axis.findtext("coordinates") for axis in each.iter("TransformAxis") if axis.findtext("coordinates")]
        assert used == [coordinate.get("name") for coordinate in each.iter("Coordinate")]
        axes = np.array([numbers(axis, "axis") for axis in each.iter("TransformAxis")][:3])
        assert abs(np.linalg.det(axes)) == pytest.approx(1)


def test_masses_are_those_of_a_body() -> None:
    paired = sum(mass for name, mass in _MASSES.items() if name not in ("pelvis", "torso", "head"))
    assert sum(_MASSES.values()) + paired == pytest.approx(1, abs=2e-3)


@pytest.mark.skipif(importlib.util.find_spec("opensim") is not None, reason="OpenSim is there")
def test_without_opensim_the_way_to_it_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"pip install 'depthmocap\[opensim\]'"):
        check_formats(("osim", "mot"))
    check_formats(("osim", "trc"))
