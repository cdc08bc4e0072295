"""A larger network is grown out of the packaged one, and both label in 8 bits as they do in 32."""

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

import onnxruntime  # noqa: E402

from depthmocap.classify import train  # noqa: E402
from depthmocap.classify.data import training_window  # noqa: E402
from depthmocap.classify.export import export_onnx  # noqa: E402
from depthmocap.classify.networks import AccurateNet, FastNet  # noqa: E402
from depthmocap.classify.quantise import quantise  # noqa: E402
from depthmocap.classify.runtime import Classifier, packaged_weights  # noqa: E402
from depthmocap.classify.train import (  # noqa: E402
    ClassifierTraining,
    evaluate_windows,
    load_weights,
    train_classifier,
)
from depthmocap.errors import InputError  # noqa: E402
from depthmocap.synth.motion.postures import posture_source  # noqa: E402

WEIGHTS = packaged_weights().with_suffix(".safetensors")


@pytest.fixture(scope="module")
def grown(body_model, tmp_path_factory):
    """A run of the accurate network that starts from the packaged fast one and learns next to nothing."""
    settings = ClassifierTraining(
        tmp_path_factory.mktemp("grown") / "run", network="accurate", images=4, batch=4, start=WEIGHTS, valid_images=2,
        workers=0, average=0.0, learning_rate=1e-12,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "_CALIBRATION", 2)
        train_classifier(settings)
    return settings


def test_the_accurate_network_starts_from_the_fast_one(grown):
    fast, accurate = FastNet(), AccurateNet()
    load_weights(fast, WEIGHTS)
    load_weights(accurate, grown.out / "classifier.safetensors")
    windows = grown.source.valid(2)
    (expected, expected_m), (found, found_m) = (evaluate_windows(each, windows) for each in (fast, accurate))
    assert found.pixel_accuracy == pytest.approx(expected.pixel_accuracy, abs=0.03) and expected.pixel_accuracy > 0.6
    assert found_m == pytest.approx(expected_m, abs=0.02)
    assert Classifier(grown.out / "classifier_int8.onnx", threads=1).network == "accurate"
    with pytest.raises(InputError, match="does not hold weights of this network: Error"):
        load_weights(fast, grown.out / "classifier.safetensors")


@pytest.fixture(params=["fast", "accurate"])
def exported(request, tmp_path):
    """The packaged network and the one grown out of it, in 32 bits, and what their files tell."""
    about = {"network": request.param, "images": "4"}
    if request.param == "accurate":
        return request.getfixturevalue("grown").out / "classifier.onnx", about
    network = FastNet()
    load_weights(network, WEIGHTS)
    return export_onnx(network.eval(), tmp_path / "classifier.onnx", about), about


def test_same_labels_in_half_the_space(body_model, exported, tmp_path):
    source, about = exported
    postures = posture_source(None, "train")
    windows = [training_window(3, i, "open", postures, None).inputs for i in range(12)]
    path = quantise(source, windows[:8], tmp_path / "int8.onnx")
    assert path.stat().st_size < 0.6 * source.stat().st_size
    assert {e.key: e.value for e in onnx.load(path).metadata_props} == {**about, "precision": "int8"}
    Classifier(path)  # a classifier like any other

    seen = windows[8:]
    (sure, joints), (sure_8, joints_8) = (found(each, seen) for each in (source, path))
    labels, labels_8 = sure.argmax(-1), sure_8.argmax(-1)
    shown = sum(
        np.count_nonzero(cv2.resize(each[1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)) for each in seen
    )
    assert labels.shape == labels_8.shape == (shown, 4)
    assert (labels == labels_8).mean() > 0.94  # with pixels beside the person, which nothing has learnt
    assert len(np.unique(labels_8)) > 20
    # Places are sums of what is not in 8 bits.
    assert np.median(np.linalg.norm((joints - joints_8)[..., :3], axis=-1)) < 0.01
    # Only convolutions have become smaller.
    kinds = {node.op_type for node in onnx.load(path).graph.node}
    assert {"QuantizeLinear", "Softmax", "ReduceSum"} <= kinds


def found(path: Path, windows):
    """Probabilities (m, 4, 44) and joints (n, 18, 4) of n windows of any sizes."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return [
        np.concatenate(each) for each in zip(*(session.run(None, {"windows": w[None]}) for w in windows), strict=True)
    ]
