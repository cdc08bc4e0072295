"""Networks as ONNX files, their weights stored in half precision (extra: train)."""

from __future__ import annotations

import contextlib
import copy
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from depthmocap.core.output import atomic_write
from depthmocap.train.front_network import FrontNet
from depthmocap.train.networks import Network

if TYPE_CHECKING:
    import onnx


def export_onnx(network: Network, path: Path, metadata: dict[str, str]) -> Path:
    """Write ``network`` as ONNX: input ``windows`` (n, *its input_shape*, of ours any multiples of 32 high and wide),
    outputs those of its forward: ``logits`` of the paper's, ``probabilities`` and ``joints`` of ours.

    ``metadata`` must hold the network's name as ``network``, by which
    :class:`~depthmocap.classify.classifier.Classifier` knows how its windows are made.

    Batch norms are folded into the convolutions. Large weights are stored as fp16 behind a cast, which the runtime
    folds away when it loads the file: half the size, fp32 arithmetic.
    """
    outputs = ["probabilities", "joints"] if network.predicts_joints else ["logits"]
    return export_windows_onnx(network, path, outputs, metadata)


def export_windows_onnx(network: Network | FrontNet, path: Path, outputs: list[str], metadata: dict[str, str]) -> Path:
    """Write a network of windows as ONNX, with names of its outputs."""
    network = copy.deepcopy(network).cpu().eval()
    example = torch.zeros(2, *network.input_shape)
    sizes: dict[int, Any] = {0: torch.export.Dim("n", min=1)}
    if network.size_step is not None:
        # As multiples of a number the exporter knows that what was halved and doubled fits again.
        sizes |= {i: network.size_step * torch.export.Dim(f"steps{i}", min=1, max=64) for i in (2, 3)}
    with quiet():
        program = torch.onnx.export(
            network, (example,), input_names=["windows"], output_names=outputs, dynamo=True, verbose=False,
            dynamic_shapes={"x": sizes},
        )  # fmt: skip
    assert program is not None
    return write_program(program, path, metadata)


def write_program(program: torch.onnx.ONNXProgram, path: Path, metadata: dict[str, str]) -> Path:
    """Write an exported network, its large weights in half precision; returns the path."""
    import onnx
    from onnx import helper

    program.optimize()
    model = program.model_proto
    store_half(model)
    helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    with atomic_write(path) as unfinished:
        onnx.save(model, unfinished)
    return path


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without the exporter's warnings about its own futures and about packages that are not needed here."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def store_half(model: onnx.ModelProto) -> None:
    """Store the large weights of an ONNX model as fp16 behind a cast, in place, and drop the exporter's notes on where
    in the source files of this machine each node came from."""
    from onnx import TensorProto, helper, numpy_helper

    graph = model.graph
    casts = []
    for tensor in list(graph.initializer):
        array = numpy_helper.to_array(tensor)
        if array.dtype == np.float32 and array.size > 256:
            half = numpy_helper.from_array(array.astype(np.float16), tensor.name + "_fp16")
            graph.initializer.remove(tensor)
            graph.initializer.append(half)
            casts.append(helper.make_node("Cast", [half.name], [tensor.name], to=TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
    for part in (graph, *graph.node, *graph.value_info, *graph.initializer, *graph.input, *graph.output):
        del part.metadata_props[:]
