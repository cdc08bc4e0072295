"""The body-part network of the paper (Shafaei and Little 2016, Sec. IV-A, Fig. 3), the baseline of comparisons (extra:
train). Layers, rounding of sizes and initialisation are those of the authors' released Caffe model."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from depthmocap.body.regions import REGION_COUNT
from depthmocap.classify.window import PAPER_WINDOW

_CLASSES = REGION_COUNT + 1


class PaperNet(nn.Module):
    """A fully convolutional network with two fused skips: windows (n, 2, 250, 250) to scores (n, 44, 250, 250).

    It reads the first channel alone, the depth; the second is the mask of the window. Sizes are rounded as Caffe does
    (pooling up), skips are cropped about their middle, the coarse scores are 44×14×14.
    """

    input_shape = (2, PAPER_WINDOW, PAPER_WINDOW)
    size_step: int | None = None
    #: The empty pixels around the person are learnt too, as background.
    learns_background = True
    predicts_joints = False

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(1, 64, 5, 2, 2)
        self.conv2 = nn.Conv2d(64, 128, 3)
        self.conv3 = nn.Conv2d(128, 256, 5)
        self.conv4 = nn.Conv2d(256, _CLASSES, 3)
        self.score1 = nn.Conv2d(64, _CLASSES, 1)
        self.score2 = nn.Conv2d(128, _CLASSES, 1)
        self.up3 = nn.ConvTranspose2d(_CLASSES, _CLASSES, 3, 1)
        self.up2 = nn.ConvTranspose2d(_CLASSES, _CLASSES, 4, 2)
        self.up1 = nn.ConvTranspose2d(_CLASSES, _CLASSES, 19, 7)
        self.dropout = nn.Dropout(0.5)
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                nn.init.normal_(module.weight, std=0.01)
                assert module.bias is not None
                nn.init.constant_(module.bias, 1.0 if isinstance(module, nn.Conv2d) else 0.0)

    def forward(self, x: Tensor) -> Tensor:
        return self.up1(self._middle(x))

    def squares(self, x: Tensor) -> Tensor:
        """The same scores by squares of 7×7 pixels: (n, 36, 36, 49, 44), windows padded at the right and at the bottom
        to 252 pixels.

        One convolution computes all squares, which in half precision trains in half the time: the transposed
        convolution is most of the network's work, and slow on processors.
        """
        kernel, side = self.up1.kernel_size[0], self.up1.stride[0]
        reach = -(-kernel // side)
        weight = nn.functional.pad(self.up1.weight, (0, reach * side - kernel) * 2)
        weight = weight.unflatten(3, (reach, side)).unflatten(2, (reach, side)).flip((2, 4))
        weight = weight.permute(3, 5, 1, 0, 2, 4).flatten(0, 2)
        assert self.up1.bias is not None
        scores = nn.functional.conv2d(self._middle(x), weight, self.up1.bias.repeat(side**2), padding=reach - 1)
        return scores.permute(0, 2, 3, 1).unflatten(3, (side**2, _CLASSES))

    def _middle(self, x: Tensor) -> Tensor:
        """Input of the last layer."""
        pool1 = nn.functional.max_pool2d(torch.relu(self.conv1(x[:, :1])), 3, 3, ceil_mode=True)
        pool2 = nn.functional.max_pool2d(torch.relu(self.conv2(pool1)), 2, 2, ceil_mode=True)
        coarse = self.up3(self.conv4(torch.relu(self.conv3(pool2))))
        middle = self.up2(self.dropout(coarse + self.score2(_crop(pool2, coarse))))
        return self.dropout(middle + self.score1(_crop(pool1, middle)))


def _crop(x: Tensor, like: Tensor) -> Tensor:
    """The middle of ``x``, of the size of ``like``."""
    height, width = like.shape[2:]
    top, left = (x.shape[2] - height) // 2, (x.shape[3] - width) // 2
    return x[:, :, top : top + height, left : left + width]
