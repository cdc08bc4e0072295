"""EVAL in its true layout, through the command line: joints at known distances from what the pipeline finds."""

import json

import numpy as np
import pytest
from people_files import picked, scenes

from depthmocap import InputError
from depthmocap.body.skeleton import JOINTS
from depthmocap.cli import main
from depthmocap.datasets.annotated import near_joints
from depthmocap.datasets.eval3d import HEIGHT, RECORD, WIDTH, Eval
from depthmocap.geometry import DepthCamera

CAMERA = DepthCamera("eval", WIDTH, HEIGHT, 257.6, 257.6, 159.5, 119.5)
NAMES = ("Head", "Neck", "RShoulder", "RHand", "LFoot")
NUMBERS = (4, 0, 7, 30, 11)
EACH = 6


def write_sequence(path, depths_m, joints, axes=(1, -1, -1)):
    """``joints`` of NAMES in the camera's frame; ``axes`` are the file's: by default x right, y up, z backwards."""
    records = np.zeros(len(depths_m), RECORD)
    records["magic"], records["frame"] = 1234, np.arange(len(depths_m)) + 100
    for record, depth_m, points in zip(records, depths_m, joints, strict=True):
        rays = np.concatenate([CAMERA.rays, np.ones((HEIGHT, WIDTH, 1), np.float32)], -1)
        record["points"] = rays * depth_m[..., None] * axes
        record["joint_count"] = len(NUMBERS) + 1
        record["joints"]["id"][: len(NUMBERS) + 1] = [*NUMBERS, 99]
        record["joints"]["at"][: len(NUMBERS)] = points * axes
        record["joints"]["at"][len(NUMBERS)] = 1.0
    path.write_bytes(records.tobytes())


@pytest.fixture(scope="session")
def people(default_body):
    return scenes(default_body, CAMERA, 3 * EACH)


@pytest.fixture(scope="session")
def joints(people):
    return picked(np.stack([each.joints for each in people]), {name: name for name in NAMES}, NAMES)


@pytest.fixture(scope="session")
def folder(people, joints, tmp_path_factory):
    """Three people; every joint is 3 cm under ours, but the right hand 12 cm."""
    root = tmp_path_factory.mktemp("eval")
    truth = joints + np.array([0, 0.03, 0])
    truth[:, NAMES.index("RHand"), 1] += 0.09
    for i, person in enumerate("abc"):
        rows = slice(i * EACH, (i + 1) * EACH)
        write_sequence(root / f"seq_{person}_0.bin", [each.depth_m for each in people[rows]], truth[rows])
    (root / "names.json").write_text(json.dumps(dict(zip(NUMBERS, NAMES, strict=True))))
    return root


def evaluate(folder, out, *options):
    assert main(["evaluate", "eval", str(folder), "--mask", "all", f"--json={out}", *options]) == 0
    return json.loads(out.read_text())["EVAL"]


def test_known_distances_are_the_errors(folder, tmp_path):
    names = f"--names={folder / 'names.json'}"
    numbers = evaluate(folder, tmp_path / "n.json", names, "--refit=none", f"--report={tmp_path / 'r.html'}")
    assert numbers["joints"] == list(NAMES)
    assert numbers["frames"] == 3 * EACH
    assert numbers["mean_joint_error_cm"] == pytest.approx((4 * 3 + 12) / 5, abs=0.01)
    assert numbers["mean_ap_10cm"] == pytest.approx(4 / 5)
    assert {name: each["frames"] for name, each in numbers["by_subject"].items()} == {"a": EACH, "b": EACH, "c": EACH}
    assert list(numbers["by_action"]) == ["a_0", "b_0", "c_0"]
    assert "ids 99 have no name" in numbers["problems"][0]
    assert "b_0" in (tmp_path / "r.html").read_text()


def test_every_person_by_a_fit_to_the_others(folder, tmp_path):
    named = evaluate(folder, tmp_path / "n.json", f"--names={folder / 'names.json'}")
    assert named["mean_joint_error_cm"] < 0.2
    # Without names the fit finds out which joints they are. (The joint of id 99 is at one place of the world.)
    unnamed = evaluate(folder, tmp_path / "u.json")
    assert unnamed["joints"] == ["joint 0", "joint 4", "joint 7", "joint 11", "joint 30", "joint 99"]
    assert unnamed["per_joint_error_cm"]["joint 0"] < 4
    assert unnamed["reliability"]["joints"] == []


@pytest.mark.parametrize("axes", [(1, -1, -1), (1, -1, 1), (1, 1, 1), (-1, 1, -1)])
def test_camera_and_axes_follow_from_the_cloud(people, joints, tmp_path, axes):
    write_sequence(tmp_path / "seq_a_0.bin", [people[0].depth_m], joints[:1], axes)
    names: dict[int, str] = dict(zip(NUMBERS, NAMES, strict=True))
    frame = next(iter(Eval(tmp_path, names, "all")))
    camera = frame.views[0].camera
    found = [camera.fx, camera.fy, camera.cx, camera.cy]
    np.testing.assert_allclose(found, [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy], atol=0.01)
    np.testing.assert_allclose(frame.views[0].depth_m, people[0].depth_m, atol=1e-6)
    np.testing.assert_allclose(frame.joints_world, joints[0], atol=1e-6)
    assert (frame.subject, frame.action, frame.frame) == ("a", "a_0", 100)


def test_the_person_before_a_wall(people, joints, tmp_path):
    """By turns at the left and at the right: what stands still is the room."""
    depths, truths = [], []
    for i in range(10):
        side = 60 if i % 2 else -60
        depth = np.roll(people[i].depth_m, side, axis=1)
        depths.append(np.where(depth > 0, depth, np.float32(4)))
        truths.append(joints[i] + [side / CAMERA.fx * 2.6, 0, 0])
    write_sequence(tmp_path / "seq_a_0.bin", depths, truths)
    names: dict[int, str] = dict(zip(NUMBERS, NAMES, strict=True))
    for frame, depth in zip(Eval(tmp_path, names), depths, strict=True):
        mask = frame.views[0].mask
        assert (mask & (depth < 4)).sum() > 0.95 * (depth < 4).sum()
        assert (mask & (depth == 4)).sum() < 20
    for frame, depth in zip(Eval(tmp_path, names, "box"), depths, strict=True):
        # Five joints span less than the body; none of the wall is near them.
        np.testing.assert_array_equal(frame.views[0].mask, near_joints(frame.views[0], frame.joints_world))
        assert (frame.views[0].mask & (depth < 4)).sum() > 0.5 * (depth < 4).sum()
        assert not (frame.views[0].mask & (depth == 4)).any()


def test_bad_files(folder, people, joints, tmp_path, capsys):
    def error(root, *options):
        assert main(["evaluate", "eval", str(root), "--mask=all", "--refit=none", *options]) == 2
        printed = capsys.readouterr().err
        assert "Traceback" not in printed
        return printed

    assert "holds no seq_*.bin" in error(tmp_path)
    assert "pass --refit ridge" in error(folder)
    table = tmp_path / "names.json"
    table.write_text("[]")
    assert "must be JSON such as" in error(folder, f"--names={table}")
    table.write_text('{"77": "Head"}')
    assert "none of the joint ids" in error(folder, f"--names={table}")

    # Half downloaded: the whole records are read. Damaged: left out, and counted.
    whole = (folder / "seq_a_0.bin").read_bytes()
    records = np.frombuffer(whole, RECORD)[:4].copy()
    records["magic"][1] = 7
    records["joints"]["at"][2, 1] = np.nan
    (tmp_path / "seq_a_0.bin").write_bytes(records.tobytes() + whole[:1000])
    (tmp_path / "seq_b_0.bin").write_bytes(whole[:1000])
    source = Eval(tmp_path, dict(zip(NUMBERS, NAMES, strict=True)), "all")
    frames = list(source)
    assert [len(frame.views) for frame in frames] == [1, 0, 1, 1]
    assert np.isnan(frames[2].joints_world[1]).all() and np.isfinite(frames[2].joints_world[[0, 2, 3, 4]]).all()
    problems = " ".join(source.problems)
    assert "seq_a_0.bin ends within a record" in problems and "seq_b_0.bin ends within" in problems
    assert "record 1 is damaged" in problems

    records["points"] = np.random.default_rng(0).normal(size=records["points"].shape)
    (tmp_path / "seq_a_0.bin").write_bytes(records.tobytes())
    with pytest.raises(InputError, match="not one of 240 × 320 pixels"):
        Eval(tmp_path)


def test_names_of_ours_only_are_tied(folder):
    source = Eval(folder, {4: "Head", 0: "Nose"}, "all")
    assert source.joints == ("Head", "Nose") and source.correspondence == {"Head": "Head"}
    assert set(source.correspondence.values()) <= set(JOINTS)
