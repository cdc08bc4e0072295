"""Labels through an ONNX file, whose metadata tell how its windows are made."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.classify.classifier import Classifier, packaged_leaning, packaged_weights
from depthmocap.classify.label_network import WindowPrediction
from depthmocap.classify.window import Window, make_paper_window
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.kernels.dense_head import label_dense_pixels
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import render_body

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")

from depthmocap.train.onnx_export import export_onnx  # noqa: E402
from depthmocap.train.paper_network import PaperNet  # noqa: E402

POSE = look_at(np.array([0.5, -1.0, 0.2]) * 2.5, np.zeros(3))
CAMERA = DepthCamera("camera", 512, 424, 368.0, 368.0, 255.5, 211.5, POSE)


def seasoned_network() -> PaperNet:
    """A random network whose labels vary, as after training."""
    torch.manual_seed(3)
    network = PaperNet().eval()
    for parameter in network.parameters():
        if parameter.ndim > 1:
            torch.nn.init.normal_(parameter, std=1.5 / np.sqrt(parameter[0].numel()))
    return network


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[PaperNet, Path]:
    network = seasoned_network()
    path = tmp_path_factory.mktemp("paper") / "classifier.onnx"
    return network, export_onnx(network, path, {"network": "paper", "images": "0"})


def test_dense_labels() -> None:
    rng = np.random.default_rng(0)
    scores = rng.normal(0, 3, (44, 20, 30)).astype(np.float32)
    mask = rng.random((20, 30)) < 0.3
    mask[5] = False
    labels, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
    label_dense_pixels(scores, mask, labels, confidence)
    shares = np.exp(scores) / np.exp(scores).sum(0)
    np.testing.assert_array_equal(labels, np.where(mask, scores.argmax(0), 0))
    np.testing.assert_allclose(confidence, np.where(mask, shares.max(0), 0), rtol=1e-4)


def test_the_papers_network_runs_by_its_file_alone(exported: tuple[PaperNet, Path], default_body: Body) -> None:
    network, path = exported
    classifier = Classifier(path, threads=1)
    assert classifier.network == "paper"
    assert path.stat().st_size < 8e6
    postures = PosturePrior.load()
    pictures = [
        render_body(default_body.pose(postures.sample(np.random.default_rng(seed))[0]), CAMERA) for seed in range(2)
    ]
    views = [View(CAMERA, depth) for depth, _ in pictures]
    masks = [labels > 0 for _, labels in pictures]
    for view, mask, labelled in zip(views, masks, classifier.label_masks(views, masks), strict=True):
        window = make_paper_window(view.depth_m, mask, CAMERA)
        assert window is not None
        person = window.inputs[1] > 0
        with torch.no_grad():
            shares = network(torch.from_numpy(window.inputs[None])).softmax(1)[0].numpy()
        assert len(np.unique(shares.argmax(0)[person])) > 5
        inside = labelled.window_prediction
        assert inside is not None
        assert (inside.labels == shares.argmax(0))[person].mean() > 0.99
        assert np.median(np.abs(inside.confidence - shares.max(0))[person]) < 0.01
        assert not inside.labels[~person].any()
        # Back in the picture every pixel of the person has the label of its place in the window.
        labels, confidence = window.labels_to_image(inside.labels, inside.confidence, mask)
        np.testing.assert_array_equal(labelled.prediction.labels, labels)
        np.testing.assert_array_equal(labelled.prediction.confidence, confidence)
        assert not labelled.prediction.labels[~mask].any()
        assert (labelled.prediction.confidence[mask] > 0).mean() > 0.95
        assert np.isnan(labelled.prediction.joints).all()  # which the paper's network does not tell


def test_nobody(exported: tuple[PaperNet, Path]) -> None:
    view = View(CAMERA, np.full((424, 512), 2.0, np.float32))
    ((labels, confidence, *_),) = Classifier(exported[1], threads=1).label_views([view], [np.zeros((424, 512), bool)])
    assert labels.shape == confidence.shape == (424, 512)
    assert not labels.any() and not confidence.any()


def test_a_camera_on_its_side_costs_nothing(default_body: Body) -> None:
    """A rig that knows what is up turns the picture; the labels and joints are those of the upright camera."""
    posture = PosturePrior.load().sample(np.random.default_rng(0))[0]
    depth, labels = render_body(default_body.pose(posture), CAMERA)
    classifier = Classifier(threads=1)
    upright = View(CAMERA, depth, labels > 0)
    for quarters in (1, 2, 3):
        hung = upright.turned(quarters)
        assert hung.mask is not None and upright.mask is not None
        (expected,) = classifier.label_views([upright], [upright.mask], "z")
        (prediction,) = classifier.label_views([hung], [hung.mask], "z")
        assert prediction.labels.shape == hung.depth_m.shape
        assert (np.rot90(prediction.labels, -quarters) == expected.labels)[upright.mask].mean() > 0.99
        np.testing.assert_allclose(prediction.joints, expected.joints, atol=0.01)


@pytest.mark.parametrize("roll_deg", [70, -120, 180])
def test_who_lies_or_is_upside_down_is_seen_upright(
    default_body: Body, roll_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without any word of what is up, and by any angle: as well as by an upright camera, which one look does not do."""
    posture = PosturePrior.load().sample(np.random.default_rng(0))[0]

    def share_right(camera: DepthCamera) -> float:
        depth, labels = render_body(default_body.pose(posture), camera)
        mask = labels > 0
        (prediction,) = Classifier(threads=1).label_views([View(camera, depth)], [mask])
        return float((prediction.labels == labels)[mask].mean())

    pose = POSE.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0, 0, np.radians(roll_deg)]).as_matrix()
    askew = dataclasses.replace(CAMERA, world_from_camera=pose)
    upright, seen = share_right(CAMERA), share_right(askew)
    assert seen > upright - 0.02
    monkeypatch.setattr("depthmocap.classify.classifier.trunk_lean", lambda joints: 0.0)
    assert share_right(askew) < seen - 0.02
    assert share_right(CAMERA) == upright


def test_only_leaning_people_are_seen_again_by_the_network_for_them(
    default_body: Body, monkeypatch: pytest.MonkeyPatch
) -> None:
    classifier = Classifier(threads=1)
    of_leaning, asked = classifier._of_leaning, []

    def ask(windows: list[Window]) -> list[WindowPrediction]:
        asked.append(windows[0])
        return of_leaning(windows)

    monkeypatch.setattr(classifier, "_of_leaning", ask)
    depth, labels = render_body(default_body.pose(PosturePrior.load().sample(np.random.default_rng(0))[0]), CAMERA)
    upright = View(CAMERA, depth, labels > 0)
    hung = upright.turned(1)
    assert upright.mask is not None and hung.mask is not None
    classifier.label_views([upright], [upright.mask])
    assert not asked
    classifier.label_views([hung], [hung.mask])
    assert len(asked) == 1 and abs(asked[0].turn_rad) == pytest.approx(np.pi / 2, abs=0.2)
    assert of_leaning.path == packaged_leaning()
    assert Classifier(packaged_weights(), threads=1)._of_leaning.path == packaged_weights()  # by itself


@pytest.mark.parametrize(("share", "taken"), [(0.95, True), (0.7, False)])
def test_a_second_look_counts_unless_it_is_much_less_sure(
    default_body: Body, monkeypatch: pytest.MonkeyPatch, share: float, taken: bool
) -> None:
    """A little less sure is what a network is that learnt from harder pictures, where it is as good."""
    classifier = Classifier(threads=1)
    depth, labels = render_body(default_body.pose(PosturePrior.load().sample(np.random.default_rng(0))[0]), CAMERA)
    hung = View(CAMERA, depth, labels > 0).turned(1)
    assert hung.mask is not None
    window = classifier.make_window(hung.depth_m, hung.mask, hung.camera)
    assert window is not None
    (found,) = classifier._network([window])

    def ask(windows: list[Window]) -> list[WindowPrediction]:
        shape = windows[0].inputs.shape[1:]
        sure = np.full(shape, share * found.mean_probability, np.float32)
        return [WindowPrediction(np.ones(shape, np.uint8), sure, found.joints)]

    monkeypatch.setattr(classifier, "_of_leaning", ask)
    result = classifier.label_mask(hung, hung.mask)
    assert result.window is not None and (result.window.turn_rad != 0) == taken


def test_the_packaged_network_is_ours() -> None:
    classifier = Classifier(threads=1)
    assert classifier.network == "fast" and classifier.path == packaged_weights()
    assert classifier.path.stat().st_size < 8e6


@pytest.mark.parametrize("name", ["huge", "fast"])  # ours had logits in its first versions
def test_a_network_of_another_version_is_refused(exported: tuple[PaperNet, Path], tmp_path: Path, name: str) -> None:
    model = onnx.load(exported[1])
    onnx.helper.set_model_props(model, {"network": name})
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(InputError, match=rf"other\.onnx holds a network .{name}. with logits, .* knows .fast. with"):
        Classifier(tmp_path / "other.onnx")


def test_two_views_at_once_give_what_each_gives_alone() -> None:
    """More views than threads: some of one size are seen together."""
    rng, views, masks = np.random.default_rng(2), [], []
    camera = DepthCamera("front", 160, 240, 180.0, 180.0, 80.0, 120.0)
    for width in (40, 90, 42, 0, 41):
        mask = np.zeros((240, 160), bool)
        mask[20:220, 80 - width // 2 : 80 + width // 2] = True
        depth_m = np.where(mask, 2 + rng.normal(0, 0.01, mask.shape), 0).astype(np.float32)
        views.append(View(camera, depth_m))
        masks.append(mask)
    few, many = Classifier(threads=1), Classifier(threads=8)
    together, alone = few.label_views(views, masks, "z"), many.label_views(views, masks, "z")
    assert sum(prediction.confidence.any() for prediction in alone) == 4
    for one, other in zip(together, alone, strict=True):
        for here, there in zip(one, other, strict=True):
            np.testing.assert_array_equal(here, there)
