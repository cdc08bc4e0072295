"""UBC3V: reading what the writer wrote, resuming, and finding sections."""

import dataclasses
import errno
import io
import itertools

import numpy as np
import pytest
from file_contents import tree
from PIL import Image
from scipy.io import loadmat
from ubc3v_files import EYES, HALF_STEP_M, SHAPE, make_views, write_section

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.datasets.ubc3v import (
    MAYA_JOINTS,
    UNLABELLED,
    Section,
    image_paths,
    iterate,
    kinect2_camera,
    sections,
)
from depthmocap.datasets.ubc3v_write import SectionWriter
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.transforms import look_at, transform_points

pytest.importorskip("isal")


def test_section_round_trip(tmp_path):
    path, samples = write_section(tmp_path)
    section = Section(path)
    assert (len(section), section.up) == (3, "z")
    frames = list(section)
    assert [frame.timestamp_ns for frame in frames] == [0, 33333333, 66666667]
    for frame, (views, joints) in zip(frames, samples, strict=True):
        assert frame.true_joints is not None
        np.testing.assert_allclose(frame.true_joints, joints, atol=1e-9)
        assert [view.camera.name for view in frame.views] == ["Cam1", "Cam2", "Cam3"]
        for view, written in zip(frame.views, views, strict=True):
            assert view.mask is not None
            assert (view.mask == written.mask).all()
            assert view.labels is not None
            assert (view.labels == written.labels).all()
            assert np.abs(view.depth_m - written.depth_m).max() <= HALF_STEP_M
            np.testing.assert_allclose(view.camera.world_from_camera, written.camera.world_from_camera, atol=1e-9)
    assert section[-1].timestamp_ns == frames[2].timestamp_ns
    with pytest.raises(IndexError):
        section[3]


def test_points_keep_their_place_in_the_world(tmp_path):
    """A person at known world points is found there again, from each camera's pixels."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-0.4, -0.4, 0.3], [0.4, 0.4, 1.7], (200, 3))
    views = []
    for k, eye in enumerate(EYES, 1):
        camera = kinect2_camera(f"Cam{k}", look_at(np.array(eye), np.array([0.0, 0.0, 1.0])))
        depth = np.zeros(SHAPE, np.float32)
        u, v, z = camera.project(points).T
        inside = (u > 0) & (u < 511) & (v > 0) & (v < 423)
        assert inside.mean() > 0.8
        depth[v[inside].round().astype(int), u[inside].round().astype(int)] = z[inside]
        views.append(View(camera, depth))
    with SectionWriter(tmp_path, "easy-pose", "test", 7) as writer:
        writer.write(views, np.zeros((18, 3)))
    for view in Section(writer.path)[0].views:
        found = transform_points(view.camera.world_from_camera, view.camera.unproject(view.depth_m, view.mask))
        nearest = np.linalg.norm(found[:, None] - points, axis=-1).min(1)
        assert len(found) > 150
        assert nearest.max() < 0.03  # half a depth step and half a pixel


def test_layout_of_groundtruth(tmp_path):
    path, samples = write_section(tmp_path, count=2)
    mat = loadmat(path / "groundtruth.mat", struct_as_record=False)
    assert mat["joints"].dtype == object
    assert mat["joints"].shape == (1, 2)
    joints = mat["joints"][0, 1][0, 0]
    assert joints._fieldnames == sorted(joints._fieldnames)
    assert len(joints._fieldnames) == 28
    for name, maya in MAYA_JOINTS.items():
        matrix = getattr(joints, maya)
        assert matrix.shape == (1, 16)
        x, y, z = samples[1][1][JOINT_INDEX[name]] * 100
        np.testing.assert_allclose(matrix[0, 12:15], [x, z, -y])
    frames = mat["cameras"][0, 0].Cam2[0, 0].frames
    assert frames.shape == (1, 2)
    assert frames[0, 0][0, 0].translate.shape == (1, 3)
    assert frames[0, 0][0, 0].rotate.shape == (1, 3)
    with Image.open(image_paths(path, "Cam1", 1)[0]) as image:
        assert (image.mode, image.size) == ("RGBA", (512, 424))
    assert image_paths(path, "Cam1", 1)[0].name == "mayaProject.000002.png"


def test_single_frame_without_labels(tmp_path):
    path, samples = write_section(tmp_path, count=1, labels=False)
    (frame,) = Section(path)
    for view, written in zip(frame.views, samples[0][0], strict=True):
        assert view.labels is None
        assert view.mask is not None
        assert (view.mask == written.mask).all()


def test_mask_without_depth_and_person_without_label(tmp_path):
    (view, *_) = make_views(np.random.default_rng(0))
    view.depth_m[160, 210] = 0
    view.labels[161, 210] = 0
    with SectionWriter(tmp_path, "s", "test", 1) as writer:
        writer.write([view], np.zeros((18, 3)))
    (back,) = Section(writer.path)[0].views
    assert (back.mask == view.mask).all()
    assert back.depth_m[160, 210] == 0
    assert back.labels is not None and back.labels[161, 210] == UNLABELLED


def test_missing_views(tmp_path):
    path, samples = write_section(tmp_path, count=2)
    image_paths(path, "Cam2", 0)[0].unlink()
    assert [view.camera.name for view in Section(path)[0].views] == ["Cam1", "Cam3"]
    assert [view.camera.name for view in Section(path, cameras=["Cam3"])[0].views] == ["Cam3"]
    with SectionWriter(tmp_path, "easy-pose", "train", 1) as writer:  # a camera that failed and one that joined
        _, second, third = samples[0][0]
        fourth = dataclasses.replace(third, camera=dataclasses.replace(third.camera, name="Cam4"))
        writer.write([second, fourth], samples[0][1])
    section = Section(path, cameras=["Cam1", "Cam2", "Cam3", "Cam4"])
    assert [[view.camera.name for view in frame.views] for frame in section] == [
        ["Cam1", "Cam3"],
        ["Cam1", "Cam2", "Cam3"],
        ["Cam2", "Cam4"],
    ]


def test_resume(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    samples = [(make_views(rng, EYES[:1]), rng.uniform(-1, 1, (18, 3))) for _ in range(4)]
    interrupted = SectionWriter(tmp_path, "easy-pose", "train", 1)
    for seconds, (views, joints) in zip((1e9, 0, 1e9), samples[:3], strict=True):
        monkeypatch.setattr("depthmocap.datasets.ubc3v_write._SAVE_EVERY_S", seconds)
        interrupted.write(views, joints)
    assert len(interrupted) == 3
    path = interrupted.path
    assert len(Section(path)) == 2  # the third was never recorded, though its image lies there
    with SectionWriter(tmp_path, "easy-pose", "train", 1) as writer:
        assert len(writer) == 2
        for views, joints in samples[2:]:
            writer.write([dataclasses.replace(views[0], labels=None)], joints)
    section = Section(path)
    assert len(section) == 4
    assert not list(path.glob("*.part"))
    assert [frame.views[0].labels is None for frame in section] == [False, False, True, True]
    for frame, (views, joints) in zip(section, samples, strict=True):
        assert frame.true_joints is not None
        np.testing.assert_allclose(frame.true_joints, joints, atol=1e-9)
        camera, written = frame.views[0].camera, views[0].camera
        np.testing.assert_allclose(camera.world_from_camera, written.world_from_camera, atol=1e-9)


def test_a_resumed_section_has_the_bytes_of_an_uninterrupted_one(tmp_path):
    rng = np.random.default_rng(2)
    samples = [(make_views(rng, EYES[: 1 + i % 2]), rng.uniform(-1, 1, (18, 3))) for i in range(4)]
    for root, parts in ((tmp_path / "a", (4,)), (tmp_path / "b", (1, 3))):
        left = iter(samples)
        for count in parts:
            with SectionWriter(root, "easy-pose", "train", 1) as writer:
                for views, joints in itertools.islice(left, count):
                    writer.write(views, joints)
    files = {root: tree(tmp_path / root) for root in "ab"}
    assert len(files["a"]) == 13
    assert files["a"] == files["b"]


def test_a_full_disk_leaves_the_last_truth(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    path, _ = write_section(tmp_path, count=1)
    before = (path / "groundtruth.mat").read_bytes()
    writer = SectionWriter(tmp_path, "easy-pose", "train", 1)
    writer.write(make_views(rng), np.zeros((18, 3)))

    class Full(io.FileIO):
        def write(self, data):
            super().write(data[:100])
            raise OSError(errno.ENOSPC, "No space left on device", self.name)

    with monkeypatch.context() as patch:
        patch.setattr("depthmocap.datasets.ubc3v_write.open_new", lambda path: Full(path, "xb"))
        with pytest.raises(OSError, match="No space"):
            writer.close()
    assert (path / "groundtruth.mat").read_bytes() == before
    assert not list(path.glob("*.part"))
    writer.close()
    assert len(Section(path)) == 2


def test_writer_keeps_what_was_done_when_interrupted(tmp_path):
    rng = np.random.default_rng(0)
    with pytest.raises(KeyboardInterrupt), SectionWriter(tmp_path, "easy-pose", "train", 1) as writer:
        writer.write(make_views(rng, EYES[:1]), np.zeros((18, 3)))
        raise KeyboardInterrupt
    assert len(Section(writer.path)) == 1


def test_writer_rejects_what_the_format_cannot_hold(tmp_path, monkeypatch):
    (view,) = make_views(np.random.default_rng(0), EYES[:1])
    joints = np.zeros((18, 3))
    writer = SectionWriter(tmp_path, "easy-pose", "train", 1)

    def changed(**values):
        return dataclasses.replace(view, camera=dataclasses.replace(view.camera, **values))

    for views, message in [
        ([], "named Cam1"),
        ([view, view], "each once"),
        ([changed(name="left")], "named Cam1"),
        ([changed(fx=500.0)], "intrinsics"),
        ([changed(distortion=(0.1, 0.0, 0.0, 0.0, 0.0))], "intrinsics"),
        ([changed(world_from_camera=look_at(np.ones(3), np.zeros(3), 0.3))], "roll"),
        ([View(view.camera, np.ones((4, 5)))], "images must be"),
        ([dataclasses.replace(view, labels=np.full(SHAPE, 50, np.uint8))], "0 to 43"),
    ]:
        with pytest.raises(ValueError, match=message):
            writer.write(views, joints)
    with pytest.raises(ValueError, match="finite"):
        writer.write([view], np.full((18, 3), np.nan))
    assert len(writer) == 0
    writer.close()
    assert not (writer.path / "groundtruth.mat").exists()
    monkeypatch.setattr("depthmocap.datasets.ubc3v_write.FRAMES_PER_SECTION", 1)
    writer.write([view], joints)
    assert writer.full
    with pytest.raises(ValueError, match="full"):
        writer.write([view], joints)


# Finding sections


def test_sections_and_iterate(tmp_path):
    for number in (10, 9, 1):
        write_section(tmp_path, count=2, section=number, seed=number)
    (tmp_path / "easy-pose" / "train" / "notes").mkdir()
    assert [path.name for path in sections(tmp_path, "easy-pose", "train")] == ["1", "9", "10"]
    assert [len(list(iterate(tmp_path, "easy-pose", "train", limit))) for limit in (None, 3, 2, 0)] == [6, 3, 2, 0]


def test_sections_say_what_is_missing(tmp_path):
    with pytest.raises(InputError, match=r"nowhere not found: expected ROOT/<subset>"):
        sections(tmp_path / "nowhere", "easy-pose", "train")
    (tmp_path / "hard-pose" / "train").mkdir(parents=True)
    with pytest.raises(InputError, match=r"easy-pose not found.*holds hard-pose"):
        sections(tmp_path, "easy-pose", "train")
    with pytest.raises(InputError, match=r"valid not found.*holds train"):
        sections(tmp_path, "hard-pose", "valid")
    with pytest.raises(InputError, match="no numbered sections"):
        sections(tmp_path, "hard-pose", "train")
