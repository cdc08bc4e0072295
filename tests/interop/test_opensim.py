"""OpenSim reads the model that is written for a person, and its inverse kinematics follows their joints.

``make interop`` runs this; it brings the package ``opensim``.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_people_take import FRAMES, LOST, write_take

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.exporting.export_command import ExportSettings, export
from depthmocap.exporting.opensim_model import COORDINATES
from depthmocap.recordings.open_recording import packaged_recording
from depthmocap.recordings.pose_table import read_table

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("opensim") is None, reason="no OpenSim: make interop brings it"),
]


def motion(path: Path) -> dict[str, np.ndarray]:
    """The columns of a motion file, as OpenSim reads them."""
    opensim: Any = importlib.import_module("opensim")
    table = opensim.TimeSeriesTable(str(path))
    columns = {name: table.getDependentColumn(name).to_numpy() for name in table.getColumnLabels()}
    return {"time": np.array(table.getIndependentColumn()), **columns}


def bend(joints: np.ndarray, side: str) -> np.ndarray:
    """Knee flexion by three joints (degrees)."""
    hip, knee, foot = (joints[:, JOINT_INDEX[f"{side}{name}"]] for name in ("Hip", "Knee", "Foot"))
    thigh, shin = knee - hip, foot - knee
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(thigh, shin), axis=-1), (thigh * shin).sum(-1)))


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """The true joints of the packaged recording: somebody turns, walks, lifts the arms, bends, squats and kicks."""
    folder = tmp_path_factory.mktemp("opensim")
    (folder / "take").mkdir()
    (folder / "take" / "pose.csv").write_bytes((packaged_recording() / "truth.csv").read_bytes())
    export(ExportSettings(folder / "take", folder / "files", formats=("trc", "osim", "mot")))
    return folder / "files", read_table(folder / "take" / "pose.csv").joints


def test_the_model_is_the_person(exported: tuple[Path, np.ndarray]) -> None:
    opensim: Any = importlib.import_module("opensim")
    folder, joints = exported
    model = opensim.Model(str(folder / "model.osim"))
    state = model.initSystem()
    names = {model.getCoordinateSet().get(i).getName() for i in range(model.getNumCoordinates())}
    assert names == set(COORDINATES)
    assert model.getTotalMass(state) == pytest.approx(70, abs=0.1)
    places = {name: model.getMarkerSet().get(name).getLocationInGround(state).to_numpy() for name in JOINTS}
    for parent, child in BONES:
        length = np.linalg.norm(places[child] - places[parent])
        median = np.median(np.linalg.norm(joints[:, JOINT_INDEX[child]] - joints[:, JOINT_INDEX[parent]], axis=-1))
        assert length == pytest.approx(median, abs=2e-3)
    # At rest it stands upright and faces +X, its left at -Z.
    assert places["Head"][1] - places["LFoot"][1] > 1.2 and places["LHand"][1] < places["LShoulder"][1] - 0.4
    assert places["LHip"][2] < 0 < places["RHip"][2]


def test_inverse_kinematics_follows_the_joints(exported: tuple[Path, np.ndarray]) -> None:
    folder, joints = exported
    told = json.loads((folder / "export.json").read_text())["people"][0]["mot"]
    assert told["frames"] == len(joints)
    assert told["marker_rms_cm"] < 1.5
    assert set(told["by_marker_cm"]) == set(JOINTS)
    columns = motion(folder / "ik.mot")
    assert len(columns["time"]) == len(joints)
    for side in "LR":
        difference = columns[f"knee_angle_{side.lower()}"] - bend(joints, side)
        assert np.sqrt((difference**2).mean()) < 3.0
    assert np.abs(np.diff(columns["pelvis_rotation"])).max() < 90


def test_landmarks_are_markers_with_weights(exported: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    take = exported[0].parent / "take"
    export(ExportSettings(take, tmp_path, formats=("trc", "osim", "mot"), landmarks=True))
    told = json.loads((tmp_path / "export.json").read_text())["people"][0]["mot"]
    assert set(told["by_marker_cm"]) == {*JOINTS, *LANDMARK_NAMES}
    assert told["marker_rms_cm"] < 1.5
    columns = motion(tmp_path / "ik.mot")
    for side in "LR":
        difference = columns[f"knee_angle_{side.lower()}"] - bend(exported[1], side)
        assert np.sqrt((difference**2).mean()) < 3.0
    assert np.ptp(columns["ankle_angle_r"]) > 5  # locked without landmarks


def test_people_with_gaps(tmp_path: Path) -> None:
    write_take(tmp_path / "take")
    export(ExportSettings(tmp_path / "take", tmp_path / "files", formats=("osim", "mot")))
    people = json.loads((tmp_path / "files" / "export.json").read_text())["people"]
    assert [person["mot"]["frames"] for person in people] == [FRAMES - len(LOST), 20]
    for number in (1, 2):
        columns = motion(tmp_path / "files" / f"person-{number}" / "ik.mot")
        assert all(np.isfinite(values).all() for values in columns.values())
