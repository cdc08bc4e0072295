"""The reader of CMU Panoptic on small data of the true layout: known joints, and what is told of damaged files."""

import json
import shutil

import numpy as np
import pytest
from mhad_files import make_clips, true_joints
from panoptic_files import DOME, camera, true_joints19, write_panoptic

from depthmocap.body.skeleton import JOINTS as BODY_JOINTS
from depthmocap.cli import main
from depthmocap.datasets.annotated import AnnotatedSet
from depthmocap.datasets.mhad import MHAD_CORRESPONDENCE, MHAD_JOINTS
from depthmocap.datasets.panoptic import PANOPTIC_CORRESPONDENCE, PANOPTIC_JOINTS, PanopticSequence, PanopticSet
from depthmocap.errors import InputError
from depthmocap.evaluate import protocol
from depthmocap.geometry.transforms import transform_points

JOINTS = np.concatenate([true_joints(clip) for clip in make_clips((1,), (1, 2), frames=2)])


@pytest.fixture(scope="module")
def untouched(tmp_path_factory):
    root = tmp_path_factory.mktemp("panoptic")
    write_panoptic(root / "dance1", JOINTS)
    return root


@pytest.fixture
def folder(untouched, tmp_path):
    """A copy to damage."""
    return shutil.copytree(untouched / "dance1", tmp_path / "dance1")


def test_joints_are_those_of_the_dome_and_lie_in_the_cloud(untouched):
    source = PanopticSet(untouched)
    assert isinstance(source, AnnotatedSet) and source.up == "-y"
    frames = list(source)
    assert [frame.frame for frame in frames] == [100, 101, 102, 103] and source.problems == []
    for frame, truth in zip(frames, true_joints19(JOINTS), strict=True):
        assert np.isnan(frame.joints_world[PANOPTIC_JOINTS.index("LEye")]).all()
        known = np.arange(19) != PANOPTIC_JOINTS.index("LEye")
        assert np.abs(frame.joints_world[known] - truth[known]).max() < 1e-6
        clouds = [
            transform_points(view.camera.world_from_camera, view.camera.unproject(view.depth_m, view.mask))[::3]
            for view in frame.views
        ]
        assert len(clouds) == 3 and min(map(len, clouds)) > 500
        distance = np.linalg.norm(np.concatenate(clouds)[:, None] - truth[known].astype(np.float32), axis=-1)
        assert distance.min(1).max() < 0.35  # only the person, whose toes are far from any of these joints
        assert distance.min(0).max() < 0.2  # and all of them
    assert (frames[0].subject, frames[0].action) == ("dance1", "dance1")


def test_cameras_are_in_the_domes_world(untouched):
    sequence = PanopticSequence(untouched / "dance1", (2,), 0.2, "to-colour")
    assert np.allclose(sequence.cameras[2].world_from_camera, camera(2).world_from_camera, atol=1e-9)
    other = PanopticSequence(untouched / "dance1", (2,), 0.2, "from-colour").cameras[2]
    assert 0.08 < np.linalg.norm((other.world_from_camera - camera(2).world_from_camera)[:3, 3]) < 0.12


def test_names():
    assert len(PANOPTIC_JOINTS) == 19 and set(PANOPTIC_CORRESPONDENCE) < set(PANOPTIC_JOINTS)
    assert PANOPTIC_CORRESPONDENCE["RWrist"] == "RHand" and PANOPTIC_CORRESPONDENCE["BodyCenter"] == "Hip"


def test_some_kinects_some_frames_and_sure_joints_only(folder):
    frames = list(PanopticSet(folder, kinects=(1, 3), every=3))
    assert [frame.frame for frame in frames] == [100, 103]
    assert [view.camera.name for view in frames[0].views] == ["Kinect 1", "Kinect 3"]
    unsure = PanopticSet(folder, confidence=0.7)
    assert list(unsure) == [] and "4 frames left out, no joint of confidence 0.7" in unsure.problems[0]


def test_what_is_missing_is_left_out_and_counted(folder):
    depth = folder / "kinect_shared_depth"
    (depth / "KINECTNODE1/depthdata.dat").unlink()
    for kinect, frames in ((2, 12), (3, 11)):
        path = depth / f"KINECTNODE{kinect}" / "depthdata.dat"
        path.write_bytes(path.read_bytes()[: 512 * 424 * 2 * frames])
    scene = folder / "hdPose3d_stage1_coco19/body3DScene_00000100.json"
    person = json.loads(scene.read_text())["bodies"][0]
    scene.write_text(json.dumps({"bodies": [person, person]}))
    source = PanopticSet(folder)
    frames = list(source)
    assert [(frame.frame, len(frame.views)) for frame in frames] == [(101, 1)]
    first, several, cut = source.problems
    assert "Kinect 1 left out" in first and "KINECTNODE1/depthdata.dat not found" in first
    assert "1 frames left out, several people" in several
    assert "2 frames left out" in cut and "KINECTNODE3/depthdata.dat is cut off: it has 11 frames" in cut


def test_kinects_out_of_step_and_joints_beyond_the_table(folder):
    path = folder / "ksynctables_dance1.json"
    document = json.loads(path.read_text())
    for times in document["kinect"]["depth"].values():
        times["univ_time"] = (np.array(times["univ_time"])[:-2] - 1).tolist()
    path.write_text(json.dumps(document))
    path = folder / "synctables_dance1.json"
    document = json.loads(path.read_text())
    document["hd"]["univ_time"] = document["hd"]["univ_time"][:-1]
    path.write_text(json.dumps(document))
    source = PanopticSet(folder)
    assert [frame.frame for frame in source] == [100, 101]
    assert "no Kinect has a picture within 17 ms" in source.problems[0]
    assert "synctables_dance1.json ends before them" in source.problems[1]


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("kcalibration", lambda d: d["sensors"][1].pop("K_depth"), "'K_depth'"),
        ("kcalibration", lambda d: d["sensors"][0].update(M_color=[[2, 0, 0, 0]] * 3), "not a rotation"),
        (
            "kcalibration",
            lambda d: d["sensors"][0].update(K_depth=[[900, 0, 960], [0, 900, 540], [0, 0, 1]]),
            "512×424",
        ),
        ("calibration", lambda d: d["cameras"].pop(), "no camera 50_03"),
        (
            "calibration",
            lambda d: d["cameras"][1].update(t=[[0], [-100], [900]]),
            "disagree with the pictures of Kinect 1",
        ),
        ("ksynctables", lambda d: d["kinect"]["depth"].pop("KINECTNODE2"), "kinect.depth.KINECTNODE2.univ_time"),
        ("synctables", lambda d: d.update(hd={}), "the times hd.univ_time"),
    ],
)
def test_a_sequence_that_cannot_be_read_is_named(folder, name, change, told):
    path = folder / f"{name}_dance1.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    source = PanopticSet(folder)
    assert list(source) == []
    assert "dance1: left out" in source.problems[-1] and told in source.problems[-1]


def test_files_that_are_not_there(folder, tmp_path):
    with pytest.raises(InputError, match="neither it nor a folder in it holds kcalibration"):
        PanopticSet(tmp_path / "none")
    (folder / "synctables_dance1.json").write_text('{"hd"')
    source = PanopticSet(folder)
    assert list(source) == [] and "synctables_dance1.json is not valid JSON" in source.problems[-1]


class Scripted:
    """An estimator that finds the true joints of one frame after the other 4 cm to the side."""

    def __init__(self):
        ours = [{o: t for t, o in MHAD_CORRESPONDENCE.items()}[joint] for joint in BODY_JOINTS]
        rows = [MHAD_JOINTS.index(joint) for joint in ours]
        self._frames = iter(JOINTS[:, rows] @ DOME + [0.04, 0.0, 0.0])

    def __call__(self, cloud, up="z"):
        assert up == "-y" and len(cloud.cameras) == 3
        return next(self._frames), np.full(len(BODY_JOINTS), 0.8)


def test_known_distances_are_the_errors(untouched, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(protocol, "load_estimator", lambda source: Scripted())
    files = [tmp_path / name for name in ("n.json", "n.csv")]
    assert main(["evaluate", "panoptic", str(untouched), f"--json={files[0]}", f"--csv={files[1]}"]) == 0
    numbers = json.loads(files[0].read_text())["CMU Panoptic"]
    assert numbers["frames"] == 4 and set(numbers["joints"]) == set(PANOPTIC_CORRESPONDENCE)
    assert numbers["mean_joint_error_cm"] == pytest.approx(4, abs=1e-3)
    assert numbers["per_joint_error_cm"]["LAnkle"] == pytest.approx(4, abs=1e-3)
    assert files[1].read_text().count("\n") == 1 + len(PANOPTIC_CORRESPONDENCE)
    assert main(["evaluate", "panoptic", str(tmp_path)]) == 2
    assert "kcalibration_<sequence>.json" in capsys.readouterr().err
