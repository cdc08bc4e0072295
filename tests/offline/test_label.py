"""Labelling single depth images."""

import cv2
import numpy as np
import pytest

from depthmocap import InputError
from depthmocap.body.regions import REGION
from depthmocap.cli import main
from depthmocap.datasets.ubc3v import KINECT2, encode_depth
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.offline.label import LabelSettings, label_image
from depthmocap.synth.body.mesh import REST_POSTURE
from depthmocap.synth.render import render_body


@pytest.fixture(scope="module")
def picture(default_body):
    posed = default_body.pose(REST_POSTURE)
    pose = look_at(np.array([0.0, -2.5, 0.2]), np.array([0.0, 0.0, 0.0]))
    camera = DepthCamera("c", KINECT2.width, KINECT2.height, KINECT2.fx, KINECT2.fy, KINECT2.cx, KINECT2.cy, pose)
    return render_body(posed, camera)


def settings(tmp_path, depth, **options):
    path = tmp_path / "depth.png"
    cv2.imwrite(str(path), np.round(depth * 1000).astype(np.uint16))
    return LabelSettings(path, tmp_path / "labels.png", **options)


def test_labels_have_the_inputs_size_and_mostly_the_truth(picture, tmp_path):
    depth, truth = picture
    chosen = settings(tmp_path, depth, fx=KINECT2.fx, preview=(tmp_path / "preview.png",))
    labels = label_image(chosen)
    written = cv2.imread(str(chosen.out), cv2.IMREAD_UNCHANGED)
    assert written is not None and written.dtype == np.uint8
    assert written.shape == depth.shape
    assert (written == labels).all()
    assert (labels[truth == 0] == 0).all()
    assert (labels == truth)[truth > 0].mean() > 0.6
    preview = cv2.imread(str(tmp_path / "preview.png"))
    assert preview is not None and preview.shape == (*depth.shape, 3)
    # Left and right are the subject's own: it faces the camera, so its right is on the picture's left.
    right = np.nonzero(labels == REGION["chest R"])[1].mean()
    assert right < np.nonzero(labels == REGION["chest L"])[1].mean()


def test_scale_of_depth_is_told_by_its_unit(picture, tmp_path):
    depth, _ = picture
    first = label_image(settings(tmp_path, depth))
    again = label_image(settings(tmp_path, depth / 4, depth_unit=0.004))
    assert (first == again).mean() > 0.99


def test_mask_limits_the_person(picture, tmp_path):
    depth, truth = picture
    room = np.where(depth > 0, depth, 4.0)
    cv2.imwrite(str(tmp_path / "mask.png"), (truth > 0).astype(np.uint8) * 255)
    labels = label_image(settings(tmp_path, room, mask=tmp_path / "mask.png"))
    assert (labels[truth == 0] == 0).all()
    assert (labels[truth > 0] > 0).mean() > 0.9


def test_ubc3v_pictures(picture, tmp_path):
    depth, truth = picture
    path = tmp_path / "ubc3v.png"
    cv2.imwrite(str(path), cv2.cvtColor(encode_depth(depth, truth > 0), cv2.COLOR_RGBA2BGRA))
    labels = label_image(LabelSettings(path, tmp_path / "labels.png", ubc3v=True))
    assert (labels == truth)[truth > 0].mean() > 0.6


@pytest.mark.parametrize(("given", "name"), [([], "labels_preview.png"), (["seen.png"], "seen.png")])
def test_preview_with_and_without_a_name(picture, tmp_path, given, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chosen = settings(tmp_path, picture[0])
    assert main(["label", str(chosen.depth), "--out", "labels.png", "--preview", *given]) == 0
    assert (tmp_path / name).is_file()


@pytest.mark.parametrize(
    ("out", "preview", "message"),
    [
        ("depth.png", None, "--out must not be the depth image"),
        ("./sub/../depth.png", None, "--out must not be the depth image"),
        ("mask.png", None, "--out must not be the mask"),
        ("link.png", None, "--out must not be the mask"),
        ("labels.png", ("depth.png",), "--preview must not be the depth image"),
        ("labels.png", ("mask.png",), "--preview must not be the mask"),
        ("labels.png", ("labels.png",), "--preview must not be the file of --out"),
        ("depth.jpg", None, r"--out must end in \.png, got"),
        ("labels", (), r"--out must end in \.png, got"),
    ],
)
def test_results_never_take_the_place_of_inputs_or_of_each_other(tmp_path, out, preview, message):
    depth, mask = tmp_path / "depth.png", tmp_path / "mask.png"
    cv2.imwrite(str(depth), np.full((40, 50), 2000, np.uint16))
    cv2.imwrite(str(mask), np.full((40, 50), 255, np.uint8))
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.png").symlink_to(mask)
    before = {path: path.read_bytes() for path in (depth, mask)}
    names = preview if preview is None else tuple(tmp_path / name for name in preview)
    with pytest.raises(InputError, match=message):
        label_image(LabelSettings(depth, tmp_path / out, mask=mask, preview=names))
    assert {path: path.read_bytes() for path in before} == before
    assert {path.name for path in tmp_path.iterdir()} == {"depth.png", "mask.png", "link.png", "sub"}


def test_the_preview_beside_the_labels_is_not_the_input(tmp_path):
    path = tmp_path / "labels_preview.png"
    cv2.imwrite(str(path), np.full((40, 50), 2000, np.uint16))
    with pytest.raises(InputError, match="--preview must not be the depth image"):
        label_image(LabelSettings(path, tmp_path / "labels.png", preview=()))


def test_the_preview_may_be_any_picture(picture, tmp_path):
    label_image(settings(tmp_path, picture[0], preview=(tmp_path / "preview.jpg",)))
    preview = cv2.imread(str(tmp_path / "preview.jpg"))
    assert preview is not None and preview.shape == (*picture[0].shape, 3)


@pytest.mark.parametrize("value", [-3.0, 0.0, np.nan, np.inf])
@pytest.mark.parametrize("name", ["fx", "fy", "depth_unit"])
def test_lengths_are_finite_and_above_0(picture, tmp_path, name, value):
    option = "--" + name.replace("_", "-")
    with pytest.raises(InputError, match=f"{option} must be finite and above 0, got {value}"):
        label_image(settings(tmp_path, picture[0], **{name: value}))


@pytest.mark.parametrize("name", ["cx", "cy"])
def test_a_principal_point_is_finite(picture, tmp_path, name):
    with pytest.raises(InputError, match=f"--{name} must be finite, got nan"):
        label_image(settings(tmp_path, picture[0], **{name: np.nan}))


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((40, 50), np.uint8), "16-bit"),
        (np.zeros((40, 50, 3), np.uint8), "16-bit"),
        (np.zeros((40, 50), np.uint16), "no person"),
        (np.full((40, 50), 65535, np.uint16), "no person"),
    ],
)
def test_unsuitable_images(image, message, tmp_path):
    path = tmp_path / "depth.png"
    cv2.imwrite(str(path), image)
    with pytest.raises(InputError, match=message):
        label_image(LabelSettings(path, tmp_path / "labels.png"))


def test_missing_and_broken_files(picture, tmp_path):
    with pytest.raises(InputError, match="not found"):
        label_image(LabelSettings(tmp_path / "none.png", tmp_path / "labels.png"))
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"\x89PNG\r\n\x1a\nrest is missing")
    with pytest.raises(InputError, match=r"broken\.png"):
        label_image(LabelSettings(broken, tmp_path / "labels.png"))
    with pytest.raises(InputError, match="weights"):
        label_image(settings(tmp_path, picture[0], weights=tmp_path / "weights.onnx"))
