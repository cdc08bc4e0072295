"""The body-part network of the paper (Shafaei and Little 2016, Sec. IV-A), with random weights, to time it.

Layers are given as (kernel, stride) with Caffe's rounding. The paper states the input (250×250), the coarse scores
(44×14×14), the last deconvolution (19×19) and the output (44×250×250). Without padding behind the first layer, and with
fused layers cropped about their centre, every size comes out as stated.
"""

from __future__ import annotations

import logging
import warnings
from pathlib import Path

import torch
from torch import Tensor, nn

from depthmocap.body.regions import REGION_COUNT

CLASSES = REGION_COUNT + 1
SIDE = 250


class PaperNetwork(nn.Module):
    """Depth (n, 1, 250, 250) to scores (n, 44, 250, 250); 1.75 million parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(1, 64, 5, 2, 2)
        self.conv2 = nn.Conv2d(64, 128, 3)
        self.conv3 = nn.Conv2d(128, 256, 5)
        self.conv4 = nn.Conv2d(256, CLASSES, 3)
        self.score1 = nn.Conv2d(64, CLASSES, 1)
        self.score2 = nn.Conv2d(128, CLASSES, 1)
        self.up3 = nn.ConvTranspose2d(CLASSES, CLASSES, 3, 1)
        self.up2 = nn.ConvTranspose2d(CLASSES, CLASSES, 4, 2)
        self.up1 = nn.ConvTranspose2d(CLASSES, CLASSES, 19, 7)

    def forward(self, x: Tensor) -> Tensor:
        pool1 = nn.functional.max_pool2d(torch.relu(self.conv1(x)), 3, 3, ceil_mode=True)
        pool2 = nn.functional.max_pool2d(torch.relu(self.conv2(pool1)), 2, 2, ceil_mode=True)
        coarse = self.up3(self.conv4(torch.relu(self.conv3(pool2))))
        middle = self.up2(coarse + self.score2(_crop(pool2, coarse)))
        return self.up1(middle + self.score1(_crop(pool1, middle)))


def _crop(x: Tensor, like: Tensor) -> Tensor:
    """The middle of ``x``, of the size of ``like``."""
    height, width = like.shape[2:]
    top, left = (x.shape[2] - height) // 2, (x.shape[3] - width) // 2
    return x[:, :, top : top + height, left : left + width]


def parameter_count(network: nn.Module) -> int:
    """Weights and biases of a network."""
    return sum(parameter.numel() for parameter in network.parameters())


def gflop(network: nn.Module, example: Tensor) -> float:
    """Operations (10⁹) of the convolutions and deconvolutions in a forward pass, a multiply-add counted as two."""
    total = 0

    def count(layer: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        nonlocal total
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            # A convolution's kernel is applied once an output pixel, a deconvolution's once an input pixel.
            pixels = (output if isinstance(layer, nn.Conv2d) else inputs[0])[0, 0].numel()
            total += 2 * layer.weight.numel() * pixels

    hooks = [module.register_forward_hook(count) for module in network.modules()]
    with torch.no_grad():
        network.eval()(example)
    for hook in hooks:
        hook.remove()
    return total / 1e9


def export_paper_network(network: PaperNetwork, path: Path) -> Path:
    """The network as ONNX, input ``depth`` (n, 1, 250, 250), output ``scores``."""
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it misses packages that are not needed here
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network.eval(), (torch.zeros(2, 1, SIDE, SIDE),), input_names=["depth"], output_names=["scores"],
            dynamo=True, verbose=False, dynamic_shapes={"x": {0: torch.export.Dim("n", min=1)}},
        )  # fmt: skip
    assert program is not None
    program.save(path)
    return path
