"""A network written as ONNX, its weights in half precision or in 8 bits, gives what the network gives."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")

import onnxruntime  # noqa: E402

from depthmocap.classify.classifier import Classifier  # noqa: E402
from depthmocap.classify.window import WINDOW  # noqa: E402
from depthmocap.synth.body.mesh import BodyModel  # noqa: E402
from depthmocap.synth.motion.postures import posture_source  # noqa: E402
from depthmocap.train.checkpoints import load_weights  # noqa: E402
from depthmocap.train.networks import CLASSES, FastNet  # noqa: E402
from depthmocap.train.onnx_export import export_onnx  # noqa: E402
from depthmocap.train.quantise import quantise  # noqa: E402
from depthmocap.train.windows import training_window  # noqa: E402

#: Each export is 20 s of one core.
pytestmark = pytest.mark.slow

WEIGHTS = Path(__file__).parents[2] / "weights" / "fast.safetensors"


def packaged_network() -> FastNet:
    network = FastNet()
    load_weights(network, WEIGHTS)
    return network


def seasoned_network() -> FastNet:
    """A random network whose batch norms do something, as after training."""
    torch.manual_seed(1)
    network = FastNet()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.weight, 0.7, 1.5)
            torch.nn.init.normal_(module.bias, 0, 0.2)
    with torch.no_grad():
        network.train()
        for _ in range(2):
            network(torch.randn(2, 3, 96, 96))
    return network


def export(network: FastNet, folder: Path) -> tuple[FastNet, Path]:
    path = folder / "classifier.onnx"
    assert export_onnx(network, path, {"network": "fast", "images": "0"}) == path
    return network, path


@pytest.fixture(scope="module")
def packaged(tmp_path_factory: pytest.TempPathFactory) -> tuple[FastNet, Path]:
    return export(packaged_network(), tmp_path_factory.mktemp("packaged"))


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> tuple[FastNet, Path]:
    return export(seasoned_network(), tmp_path_factory.mktemp("untrained"))


@pytest.fixture(params=["packaged", "untrained"])
def exported(request: pytest.FixtureRequest) -> tuple[FastNet, Path]:
    return request.getfixturevalue(request.param)


def run(path: Path, windows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities and joints."""
    probabilities, joints = session(path).run(["probabilities", "joints"], {"windows": windows})
    assert isinstance(probabilities, np.ndarray) and isinstance(joints, np.ndarray)
    return probabilities, joints


def session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


@pytest.mark.parametrize(("count", "height", "width"), [(1, WINDOW, WINDOW), (3, WINDOW, 64), (2, 96, 160)])
def test_same_probabilities_labels_and_joints(
    exported: tuple[FastNet, Path], count: int, height: int, width: int
) -> None:
    network, path = exported
    windows = torch.randn(count, 3, height, width, generator=torch.Generator().manual_seed(count))
    windows[:, 1] = (windows[:, 1] > 1).float()
    with torch.no_grad():
        expected, places = (each.numpy() for each in network.eval()(windows))
    actual, joints = run(path, windows.numpy())
    np.testing.assert_allclose(joints, places, atol=2e-2)
    assert actual.dtype == np.float32
    assert actual.shape == expected.shape == (len(expected), 4, CLASSES)
    assert 0.4 < len(expected) / (count * height * width / 4) < 0.6
    assert np.linalg.norm(actual - expected) < 2e-2 * np.linalg.norm(expected)
    assert (actual.argmax(-1) == expected.argmax(-1)).mean() > 0.99


def test_nobody(exported: tuple[FastNet, Path]) -> None:
    probabilities, joints = run(exported[1], np.zeros((2, 3, WINDOW, WINDOW), np.float32))
    assert probabilities.shape == (0, 4, CLASSES)
    assert np.isfinite(joints).all()


def test_file(exported: tuple[FastNet, Path]) -> None:
    network, path = exported
    parameters = sum(parameter.numel() for parameter in network.parameters())
    assert 2 * parameters < path.stat().st_size < 2.3 * parameters
    assert session(path).get_modelmeta().custom_metadata_map == {"network": "fast", "images": "0"}
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    operations = {node.op_type for node in onnx.load(path).graph.node}
    assert "BatchNormalization" not in operations


def test_the_network_is_left_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    network = FastNet((8, 8, 8, 8, 8), (0, 0, 0, 0, 0)).train()
    before = {name: value.clone() for name, value in network.state_dict().items()}

    def fails(written: FastNet, *arguments: object, **options: object) -> None:
        assert not written.training
        torch.nn.init.zeros_(next(written.parameters()))
        raise OSError

    monkeypatch.setattr(torch.onnx, "export", fails)
    with pytest.raises(OSError):
        export_onnx(network, Path("classifier.onnx"), {})
    assert network.training
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())


def test_same_labels_in_8_bits_in_half_the_space(
    packaged: tuple[FastNet, Path], body_model: BodyModel, tmp_path: Path
) -> None:
    source, about = packaged[1], {"network": "fast", "images": "0"}
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


def found(path: Path, windows: list[np.ndarray]) -> list[np.ndarray]:
    """Probabilities (m, 4, 44) and joints (n, 18, 4) of n windows of any sizes."""
    opened = session(path)
    return [
        np.concatenate(each) for each in zip(*(opened.run(None, {"windows": w[None]}) for w in windows), strict=True)
    ]
