"""The reader of Berkeley MHAD on small data of the true layout: known joints, and what is told of damaged files."""

import shutil

import numpy as np
import pytest
from mhad_files import camera, make_clips, rest_joints, true_joints, write_bvh, write_mhad

from depthmocap.datasets.annotated import AnnotatedSet
from depthmocap.datasets.mhad import MHAD_CORRESPONDENCE, MHAD_JOINTS, MhadSet, read_mhad_camera, read_pgm
from depthmocap.errors import InputError
from depthmocap.geometry.transforms import transform_points

FOLDER_1 = "Kinect/Kin01/S01/A01/R01"


@pytest.fixture(scope="module")
def clips():
    return make_clips(frames=3)


@pytest.fixture(scope="module")
def untouched(tmp_path_factory, clips):
    root = tmp_path_factory.mktemp("mhad")
    write_mhad(root, clips)
    return root


@pytest.fixture
def root(untouched, tmp_path):
    """A copy to damage."""
    return shutil.copytree(untouched, tmp_path / "mhad")


def test_joints_are_those_of_the_marker_system_and_lie_in_the_cloud(untouched, clips):
    source = MhadSet(untouched)
    assert isinstance(source, AnnotatedSet)
    frames = list(source)
    assert len(frames) == 12 and source.problems == []
    truths = {(f"s{c.subject:02d}", f"a{c.action:02d}"): true_joints(c) for c in clips}
    for frame in frames:
        truth = truths[frame.subject, frame.action][frame.frame]
        assert np.abs(frame.joints_world - truth).max() < 1e-6
        clouds = [
            transform_points(view.camera.world_from_camera, view.camera.unproject(view.depth_m, view.mask))[::3]
            for view in frame.views
        ]
        assert min(map(len, clouds)) > 2000
        distance = np.linalg.norm(np.concatenate(clouds)[:, None] - truth.astype(np.float32), axis=-1)
        assert distance.min(1).max() < 0.25  # only the person
        assert distance.min(0).max() < 0.25  # and all of them
    assert [v.camera.name for v in frames[0].views] == ["Kinect 1", "Kinect 2"]
    assert source.fps == 30


def test_names_tell_the_subjects_own_sides():
    rest = dict(zip(MHAD_JOINTS, rest_joints(), strict=True))
    assert rest["RHand"][0] < 0 < rest["LHand"][0] and rest["LToeEnd"][2] > rest["LFoot"][2]
    assert rest["HeadEnd"][1] == max(place[1] for place in rest.values())
    assert set(MHAD_CORRESPONDENCE) < set(MHAD_JOINTS) and len(set(MHAD_CORRESPONDENCE.values())) == 18


def test_a_skeleton_that_lists_the_left_side_first(root, clips):
    for clip in clips:
        write_bvh(root / f"Mocap/SkeletalData/skl_{clip.name}.bvh", clip, 16, left_first=True)
    assert np.abs(next(iter(MhadSet(root))).joints_world - true_joints(clips[0])[0]).max() < 1e-6


def test_cameras_are_read(untouched):
    for kinect in (1, 2):
        found, written = read_mhad_camera(untouched, kinect), camera(kinect)
        assert np.allclose(found.world_from_camera, written.world_from_camera, atol=1e-6)
        assert np.allclose(found.matrix, written.matrix) and np.allclose(found.distortion, written.distortion)


def test_parts_and_every_other_frame(untouched):
    frames = list(MhadSet(untouched, subjects=(2,), actions=(1,), every=2))
    assert [(f.subject, f.action, f.frame) for f in frames] == [("s02", "a01", 0), ("s02", "a01", 2)]
    with pytest.raises(InputError, match=r"none of the subjects \(7,\)"):
        MhadSet(untouched, subjects=(7,))


def test_what_is_missing_is_left_out_and_counted(root, clips):
    (root / FOLDER_1 / "kin_k01_s01_a01_r01_depth_00001.pgm").unlink()
    cut = root / "Kinect/Kin02/S01/A02/R01/kin_k02_s01_a02_r01_depth_00000.pgm"
    cut.write_bytes(cut.read_bytes()[:1000])
    (root / "Kinect/Correspondences/corr_moc_kin02_s02_a01_r01.txt").unlink()
    write_bvh(root / "Mocap/SkeletalData/skl_s02_a02_r01.bvh", clips[3], 16, drop_end=True)
    source = MhadSet(root)
    assert [(f.subject, f.action, f.frame) for f in source] == [
        ("s01", "a01", 0), ("s01", "a01", 2), ("s01", "a02", 1), ("s01", "a02", 2),
    ]  # fmt: skip
    lost, cut_off, unmatched, other = source.problems
    assert "s01_a01_r01: 1 of 3 frames left out" in lost and "00001.pgm not found" in lost
    assert "s01_a02_r01: 1 of 3 frames" in cut_off and "is cut off" in cut_off
    assert "corr_moc_kin02_s02_a01_r01.txt not found" in unmatched
    assert "skl_s02_a02_r01.bvh has 31 joints and ends, expected 35" in other


def test_of_half_a_download_the_half_is_read(root):
    for action in (1, 2):
        shutil.rmtree(root / f"Kinect/Kin02/S02/A0{action}")
    source = MhadSet(root)
    assert {frame.subject for frame in source} == {"s01"}
    (problem,) = source.problems
    assert "2 sequences left out, the first because" in problem and "Kin02/S02/A01/R01 not found" in problem


def test_a_skeleton_that_ends_too_early(root, clips):
    write_bvh(root / "Mocap/SkeletalData/skl_s01_a01_r01.bvh", clips[0], times=5)
    source = MhadSet(root, subjects=(1,), actions=(1,))
    assert list(source) == [] and "has 15 frames, but" in source.problems[0]


@pytest.mark.parametrize(
    ("name", "old", "new", "told"),
    [
        ("RwTw_k01.txt", "Rw=", "Rw=1 ", "must hold a line Rw= with 9 numbers"),
        ("RwTw_k02.txt", "Rw=", "Rw=-0.5 0 0 0 1 0 0 0 1\n", "not a rotation"),
        ("camcfg_k02.yml", "Camera_1", "Camera_2", "must hold Camera_1"),
        ("camcfg_k01.yml", "3.146400000e+02", "9.146400000e+02", "640×480"),
        ("camcfg_k01.yml", "opencv-matrix", "\0", "must hold Camera_1"),
        ("camcfg_k02.yml", "rows: 3", "rows: 99999999999", "must hold Camera_1"),
        ("camcfg_k01.yml", "K:", "K: \xff", "not text in UTF-8"),
    ],
)
def test_calibration_that_cannot_be(root, name, old, new, told):
    path = root / "Calibration" / name
    assert old in path.read_text()
    path.write_bytes(path.read_text().replace(old, new, 1).encode("latin-1"))
    with pytest.raises(InputError, match=f"{name}.*{told}"):
        MhadSet(root)


@pytest.mark.parametrize("header", [b"P5 640 480 " + b"9" * 5000, b"P5 " + b"# " * 40 + b"x", b"P5 #" * 40])
def test_a_picture_with_a_header_that_lies_is_refused_at_once(tmp_path, header):
    (tmp_path / "depth.pgm").write_bytes(header + b"\n" + bytes(100))
    with pytest.raises(InputError, match="not a binary PGM"):
        read_pgm(tmp_path / "depth.pgm")


@pytest.mark.parametrize(
    "text", ["", "# nothing\n", "1 2\n", "1 2 x\n", "1 2 1e300\n", "1 2 nan\n", "1 2 -1\n", "\xff"]
)
def test_correspondences_that_cannot_be_leave_their_sequence_out(root, text):
    path = root / "Kinect/Correspondences/corr_moc_kin01_s01_a01_r01.txt"
    path.write_bytes(text.encode("latin-1"))
    source = MhadSet(root, subjects=(1,), actions=(1,))
    assert list(source) == []
    assert path.name in source.problems[0] and len(source.problems) == 1


def test_calibration_of_another_day_disagrees_with_the_pictures(root):
    path = root / "Calibration/RwTw_k02.txt"
    rotation, _ = path.read_text().splitlines()
    path.write_text(f"{rotation}\nTw=900 500 3000\n")
    with pytest.raises(InputError, match=r"RwTw_k02.txt and camcfg_k02.yml disagree with the pictures"):
        next(iter(MhadSet(root)))


def test_a_folder_that_is_another(tmp_path, root):
    with pytest.raises(InputError, match="give the folder with the Kinect, Mocap and Calibration"):
        MhadSet(tmp_path / "nothing")
    (root / "Calibration/RwTw_k01.txt").unlink()
    with pytest.raises(InputError, match=r"RwTw_k01.txt not found"):
        MhadSet(root)
