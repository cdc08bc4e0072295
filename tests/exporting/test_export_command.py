"""``depthmocap export``: files of a take with gaps and two people, read back."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_people_take import FRAME_NS, FRAMES, LONG, LOST, SECOND, SHORT, START_NS, write_take

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.cli import main
from depthmocap.errors import InputError
from depthmocap.exporting import read_bvh, read_csv, read_trc
from depthmocap.exporting.edits import Edit, TakeMarker, write_edits
from depthmocap.exporting.export_command import ExportSettings, export, write_more_formats
from depthmocap.exporting.exported_take import exported_take
from depthmocap.exporting.file_formats import FORMATS, check_formats
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.gap_filling import fill_gaps
from depthmocap.exporting.stored_result import read_result
from depthmocap.frames import expected_error_m
from depthmocap.geometry import z_up_from

WRIST, OTHER = JOINT_INDEX["RHand"], JOINT_INDEX["LHand"]


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    folder = tmp_path_factory.mktemp("take")
    return folder, write_take(folder)


def rows(truth: np.ndarray) -> np.ndarray:
    """What is true in frames that are not lost."""
    return np.delete(truth, LOST, axis=0)


def test_everybody_has_a_name_and_a_start(taken: tuple[Path, np.ndarray]) -> None:
    take = exported_take(read_result(taken[0]))
    assert [take.name(person) for person in take.people] == ["person-1", "person-2"]
    assert take.origin_ns == START_NS and take.up == "z"
    second = take.rows(take.people[1], 0.2)
    assert len(second.times_s) == len(SECOND) and second.times_s[0] == pytest.approx(SECOND[0] * FRAME_NS * 1e-9)


def test_corrections_and_markers_are_applied(tmp_path: Path) -> None:
    truth = write_take(tmp_path / "take")
    result = read_result(tmp_path / "take")
    edits = (Edit("delete", 1), Edit("name", 2, name="Ada: L."))
    markers = (TakeMarker(START_NS + 10 * FRAME_NS, "trial 1"),)
    write_edits(tmp_path / "take", dataclasses.replace(result.edits, edits=edits, markers=markers))
    export(ExportSettings(tmp_path / "take", tmp_path / "out", formats=("csv", "c3d")))
    assert [path.name for path in (tmp_path / "out").iterdir() if path.is_dir()] == ["person-2"]
    document = json.loads((tmp_path / "out" / "export.json").read_text())
    assert document["corrections"] == 2 and [person["name"] for person in document["people"]] == ["Ada-L-"]
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d(str(tmp_path / "out" / "pose.c3d"))
    assert file["parameters"]["POINT"]["LABELS"]["value"][0] == "Ada-L-:Head"
    assert file["parameters"]["EVENT"]["LABELS"]["value"] == ["trial 1"]
    first_s = file["parameters"]["DEPTHMOCAP"]["START_S"]["value"][0]
    assert first_s + file["parameters"]["EVENT"]["TIMES"]["value"][1, 0] == pytest.approx(10 / 30, abs=1e-5)
    np.testing.assert_allclose(file["data"]["points"][:3, 0, 0] / 1000, truth[1, SECOND[0], 0], atol=1e-4)


def test_the_same_files_as_run_writes(taken: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    assert main(["export", str(taken[0]), "--out", str(tmp_path), "--formats", "trc", "bvh"]) == 0
    for path in [*taken[0].glob("person-*/pose.trc"), *taken[0].glob("person-*/pose.bvh")]:
        assert (tmp_path / path.relative_to(taken[0])).read_bytes() == path.read_bytes()
    document = json.loads((tmp_path / "export.json").read_text())
    assert document["files"][0] == "person-1/pose.trc" and len(document["files"]) == 4
    lost = [[LONG[0], LONG[-1]]]
    held = document["people"][0]["held"]
    assert held["RHand"] == [[SHORT[0], SHORT[-1]], *lost] and held["LHand"] == [[SHORT[0], SHORT[-1]]]


def test_gaps_are_filled_up_to_a_length(taken: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    export(ExportSettings(taken[0], tmp_path, formats=("csv", "trc", "bvh"), fill_s=0.2))
    truth = rows(taken[1][0])
    _, joints, confidence = read_csv(tmp_path / "person-1" / "pose.csv")
    assert np.linalg.norm(joints[SHORT, WRIST] - truth[SHORT, WRIST], axis=-1).max() < 0.03
    assert np.isnan(joints[LONG, WRIST]).all() and (confidence[SHORT, WRIST] == 0).all()
    np.testing.assert_allclose(read_trc(tmp_path / "person-1" / "pose.trc")[1], joints, atol=1e-5)
    document = json.loads((tmp_path / "export.json").read_text())
    filled = [[SHORT[0], SHORT[-1]]]
    assert document["people"][0]["filled"] == {"RHand": filled, "LHand": filled}
    assert "Hermite" in document["filled_by"] and document["settings"]["fill_s"] == 0.2
    # Lost frames are filled in what is evenly spaced.
    animated = read_bvh(tmp_path / "person-1" / "pose.bvh")[1]
    assert np.linalg.norm(animated[LOST] - taken[1][0, LOST], axis=-1).max() < 0.03


@pytest.mark.parametrize("up", ["z", "-y"])
def test_rotations_in_csv_turn_the_rest_pose_into_the_pose(tmp_path: Path, up: str) -> None:
    truth = rows(write_take(tmp_path / "take", up)[0])
    export(ExportSettings(tmp_path / "take", tmp_path / "out", formats=("csv", "npz")))
    header, *lines = (tmp_path / "out" / "person-1" / "pose.csv").read_text().splitlines()
    names = header.split(",")
    assert names[73:75] == ["timestamp_ns", "Head_qx"] and names[-1] == "LHand_expected_error"
    table = np.array([line.split(",") for line in lines], float)
    errors = table[:, [names.index(f"{joint}_expected_error") for joint in JOINTS]]
    confidence = table[:, [names.index(f"{joint}_confidence") for joint in JOINTS]]
    np.testing.assert_allclose(errors, np.where(confidence > 0, expected_error_m(confidence), np.nan), atol=1e-5)
    arrays = np.load(tmp_path / "out" / "person-1" / "pose.npz")
    assert set(arrays) >= {"times_s", "joints", "quaternions", "rest_offsets"}
    assert arrays["standing"].shape == (len(truth), 2)
    assert arrays["joint_names"].tolist() == list(JOINTS)
    for parent, child in BONES:
        rotation = table[:, names.index(f"{parent}_qx") : names.index(f"{parent}_qw") + 1]
        np.testing.assert_allclose(arrays["quaternions"][:, JOINT_INDEX[parent]], rotation, atol=1e-6)
        seen = ~np.isnan(rotation[:, 0])
        assert seen.sum() >= FRAMES - len(LOST) - len(SHORT) - len(LONG)
        bone = truth[:, JOINT_INDEX[child]] - truth[:, JOINT_INDEX[parent]]
        turned = Rotation.from_quat(rotation[seen]).apply(arrays["rest_offsets"][JOINT_INDEX[child]])
        np.testing.assert_allclose(turned, bone[seen], atol=2e-5)


def test_run_adds_columns_to_its_csv(tmp_path: Path) -> None:
    write_take(tmp_path)
    path = tmp_path / "person-1" / "pose.csv"
    before = path.read_text().splitlines()
    assert write_more_formats(FileSettings(formats=("csv", "trc"), least_confidence=0.5), tmp_path) == []
    after = path.read_text().splitlines()
    assert [line.rsplit(",", 72 + 18)[0] for line in after] == before
    assert (tmp_path / "export.json").exists() and len(list(tmp_path.rglob("pose.csv"))) == 3


def test_c3d(taken: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    export(ExportSettings(taken[0], tmp_path, formats=("c3d",), fill_s=0.2, least_confidence=0.2))
    file = ezc3d.c3d(str(tmp_path / "pose.c3d"))
    parameters, points = file["parameters"], file["data"]["points"]
    labels = parameters["POINT"]["LABELS"]["value"]
    assert labels[WRIST] == "person-1:RHand" and len(labels) == 36 and points.shape == (4, 36, FRAMES)
    assert parameters["POINT"]["UNITS"]["value"] == ["mm"]
    assert parameters["POINT"]["RATE"]["value"][0] == pytest.approx(30, abs=1e-3)
    assert [parameters["POINT"][name]["value"] for name in ("X_SCREEN", "Y_SCREEN")] == [["+X"], ["+Z"]]
    assert parameters["DEPTHMOCAP"]["FIRST_TIMESTAMP_NS"]["value"] == [str(START_NS)]
    # Points are those of pose.csv; what nobody saw has the residual -1, and what was filled has 0.
    joints, truth = points[:3].transpose(2, 1, 0).reshape(FRAMES, 2, 18, 3) / 1000, taken[1]
    residuals = file["data"]["meta_points"]["residuals"][0].T.reshape(FRAMES, 2, 18)
    unknown = np.isnan(joints).any(-1)
    assert (residuals[unknown] == -1).all() and (residuals[~unknown] >= 0).all()
    assert unknown[LONG, 0, WRIST].all() and not unknown[SHORT, 0].any() and not unknown[LOST, 0].any()
    assert (residuals[SHORT, 0][:, [WRIST, OTHER]] == 0).all() and (residuals[0, 0] > 10).all()
    assert unknown[: SECOND[0], 1].all() and unknown[SECOND[-1] + 1 :, 1].all()
    first = np.setdiff1d(np.arange(FRAMES), [*SHORT, *LONG, *LOST])
    np.testing.assert_allclose(joints[first, 0], truth[0, first], atol=1e-4)
    np.testing.assert_allclose(joints[SECOND, 1], truth[1, SECOND], atol=1e-4)
    # Of each bone the rotation and where it starts.
    rotations = file["data"]["rotations"]
    assert rotations.shape == (4, 4, 36, FRAMES) and parameters["ROTATION"]["LABELS"]["value"] == labels
    matrix = rotations[:, :, JOINT_INDEX["RKnee"], 0]
    down = matrix[:3, :3] @ [0, -1, 0]
    shin = truth[0, 0, JOINT_INDEX["RFoot"]] - truth[0, 0, JOINT_INDEX["RKnee"]]
    np.testing.assert_allclose(down, shin / np.linalg.norm(shin), atol=1e-4)
    np.testing.assert_allclose(matrix[:3, 3] / 1000, truth[0, 0, JOINT_INDEX["RKnee"]], atol=1e-4)
    assert np.isnan(rotations[:, :, JOINT_INDEX["RElbow"], 20]).all()


def test_a_c3d_file_is_not_longer_than_its_header_counts(
    taken: tuple[Path, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ezc3d")
    monkeypatch.setattr("depthmocap.exporting.c3d.MOST_FRAMES", FRAMES - 1)
    with pytest.raises(InputError, match="it holds 39 frames, and the take has 40"):
        export(ExportSettings(taken[0], tmp_path, formats=("c3d",)))


@pytest.mark.parametrize(
    ("skeleton", "rest"), [("unity", "t"), ("unreal", "a"), ("mixamo", "t"), ("cmu", "a"), ("vrm", "a")]
)
def test_names_of_other_tools_leave_joints_where_they_are(
    taken: tuple[Path, np.ndarray], tmp_path: Path, skeleton, rest
) -> None:
    export(ExportSettings(taken[0], tmp_path, formats=("bvh",), skeleton=skeleton, rest=rest, bvh_unit="m"))
    text = (tmp_path / "person-2" / "pose.bvh").read_text()
    names = re.findall(r"(?:ROOT|JOINT) (\S+)", text)
    assert len(names) == len(set(names)) >= 22
    positions = bvh_positions(text)
    shins = {"unity": "LowerLeg", "unreal": "calf", "mixamo": "Leg", "cmu": "Leg", "vrm": "LowerLeg"}
    name = next(each for each in names if each.lower().startswith(("left", "mixamorig:left", "calf_l"))
                and shins[skeleton] in each and "Up" not in each)  # fmt: skip
    knee = taken[1][1, SECOND, JOINT_INDEX["LKnee"]] @ z_up_from("y")
    np.testing.assert_allclose(positions[name], knee, atol=1e-4)
    elbow = next(each for each in names if re.search(r"(?i)(left.*(forearm|lowerarm))|lowerarm_l", each))
    np.testing.assert_allclose(positions[elbow], taken[1][1, SECOND, JOINT_INDEX["LElbow"]] @ z_up_from("y"), atol=1e-4)


def bvh_positions(text: str) -> dict[str, np.ndarray]:
    """Where every joint of a BVH file is, by name (t, 3): the format's forward kinematics."""
    lines = text.split("\n")
    motion = lines.index("MOTION")
    table = np.array([line.split() for line in lines[motion + 3 :] if line], float)
    stack: list[str] = []
    positions, worlds, name, column, offset = {}, {}, "", 0, np.zeros(3)
    for line in lines[1:motion]:
        words = line.split()
        if words[0] in ("ROOT", "JOINT", "End"):
            name = words[1]
        elif words[0] == "{":
            stack.append(name)
        elif words[0] == "}":
            stack.pop()
        elif words[0] == "OFFSET":
            offset = np.array(words[1:], float)
        elif words[0] == "CHANNELS":
            parent = stack[-2] if len(stack) > 1 else None
            at = np.tile(offset, (len(table), 1))
            if words[1] == "6":
                at, column = at + table[:, column : column + 3], column + 3
            turn = Rotation.from_euler("ZXY", table[:, column : column + 3], degrees=True)
            column += 3
            positions[name] = at if parent is None else positions[parent] + worlds[parent].apply(at)
            worlds[name] = turn if parent is None else worlds[parent] * turn
    return positions


def test_bvh_in_metres_is_read_back(taken: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    export(ExportSettings(taken[0], tmp_path, formats=("bvh",), bvh_unit="m"))
    np.testing.assert_allclose(read_bvh(tmp_path / "person-2" / "pose.bvh")[1], taken[1][1, SECOND], atol=1e-4)


def test_gap_filling_leaves_long_gaps_and_ends() -> None:
    times = np.arange(10) * 0.1
    points = np.full((10, 1, 3), np.nan)
    points[[1, 2, 5, 6], 0] = [[0, 0, 0], [0, 0, 0], [1, 1, 1], [1, 1, 1]]
    filled, mask = fill_gaps(times, points, 0.3)
    assert np.flatnonzero(mask).tolist() == [3, 4]
    assert (filled[3:5] > 0).all() and (filled[3:5] < 1).all() and np.isnan(filled[[0, 7, 9]]).all()
    # A cubic is met exactly, but for its velocities at the ends, which come from the intervals beside.
    thrown = np.stack([times, 2 * times, 1 - 4.9 * times**2], -1)[:, None]
    hole = thrown.copy()
    hole[4:6] = np.nan
    assert np.abs(fill_gaps(times, hole, 0.3)[0] - thrown).max() < 0.06
    np.testing.assert_allclose(fill_gaps(times, hole, 0.3)[0][..., :2], thrown[..., :2], atol=1e-9)
    assert not fill_gaps(times, points, 0.29)[1].any() and not fill_gaps(times, points, 0.0)[1].any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere", "--formats", "trc"], "nowhere is no folder of results"),
        (["{take}", "--formats", "trc", "--least-confidence", "2"], "--least-confidence must be from 0 to 1"),
        (["{take}", "--formats", "trc", "--fill-s", "-1"], "--fill-s must be finite and at least 0"),
        (["{take}", "--formats", "trc", "--least-confidence", "0.99"], "has a confidence of 0.99"),
        (["{empty}", "--formats", "trc"], "empty has no pose.csv"),
    ],
)
def test_errors(taken: tuple[Path, np.ndarray], tmp_path: Path, capsys, arguments: list[str], message: str) -> None:
    (tmp_path / "empty").mkdir()
    words = [word.format(take=taken[0], empty=tmp_path / "empty") for word in arguments]
    assert main(["export", *words, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err


def test_results_stay_as_they_are(taken: tuple[Path, np.ndarray]) -> None:
    with pytest.raises(InputError, match="--out must not be the folder of the results"):
        export(ExportSettings(taken[0], taken[0], formats=("csv",)))


def test_a_missing_package_is_told_before_anything_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    check_formats(("csv", "trc", "bvh", "npz"))
    with pytest.raises(InputError, match=r"pip install 'depthmocap\[export\]'"):
        check_formats(("c3d",))


def test_every_format_has_its_row() -> None:
    from typing import get_args

    from depthmocap.exporting.file_settings import FormatName

    assert set(FORMATS) == set(get_args(FormatName)) and all(callable(each.write) for each in FORMATS.values())
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    extras = dict(re.findall(r"\n(\w+) = \[(.*?)\n\]", text, re.S))
    assert all(each.needs[1] in extras[each.needs[2]] for each in FORMATS.values() if each.needs)
