"""The network that finds people in whole depth images (extra: train)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from depthmocap.segment.depth_grid import CHANNELS

#: Channels at cells, and at cells two, four and eight times as wide.
WIDTHS = (16, 24, 48, 96)
#: Outputs of a cell: logits of its 2×2 samples, and the offset to the centre of the person (metres).
OUTPUTS = 7


def _block(channels_in: int, channels_out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, 3, stride, 1, bias=False),
        nn.BatchNorm2d(channels_out),
        nn.ReLU(inplace=True),
    )


def _upsample(x: Tensor) -> Tensor:
    return nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")


class PeopleNet(nn.Module):
    """A small U-Net over the cells of a :class:`~depthmocap.segment.depth_grid.DepthGrid`.

    ``forward`` takes ``(n, 8, rows, columns)`` and gives ``(n, 7, rows, columns)``: logits that each of a cell's 2×2
    samples shows a person, row by row, and the offset in metres from the cell's surface to the centre of that person's
    trunk, in the axes of the grid (right, down, forwards).
    """

    def __init__(self, widths: tuple[int, int, int, int] = WIDTHS) -> None:
        super().__init__()
        cells, two, four, eight = widths
        self.cells = _block(CHANNELS, cells)
        self.two = nn.Sequential(_block(cells, two, 2), _block(two, two))
        self.four = nn.Sequential(_block(two, four, 2), _block(four, four), _block(four, four))
        self.eight = nn.Sequential(_block(four, eight, 2), *(_block(eight, eight) for _ in range(3)))
        self.to_four, self.from_four = nn.Conv2d(eight, four, 1), _block(four, four)
        self.to_two, self.from_two = nn.Conv2d(four, two, 1), _block(two, two)
        self.head = nn.Conv2d(two + cells, 16, 1)
        self.out = nn.Conv2d(16, OUTPUTS, 1)

    def forward(self, x: Tensor) -> Tensor:
        cells = self.cells(x)
        two = self.two(cells)
        four = self.four(two)
        four = self.from_four(four + _upsample(self.to_four(self.eight(four))))
        two = self.from_two(two + _upsample(self.to_two(four)))
        # The head of both joined, with the wider cells' part made before these are split: a quarter of the work.
        weight, count = self.head.weight, cells.shape[1]
        head = nn.functional.conv2d(cells, weight[:, :count], self.head.bias)
        head = head + _upsample(nn.functional.conv2d(two, weight[:, count:]))
        return self.out(torch.relu(head))
