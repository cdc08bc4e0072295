"""The packaged network, and a larger one grown out of it, label in 8 bits as they do in 32."""

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

import onnxruntime  # noqa: E402

from depthmocap.classify.data import training_window  # noqa: E402
from depthmocap.classify.export import export_onnx  # noqa: E402
from depthmocap.classify.networks import NETWORKS  # noqa: E402
from depthmocap.classify.quantise import quantise  # noqa: E402
from depthmocap.classify.runtime import Classifier, packaged_weights  # noqa: E402
from depthmocap.classify.train import load_weights  # noqa: E402
from depthmocap.synth.motion.postures import posture_source  # noqa: E402


@pytest.mark.parametrize("name", ["fast", "accurate"])
def test_same_labels_in_half_the_space(body_model, tmp_path, name):
    network = NETWORKS[name]()
    load_weights(network, packaged_weights().with_suffix(".safetensors"), grow=True)
    source = export_onnx(network.eval(), tmp_path / "classifier.onnx", {"network": name})
    postures = posture_source(None, "train")
    windows = [training_window(3, i, "open", postures, None).inputs for i in range(12)]
    path = quantise(source, windows[:8], tmp_path / "int8.onnx")
    assert path.stat().st_size < 0.6 * source.stat().st_size
    assert {e.key: e.value for e in onnx.load(path).metadata_props} == {"network": name, "precision": "int8"}
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
