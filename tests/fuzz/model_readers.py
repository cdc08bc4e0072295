"""Networks, regressors, and what training leaves to go on from."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from reader import PERIOD, START, Reader


def _ridge(folder: Path) -> None:
    import importlib.resources

    packaged = importlib.resources.files("depthmocap.pose") / "weights" / "ridge_true.npz"
    (folder / "ridge.npz").write_bytes(packaged.read_bytes())


def _read_ridge(folder: Path) -> None:
    from depthmocap.pose.estimators import load_estimator

    load_estimator(folder / "ridge.npz")


def _tracks(folder: Path) -> None:
    from depthmocap.evaluate.estimated_sequences import EstimateStore, SequenceEstimates

    stamps = START + PERIOD * np.arange(3)
    track = SequenceEstimates("a", stamps, np.zeros((3, 18, 3)), np.zeros((2, 3, 18, 3)), np.ones((2, 3, 18)))
    EstimateStore(folder, {"seed": 1}).save(0, track)


def _read_tracks(folder: Path) -> None:
    from depthmocap.evaluate.estimated_sequences import EstimateStore

    track = EstimateStore(folder, {"seed": 1}).load(0)
    assert track is None or len(track.poses(2)) == len(track.timestamps_ns)


def _pose_samples(folder: Path) -> None:
    from depthmocap.pose.labelled_view import LABELS

    arrays: dict[str, np.ndarray] = {"joints": np.zeros((4, 18, 3)), "groups": np.arange(4)}
    for labels in LABELS:
        arrays[f"parts {labels}"] = np.zeros((4, 2, 61, 16), np.float32)
        for kind, shape in (("features", (4, 1032)), ("targets", (4, 18, 3)), ("members", (4,))):
            arrays[f"{kind} {labels} 1"] = np.zeros(shape, np.float32 if kind != "members" else np.int64)
    for first in ("000000", "000100"):
        np.savez(folder / f"{first}.npz", **arrays)  # pyright: ignore[reportArgumentType] - none is called allow_pickle


def _read_pose_samples(folder: Path) -> None:
    from depthmocap.train.pose_samples import PoseSampleSettings, read_samples

    read_samples(folder, PoseSampleSettings(views=(1,)))


def _network(end: str, shape: tuple[int, ...], results: tuple[str, ...]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        import onnx
        from onnx import TensorProto, helper

        given, *told = (helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in (end, *results))
        graph = helper.make_graph([helper.make_node("Relu", [end], [name]) for name in results], "x", [given], told)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        model.metadata_props.add(key="network", value="fast")
        onnx.save(model, folder / "network.onnx")

    return make


def _read_classifier(folder: Path) -> None:
    from depthmocap.classify.classifier import Classifier

    Classifier(folder / "network.onnx", threads=1)


def _read_votes(folder: Path) -> None:
    from depthmocap.pose.estimators import load_estimator

    load_estimator(folder / "network.onnx")


def _weights(folder: Path) -> None:
    import torch
    from safetensors.torch import save_file

    save_file(torch.nn.Linear(3, 2).state_dict(), folder / "weights.safetensors")


def _read_weights(folder: Path) -> None:
    import torch

    from depthmocap.train.checkpoints import load_weights

    load_weights(torch.nn.Linear(3, 2), folder / "weights.safetensors")


def _checkpoint(folder: Path) -> None:
    import torch

    layer = torch.nn.Linear(3, 2)
    state = {"network": layer.state_dict(), "done": 16, "spent": 1.5, "history": json.dumps([{"step": 16}])}
    torch.save(state, folder / "checkpoint.pt")


def _read_run(folder: Path) -> None:
    from depthmocap.train.checkpoints import read_checkpoint

    read_checkpoint(folder / "checkpoint.pt", "cpu")


_SQUARE, _PARTS = (1, 2, 8, 8), (1, 1, 61, 16)
MODELS: dict[str, Reader] = {
    "ridge": Reader(_ridge, _read_ridge),
    "tracks": Reader(_tracks, _read_tracks),
    "pose samples": Reader(_pose_samples, _read_pose_samples),
    "classifier": Reader(_network("windows", _SQUARE, ("probabilities", "joints")), _read_classifier, needs=("onnx",)),
    "votes": Reader(_network("parts", _PARTS, ("joints", "sure")), _read_votes, needs=("onnx",)),
    "weights": Reader(_weights, _read_weights, needs=("torch", "safetensors")),
    "checkpoint": Reader(_checkpoint, _read_run, needs=("torch",)),
}
