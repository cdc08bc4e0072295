"""The protocols on Berkeley MHAD, through the command line: joints found at known distances from the truth."""

import json

import numpy as np
import pytest
from mhad_files import make_clips, true_joints, write_mhad

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.cli import main
from depthmocap.datasets.mhad import MHAD_CORRESPONDENCE, MHAD_JOINTS, MhadSet
from depthmocap.evaluate import estimated_frames, protocol
from depthmocap.evaluate import mhad_protocol as mhad

CLIPS = make_clips(frames=5, actions=(1, 2))
OUR_JOINTS_IN_MHAD = [
    MHAD_JOINTS.index({ours: theirs for theirs, ours in MHAD_CORRESPONDENCE.items()}[joint]) for joint in JOINTS
]


class Scripted:
    """An estimator that finds the true joints of one frame after the other, moved."""

    def __init__(self, moved, every):
        self._frames = iter(np.concatenate([true_joints(clip)[::every, OUR_JOINTS_IN_MHAD] for clip in CLIPS]) + moved)

    def __call__(self, cloud, up="z"):
        assert up == "y"
        return next(self._frames), np.full(len(JOINTS), 0.8)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("mhad")
    write_mhad(root, CLIPS)
    return root


@pytest.fixture
def run(root, tmp_path, monkeypatch):
    def run(*options, moved=0.0, every=1):
        monkeypatch.setattr(protocol, "load_estimator", lambda source: Scripted(moved, every))
        path = tmp_path / "numbers.json"
        assert main(["evaluate", "mhad", str(root), f"--json={path}", f"--every={every}", *options]) == 0
        return json.loads(path.read_text())

    return run


def test_known_distances_are_the_errors(run, tmp_path):
    moved = np.zeros((18, 3))
    moved[:, 1] = 0.03
    moved[JOINTS.index("LKnee"), 1] = 0.12
    found = run("--refit", "none", f"--csv={tmp_path / 'j.csv'}", moved=moved, every=2)
    assert list(found) == [
        "18 joints", "18 joints, hands in the cloud", "16 joints", "16 joints, hands in the cloud",
        "Michel's joints, subjects", "Michel's joints, actions",
    ]  # fmt: skip
    everything = found["18 joints"]
    assert everything["frames"] == 12 and everything["frames_left_out"] == 0
    assert everything["mean_joint_error_cm"] == pytest.approx((17 * 3 + 12) / 18, abs=1e-3)
    assert everything["per_joint_error_cm"]["LKnee"] == pytest.approx(12, abs=1e-3)
    assert everything["within_10cm"] == pytest.approx(17 / 18)
    assert found["16 joints"]["mean_joint_error_cm"] == pytest.approx((15 * 3 + 12) / 16, abs=1e-3)
    # Of Michel's 14 joints our 18 have all but the top of the head.
    assert found["Michel's joints, actions"]["mean_joint_error_cm"] == pytest.approx((12 * 3 + 12) / 13, abs=1e-3)
    assert found["Michel's joints, subjects"]["deviation_of_frames_cm"] == pytest.approx(0, abs=1e-3)
    assert {name: each["frames"] for name, each in everything["by_action"].items()} == {"a01": 6, "a02": 6}
    assert "18 joints,LKnee,12.0000" in (tmp_path / "j.csv").read_text()


def test_a_fit_to_the_others_learns_where_the_set_puts_its_joints(run, monkeypatch):
    # These people are sticks, of which labels mean little: the joints alone are fitted.
    estimate = estimated_frames._estimate_frame
    unseen = {"centres": np.full((REGION_COUNT, 3), np.nan)}
    monkeypatch.setattr(estimated_frames, "_estimate_frame", lambda *given: estimate(*given) | unseen)
    found = run(moved=np.array([0.0, 0.05, 0.0]))
    assert found["35 joints"]["mean_joint_error_cm"] < 4
    assert found["29 joints"]["joints"] == list(mhad.JOINT_TABLES["reliable"])
    assert set(found["35 joints"]["joints"]) == set(MHAD_JOINTS)
    assert found["Michel's joints, subjects"]["frames"] == 20


def test_joints_of_ones_own_tables(run, tmp_path, capsys, root):
    table = tmp_path / "joints.json"
    table.write_text('{"michel": ["RKnee", "LKnee"]}')
    moved = np.zeros((18, 3))
    moved[JOINTS.index("LKnee"), 1] = 0.04
    found = run("--refit", "none", f"--joint-table={table}", moved=moved, every=5)
    assert found["Michel's joints, subjects"]["mean_joint_error_cm"] == pytest.approx(2, abs=1e-3)
    for text, told in (
        ('{"michel": ["Tail"]}', "'Tail'; the joints are Hips"),
        ('{"mine": ["RKnee"]}', "must be an object"),
        ('{"michel": []}', "must be a list of joints"),
        ("{", "not valid JSON"),
    ):
        table.write_text(text)
        assert main(["evaluate", "mhad", str(root), f"--joint-table={table}"]) == 2
        assert told in capsys.readouterr().err


def test_hands_outside_the_cloud(root):
    frame = next(iter(MhadSet(root)))
    assert mhad.hands_in_cloud(frame)
    frame.joints_world[MHAD_JOINTS.index("LHandEnd"), 1] += 0.9
    assert not mhad.hands_in_cloud(frame)


def test_one_person_alone(run, root, capsys):
    assert main(["evaluate", "mhad", str(root), "--subjects", "1", "--every", "5"]) == 2
    assert "--refit none" in capsys.readouterr().err
    found = run("--refit", "none", "--subjects", "1", every=5)
    assert "Michel's joints, subjects" not in found and "Michel's joints, actions" in found
    assert any("only one of the subjects" in problem for problem in found["18 joints"]["problems"])
