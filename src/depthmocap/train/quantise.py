"""Networks in 8-bit integers: two and a half times as fast on a CPU, and half the size (extra: train)."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import Float32
from numpy import ndarray

from depthmocap.core.output import atomic_write

if TYPE_CHECKING:
    import onnx

#: Operations in 8 bits. The head is not among them: it is small, since only the person's pixels have one.
_KINDS = ["Conv", "Relu", "Add", "Concat", "Reshape", "Transpose", "Gather"]
#: Those of the networks that find people and fronts.
_PLAIN_KINDS = ["Conv", "Relu", "Add"]


def _joint_nodes(model: onnx.ModelProto) -> list[str]:
    """Names of the nodes that only the joints need, without the large convolutions."""
    makers = {name: node for node in model.graph.node for name in node.output}

    def behind(output: str) -> dict[str, onnx.NodeProto]:
        nodes, open_names = {}, [output]
        while open_names:
            node = makers.get(open_names.pop())
            if node is not None and node.name not in nodes:
                nodes[node.name] = node
                open_names += node.input
        return nodes

    kernels = {tensor.name: list(tensor.dims)[2:] for tensor in model.graph.initializer}
    labels = behind("probabilities")
    return [
        name
        for name, node in behind("joints").items()
        if name not in labels and not (node.op_type == "Conv" and kernels.get(node.input[1], [1]) != [1, 1])
    ]


def quantise(source: Path, windows: Sequence[Float32[ndarray, "3 _ _"]], path: Path) -> Path:
    """Write an ONNX classifier of ours with the convolutions of ``source`` in 8 bits.

    The joints' part stays in float except for convolutions of more than one pixel: positions need more than 8 bits.
    Ranges of activations are those on ``windows``, from training data; see :func:`_in_integers`.
    """
    return _in_integers(source, "windows", windows, _KINDS, _joint_nodes, path)


def quantise_people(source: Path, pictures: Sequence[Float32[ndarray, "8 rows columns"]], path: Path) -> Path:
    """Write an ONNX network that finds people with the convolutions of ``source`` in 8 bits, except for the last.

    Ranges of activations are those on ``pictures``, inputs of one size from training data; see :func:`_in_integers`.
    """
    return _in_integers(source, "cells", pictures, _PLAIN_KINDS, _last_convolution, path)


def quantise_front(source: Path, windows: Sequence[Float32[ndarray, "3 _ _"]], path: Path) -> Path:
    """Write an ONNX network that tells fronts with the convolutions of ``source`` in 8 bits, except for the last, whose
    output is weights; see :func:`_in_integers`."""
    return _in_integers(source, "windows", windows, _PLAIN_KINDS, _last_convolution, path)


def _last_convolution(model: onnx.ModelProto) -> list[str]:
    """The last convolution: logits, metres and weights need more than 8 bits."""
    return [node.name for node in model.graph.node if node.op_type == "Conv"][-1:]


def _in_integers(
    source: Path,
    name: str,
    inputs: Sequence[ndarray],
    kinds: list[str],
    kept_in_float: Callable[[onnx.ModelProto], list[str]],
    path: Path,
) -> Path:
    """Write a network with operations of some kinds in 8 bits.

    Weights are scaled channel by channel and use 7 of their 8 bits, because older processors' sums overflow otherwise;
    inputs, outputs and metadata stay as they are.

    Args:
        name: of the network's input.
        kept_in_float: names of nodes that are left as they are.
    """
    import onnx
    import onnxruntime
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    class Inputs(CalibrationDataReader):
        def __init__(self) -> None:
            self._open = iter(inputs)

        def get_next(self) -> dict[str, ndarray] | None:  # pyright: ignore[reportIncompatibleMethodOverride] - None ends it
            item = next(self._open, None)
            return None if item is None else {name: item[None]}

    with tempfile.TemporaryDirectory() as folder:
        # The runtime's own pass folds the casts behind which weights are stored in fp16.
        plain = Path(folder) / "plain.onnx"
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.optimized_model_filepath = str(plain)
        options.log_severity_level = 3
        onnxruntime.InferenceSession(source.read_bytes(), options, providers=["CPUExecutionProvider"])
        integer = Path(folder) / "integer.onnx"
        logging.disable(logging.WARNING)  # advice about a pass that has just been made
        try:
            quantize_static(
                plain, integer, Inputs(), quant_format=QuantFormat.QDQ, per_channel=True, reduce_range=True,
                activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8,
                op_types_to_quantize=kinds, nodes_to_exclude=kept_in_float(onnx.load(plain)),
            )  # fmt: skip
        finally:
            logging.disable(logging.NOTSET)
        model = onnx.load(integer)
    kept = {entry.key: entry.value for entry in onnx.load(source).metadata_props}
    onnx.helper.set_model_props(model, {**kept, "precision": "int8"})
    with atomic_write(path) as unfinished:
        onnx.save(model, unfinished)
    return path
