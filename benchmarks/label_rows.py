"""Rows of the classifier, against the paper's network."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

import numpy as np
from timing import Bench, Reference

from depthmocap.classify.preprocess import WINDOW
from depthmocap.classify.runtime import Classifier
from depthmocap.synth.sample import Recipe, Sampler

GOAL_MS = 20.0


def load_classifier(bench: Bench) -> Classifier:
    """The packaged classifier, or one with random weights, which takes as long."""
    packaged = Path(str(importlib.resources.files("depthmocap.classify") / "weights" / "fast.onnx"))
    if packaged.is_file():
        return Classifier(threads=bench.threads)
    import torch

    from depthmocap.classify.export import export_onnx
    from depthmocap.classify.networks import FastNet

    path = bench.folder / "random.onnx"
    if not path.exists():
        torch.manual_seed(0)
        bench.notes.append("no packaged classifier: a network with random weights stands in for it")
        export_onnx(FastNet(), path, {})
    return Classifier(path, bench.threads)


def labelling(bench: Bench) -> None:
    """Views in, labels out, against a mere forward pass of the paper's network."""
    import onnxruntime
    import torch
    from paper_network import SIDE, PaperNetwork, export_paper_network, gflop, parameter_count

    from depthmocap.classify.networks import FastNet

    classifier = load_classifier(bench)
    sample = Sampler(Recipe("open", views=4, sensors=("kinect2",), noise="sensor"), seed=3)(0)
    views = list(sample.views)
    masks = [view.mask for view in views if view.mask is not None]

    torch.manual_seed(0)
    torch.set_num_threads(bench.threads)
    network = PaperNetwork().eval()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = bench.threads
    options.log_severity_level = 3
    path = export_paper_network(network, bench.folder / "paper.onnx")
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    inputs = np.random.default_rng(4).standard_normal((len(views), 1, SIDE, SIDE), dtype=np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(inputs)).numpy()
    error = float(np.abs(np.asarray(session.run(None, {"depth": inputs})[0]) - expected).max())
    if expected.shape != (4, 44, SIDE, SIDE) or error > 1e-3 * np.abs(expected).max():
        bench.notes.append(f"the paper's network in ONNX Runtime differs from PyTorch by {error:.2g}: do not trust it")
    bench.notes.append(
        f"the paper's network: {parameter_count(network) / 1e6:.3f} M parameters, "
        f"{gflop(network, torch.zeros(1, 1, SIDE, SIDE)):.2f} GFLOP a view; ours: "
        f"{parameter_count(FastNet()) / 1e6:.3f} M, {gflop(FastNet(), torch.zeros(1, 3, WINDOW, WINDOW)):.2f} GFLOP"
    )
    channels_last = network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    tensor = torch.from_numpy(inputs).to(memory_format=torch.channels_last)

    def in_torch(count: int) -> object:
        with torch.inference_mode():
            return channels_last(tensor[:count])

    for count in (1, len(views)):
        calls = f"{count} view{'s' * (count > 1)} a call"
        for reference in (
            Reference("paper's network, ONNX Runtime", lambda n=count: session.run(None, {"depth": inputs[:n]}), count),
            Reference("paper's network, PyTorch", lambda n=count: in_torch(n), count),
        ):
            bench.measure(
                f"Label a view, {calls}", lambda n=count: classifier.label_views(views[:n], masks[:n]), reference,
                items=count, goal_ms=GOAL_MS,
                note=f"{bench.threads} threads each; ours with, theirs without pre- and postprocessing",
            )  # fmt: skip
