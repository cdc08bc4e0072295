"""A network written as ONNX, its weights in half precision, gives what the network gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")

import onnxruntime  # noqa: E402

from depthmocap.classify.export import export_onnx  # noqa: E402
from depthmocap.classify.networks import CLASSES, AccurateNet, FastNet  # noqa: E402
from depthmocap.classify.preprocess import WINDOW  # noqa: E402


def seasoned_network(kind: type[FastNet]) -> FastNet:
    """A random network whose batch norms do something, as after training."""
    torch.manual_seed(1)
    network = kind()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.weight, 0.7, 1.5)
            torch.nn.init.normal_(module.bias, 0, 0.2)
    with torch.no_grad():
        network.train()
        for _ in range(2):
            network(torch.randn(2, 3, 96, 96))
    return network


@pytest.fixture(scope="module", params=[FastNet, AccurateNet])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[FastNet, Path]:
    network = seasoned_network(request.param)
    path = tmp_path_factory.mktemp("export") / "classifier.onnx"
    assert export_onnx(network, path, {"network": "fast", "images": "0"}) == path
    return network, path


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
    actual, joints = session(path).run(["probabilities", "joints"], {"windows": windows.numpy()})
    np.testing.assert_allclose(joints, places, atol=2e-2)
    assert actual.dtype == np.float32
    assert actual.shape == expected.shape == (len(expected), 4, CLASSES)
    assert 0.4 < len(expected) / (count * height * width / 4) < 0.6
    assert np.linalg.norm(actual - expected) < 2e-2 * np.linalg.norm(expected)
    assert (actual.argmax(-1) == expected.argmax(-1)).mean() > 0.99


def test_nobody(exported: tuple[FastNet, Path]) -> None:
    probabilities, joints = session(exported[1]).run(None, {"windows": np.zeros((2, 3, WINDOW, WINDOW), np.float32)})
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
