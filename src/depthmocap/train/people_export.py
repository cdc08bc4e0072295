"""The network that finds people as an ONNX file (extra: train)."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float32
from numpy import ndarray

from depthmocap.segment.depth_grid import CHANNELS, GRID_STEP
from depthmocap.train.onnx_export import quiet, write_program
from depthmocap.train.people_network import PeopleNet
from depthmocap.train.quantise import quantise_people


def export_people_onnx(
    network: PeopleNet,
    path: Path,
    metadata: dict[str, str],
    pictures: Sequence[Float32[ndarray, "8 rows columns"]] = (),
) -> Path:
    """Write the network as ONNX: input ``cells`` (n, 8, rows, columns), both multiples of 8, output ``people``
    (n, 7, rows, columns). Batch norms are folded into the convolutions.

    Args:
        pictures: inputs of the network from training data, by which its convolutions are put into 8 bits: two thirds
            of the time. Without them, weights are stored as fp16.
    """
    network = copy.deepcopy(network).cpu().eval()
    sizes = {0: torch.export.Dim("n", min=1)} | {
        i: GRID_STEP * torch.export.Dim(f"steps{i}", min=1, max=256) for i in (2, 3)
    }
    with quiet():
        program = torch.onnx.export(
            network, (torch.zeros(2, CHANNELS, 72, 88),), input_names=["cells"], output_names=["people"], dynamo=True,
            verbose=False, dynamic_shapes={"x": sizes},
        )  # fmt: skip
    assert program is not None
    metadata = {"network": "people", **metadata}
    if not len(pictures):
        return write_program(program, path, metadata)
    with tempfile.TemporaryDirectory() as folder:
        return quantise_people(write_program(program, Path(folder) / "float.onnx", metadata), pictures, path)
