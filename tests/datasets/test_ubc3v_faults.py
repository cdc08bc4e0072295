"""UBC3V: every way a section can be broken."""

import struct

import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat
from ubc3v_files import write_section

from depthmocap.datasets.ubc3v import (
    MAYA_JOINTS,
    Section,
    image_paths,
    iterate,
)
from depthmocap.errors import InputError

pytest.importorskip("isal")


def assert_left_out(path, file, message):
    section = Section(path)
    views = section[0].views
    assert "Cam1" not in [view.camera.name for view in views]
    (problem,) = section.problems
    assert str(file) in problem
    assert message in problem


def test_broken_images(tmp_path):
    path, _ = write_section(tmp_path, count=1)
    depth, labels = image_paths(path, "Cam1", 0)
    whole = depth.read_bytes()
    bomb = whole[:16] + struct.pack(">II", 30_000, 30_000) + whole[24:]
    cut = whole[:33] + whole[37:]  # within a chunk's length
    for damage, message in [
        (whole[: len(whole) // 2], "not a complete PNG"), (b"", "not a readable picture"),
        (b"not a PNG", "not a readable picture"), (bomb, "at most 64 million"), (cut, "not a complete PNG"),
    ]:  # fmt: skip
        depth.write_bytes(damage)
        assert_left_out(path, depth, message)
    Image.new("RGBA", (64, 64)).save(depth)
    assert_left_out(path, depth, "got RGBA 64×64")
    Image.new("RGB", (512, 424)).save(depth)
    assert_left_out(path, depth, "got RGB 512×424")
    depth.write_bytes(whole)
    labels.write_bytes(labels.read_bytes()[:300])
    assert_left_out(path, labels, "not a complete PNG")


def test_a_damaged_image_costs_its_own_view_alone(tmp_path, caplog):
    for number in (1, 2):
        path, _ = write_section(tmp_path, section=number)
    depth, _ = image_paths(path, "Cam1", 1)
    depth.write_bytes(depth.read_bytes()[:200])
    problems: list[str] = []
    frames = list(iterate(tmp_path, "easy-pose", "train", problems=problems))
    assert len(frames) == 6
    seen = [len(frame.views) for frame in frames]
    assert seen == [seen[0]] * 4 + [seen[0] - 1, seen[0]]
    assert len(problems) == 1
    assert str(depth) in problems[0]
    assert str(depth) in caplog.text


def test_broken_groundtruth(tmp_path):
    path, _ = write_section(tmp_path, count=2)
    truth = path / "groundtruth.mat"
    whole = truth.read_bytes()
    truth.unlink()
    with pytest.raises(InputError, match="not found"):
        Section(path)
    for damage in (whole[: len(whole) // 2], b"", b"text " * 100):
        truth.write_bytes(damage)
        with pytest.raises(InputError, match=r"groundtruth\.mat"):
            Section(path)

    pose = {"translate": np.zeros(3), "rotate": np.zeros(3)}
    joint = {maya: np.eye(4).ravel() for maya in MAYA_JOINTS.values()}
    camera = {"frames": cells(pose)}
    for document, message in [
        ({"joints": cells(joint)}, "no variable cameras"),
        ({"cameras": {"Cam1": camera}}, "no variable joints"),
        ({"cameras": {"Cam1": camera}, "joints": cells({"HeadPGX": np.zeros(16)})}, "has no field Neck1PGX"),
        ({"cameras": {"Cam1": camera}, "joints": cells(joint | {"HeadPGX": np.zeros(3)})}, "must hold 16 numbers"),
        ({"cameras": {"Cam1": camera}, "joints": cells(joint | {"HeadPGX": "text"})}, "not numeric"),
        ({"cameras": {"Cam1": camera}, "joints": cells(joint, joint)}, "2 joints but 1 frames"),
        ({"cameras": {"Cam1": {"other": 1}}, "joints": cells(joint)}, "no field frames"),
        ({"cameras": {"Cam1": {"frames": cells({"rotate": 1})}}, "joints": cells(joint)}, "no field translate"),
        ({"cameras": {"Cam9": camera}, "joints": cells(joint)}, "has no camera Cam1.*it has Cam9"),
        ({"cameras": 3, "joints": cells(joint)}, "it has none"),
    ]:
        savemat(truth, document)
        with pytest.raises(InputError, match=message) as caught:
            Section(path)
        assert str(truth) in str(caught.value)


def cells(*items):
    array = np.empty((1, len(items)), dtype=object)
    array[0] = items
    return array


def test_no_images(tmp_path):
    path, _ = write_section(tmp_path, count=1)
    (path / "images" / "depthRender").rename(path / "images" / "elsewhere")
    with pytest.raises(InputError, match="unpack the depth images"):
        Section(path)


def test_matrices_and_integers_as_matlab_may_store_them(tmp_path):
    """A 4×4 joint matrix with the position in its last column, and a whole-numbered pose kept as integers."""
    path, _ = write_section(tmp_path, count=1)
    matrix = np.eye(4)
    matrix[:3, 3] = 100, 200, 300
    pose = {"translate": np.array([100, 200, 300], np.int16), "rotate": np.zeros(3, np.uint8)}
    document = {
        "cameras": {"Cam1": {"frames": cells(pose)}},
        "joints": cells(dict.fromkeys(MAYA_JOINTS.values(), matrix)),
    }
    savemat(path / "groundtruth.mat", document)
    (frame,) = Section(path)
    assert frame.true_joints is not None
    np.testing.assert_allclose(frame.true_joints, np.tile([1.0, -3.0, 2.0], (18, 1)))
    np.testing.assert_allclose(frame.views[0].camera.world_from_camera[:3, 3], [1.0, -3.0, 2.0])
