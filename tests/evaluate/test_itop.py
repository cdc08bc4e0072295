"""ITOP in its true layout, through the command line: joints at known distances from what the pipeline finds."""

import csv
import json

import numpy as np
import pytest
from people_files import picked, scenes

from depthmocap.cli import main
from depthmocap.datasets.itop import CORRESPONDENCE, JOINTS, Itop, camera
from depthmocap.errors import InputError

h5py = pytest.importorskip("h5py")
TRAIN, TEST = 16, 6
SHIFT_M = np.array([0.0, 0.03, 0.0])


def write_itop(root, split, people, joints, valid=None, view="side"):
    """``joints`` in the camera's frame; ids are of two persons in turn."""
    root.mkdir(exist_ok=True)
    ids = np.array([f"{i % 2:02d}_{i:05d}" for i in range(len(people))], dtype="S8")
    valid = np.ones(len(people), np.uint8) if valid is None else valid
    with h5py.File(root / f"ITOP_{view}_{split}_depth_map.h5", "w") as file:
        file["id"] = ids
        file["data"] = np.stack([each.depth_m for each in people]).astype(np.float16)
    with h5py.File(root / f"ITOP_{view}_{split}_labels.h5", "w") as file:
        file["id"] = ids
        file["is_valid"] = valid
        file["visible_joints"] = np.ones((len(people), 15), np.int16)
        file["real_world_coordinates"] = (joints * [1, -1, 1]).astype(np.float32)
        file["segmentation"] = np.stack([np.where(each.depth_m > 0, 3, -1) for each in people]).astype(np.int8)


@pytest.fixture(scope="session")
def people(default_body):
    return scenes(default_body, camera("side"), TRAIN + TEST, np.float16)


@pytest.fixture(scope="session")
def joints(people):
    return picked(np.stack([each.joints for each in people]), CORRESPONDENCE, JOINTS)


@pytest.fixture(scope="session")
def itop(people, joints, tmp_path_factory):
    """Every joint is 3 cm under ours, but the right hand 12 cm."""
    root = tmp_path_factory.mktemp("itop")
    truth = joints + SHIFT_M
    truth[:, JOINTS.index("RHand"), 1] += 0.09
    write_itop(root, "train", people[:TRAIN], truth[:TRAIN])
    write_itop(root, "test", people[TRAIN:], truth[TRAIN:])
    return root


def test_known_distances_are_the_errors(itop, tmp_path):
    files = [tmp_path / name for name in ("numbers.json", "joints.csv", "report.html")]
    options = [f"--{file.suffix[1:] if file.suffix != '.html' else 'report'}={file}" for file in files]
    assert main(["evaluate", "itop", str(itop), "--refit", "none", *options]) == 0
    numbers = json.loads(files[0].read_text())["ITOP side"]
    assert numbers["frames"] == TEST
    assert numbers["mean_joint_error_cm"] == pytest.approx((14 * 3 + 12) / 15, abs=0.01)
    assert numbers["per_joint_error_cm"]["RHand"] == pytest.approx(12, abs=0.01)
    assert numbers["mean_ap_10cm"] == pytest.approx(14 / 15)
    assert numbers["ap_10cm_by_part"] == {"upper body": pytest.approx(7 / 8), "lower body": 1.0}
    assert {name: each["frames"] for name, each in numbers["by_subject"].items()} == {"00": 3, "01": 3}
    assert sum(numbers["reliability"]["joints"]) == TEST * 15

    rows = list(csv.DictReader(files[1].read_text().splitlines()))
    assert [row["joint"] for row in rows] == list(JOINTS)
    assert float(rows[JOINTS.index("RHand")]["error_cm"]) == pytest.approx(12, abs=0.01)
    page = files[2].read_text()
    assert page.count("<img") == 3 and 'src="http' not in page
    assert "RHand" in page and "upper body" in page


def test_a_refit_learns_where_the_set_puts_its_joints(itop, tmp_path):
    path = tmp_path / "numbers.json"
    assert main(["evaluate", "itop", str(itop), f"--json={path}"]) == 0
    numbers = json.loads(path.read_text())["ITOP side"]
    assert numbers["mean_joint_error_cm"] < 0.1
    assert numbers["mean_ap_10cm"] == 1


def test_only_valid_frames_with_known_joints(people, joints, tmp_path):
    valid = np.array([1, 0, 1, 1, 1, 1], np.uint8)
    truth = joints[:6].copy()
    truth[2, 0] = 0  # not marked
    truth[2, 1] = np.inf, 1e30, -1e30  # nowhere near
    write_itop(tmp_path, "test", people[:6], truth, valid)
    frames = list(Itop(tmp_path))
    assert [frame.frame for frame in frames] == [0, 2, 3, 4, 5]
    assert [frame.subject for frame in frames] == ["00", "00", "01", "00", "01"]
    assert np.isnan(frames[1].joints_world[:2]).all() and np.isfinite(frames[1].joints_world[2:]).all()
    np.testing.assert_allclose(frames[0].joints_world, truth[0], atol=1e-6)
    # The joints lie where the depth is: each in front of or behind a pixel of the person, within a limb.
    view = frames[0].views[0]
    u, v, _ = view.camera.project(frames[0].joints_world).T
    rows, columns = np.rint(v).astype(int), np.rint(u).astype(int)
    assert view.mask is not None and view.mask[rows, columns].mean() > 0.7


def test_the_top_view_is_turned_upright(people, joints, tmp_path):
    write_itop(tmp_path, "test", people[:2], joints[:2], view="top")
    top = Itop(tmp_path, "top")
    frame = next(iter(top))
    assert top.up == "z"
    # What is nearer to the camera above is higher.
    np.testing.assert_allclose(frame.joints_world[:, 2], -joints[0][:, 2], atol=1e-6)
    (u, v, _), (u0, v0, _) = (frame.views[0].camera.project(frame.joints_world).T, camera("side").project(joints[0]).T)
    np.testing.assert_allclose([u, v], [u0, v0], atol=1e-3)


def test_bad_files_are_one_clear_line(itop, people, joints, tmp_path, capsys):
    def error(root, *options):
        assert main(["evaluate", "itop", str(root), "--refit", "none", *options]) == 2
        printed = capsys.readouterr().err
        assert "Traceback" not in printed
        return printed

    assert "ITOP_side_test_depth_map.h5 not found" in error(tmp_path)
    (tmp_path / "ITOP_side_test_depth_map.h5.gz").write_bytes(b"")
    assert "gunzip" in error(tmp_path)
    (tmp_path / "ITOP_side_test_depth_map.h5").write_bytes((itop / "ITOP_side_test_depth_map.h5").read_bytes()[:-5000])
    assert "not a complete HDF5 file" in error(tmp_path) and "depth_map" in error(tmp_path)

    other = tmp_path / "other"
    write_itop(other, "test", people[:3], joints[:3])
    with h5py.File(other / "ITOP_side_test_depth_map.h5", "r+") as file:
        file["id"][...] = np.array(["07_00001", "01_00001", "07_00002"], dtype="S8")
    assert main(["evaluate", "itop", str(other), "--refit", "none", f"--json={other / 'n.json'}"]) == 0
    numbers = json.loads((other / "n.json").read_text())["ITOP side"]
    assert numbers["frames"] == 1
    assert "lacks 2 of 3 valid frames" in numbers["problems"][0]

    with h5py.File(other / "ITOP_side_test_labels.h5", "r+") as file:
        file["is_valid"][...] = 0
    assert "no frame is valid" in error(other)
    with h5py.File(other / "ITOP_side_test_labels.h5", "r+") as file:
        del file["segmentation"]
    assert "'segmentation' is missing" in error(other)


@pytest.mark.parametrize(
    ("file", "name", "value", "told"),
    [
        ("labels", "is_valid", None, "is no array"),
        ("labels", "is_valid", np.array([b"x", b""]), "is of the type"),
        ("labels", "segmentation", np.zeros((1, 240, 320), np.int8), "differ in length"),
        ("labels", "real_world_coordinates", np.zeros((2, 15, 3), np.complex64), "is of the type complex64"),
        ("depth_map", "data", np.zeros((1, 240, 320), np.float16), "differ in length"),
        ("depth_map", "data", np.array(1.0), r"is \(\), expected \(n, 240, 320\)"),
        ("depth_map", "id", np.arange(2), "is of the type int64"),
    ],
)
def test_data_sets_of_another_kind_are_refused(tmp_path, file, name, value, told):
    ids = np.array([b"00_00000", b"01_00001"])
    with h5py.File(tmp_path / "ITOP_side_test_depth_map.h5", "w") as depth:
        depth["id"], depth["data"] = ids, np.full((2, 240, 320), 2.5, np.float16)
    with h5py.File(tmp_path / "ITOP_side_test_labels.h5", "w") as labels:
        labels["id"], labels["is_valid"] = ids, np.ones(2, np.uint8)
        labels["real_world_coordinates"] = np.full((2, 15, 3), 0.5, np.float32)
        labels["segmentation"] = np.zeros((2, 240, 320), np.int8)
    assert len(Itop(tmp_path)) == 2
    with h5py.File(tmp_path / f"ITOP_side_test_{file}.h5", "r+") as spoilt:
        del spoilt[name]
        if value is None:
            spoilt.create_group(name)
        else:
            spoilt[name] = value
    with pytest.raises(InputError, match=told):
        list(Itop(tmp_path))
