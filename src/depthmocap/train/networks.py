"""Networks that label every pixel of a window (extra: train). Inference runs their ONNX form, see ``runtime``."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.window import DEPTH_SCALE_M, PIXEL_M, WINDOW, WINDOW_STEP, NetworkName
from depthmocap.train.paper_network import PaperNet

CLASSES = REGION_COUNT + 1
#: Unit of the joints' offsets, metres.
_UNIT_M = 0.3


def _convolution(channels_in: int, channels_out: int, stride: int, norm: bool) -> list[nn.Module]:
    return [
        nn.Conv2d(channels_in, channels_out, 3, stride, 1, bias=not norm),
        *([nn.BatchNorm2d(channels_out)] if norm else []),
    ]


def _block(channels_in: int, channels_out: int, stride: int = 1, norm: bool = True) -> nn.Sequential:
    return nn.Sequential(*_convolution(channels_in, channels_out, stride, norm), nn.ReLU(inplace=True))


class _Groups(nn.Module):
    """Pixels of 2×2 groups as channels, as ``nn.PixelUnshuffle(2)`` gives them; exported, slices take a third of the
    time."""

    def forward(self, x: Tensor) -> Tensor:
        return torch.stack([x[:, :, i::2, j::2] for i in (0, 1) for j in (0, 1)], 2).flatten(1, 2)


def _upsample(x: Tensor) -> Tensor:
    """Every pixel four times: an enlargement by two. Exported, copying rows takes a tenth of the time of ``Resize``."""
    _, channels, height, width = x.shape
    x = x.permute(0, 2, 3, 1)
    x = torch.cat([x, x], 3).reshape(-1, height, 1, 2 * width * channels)
    return torch.cat([x, x], 2).reshape(-1, 2 * height, 2 * width, channels).permute(0, 3, 1, 2)


def _person_groups(x: Tensor) -> Tensor:
    """Numbers of the 2×2 groups of pixels that show some of the person, window after window in row-major order."""
    return nn.functional.max_pool2d(x[:, 1:2], 2).flatten().nonzero()[:, 0]


class _Residual(nn.Module):
    def __init__(self, channels: int, norm: bool) -> None:
        super().__init__()
        self.first = _block(channels, channels, norm=norm)
        self.second = nn.Sequential(*_convolution(channels, channels, 1, norm))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


class FastNet(nn.Module):
    """A U-Net for laptop CPUs: half resolution is its finest level, and the head predicts 2×2 pixels at once.

    ``forward`` gives the probabilities ``(m, 4, 44)`` of the classes in those 2×2 groups of pixels that show some of
    the person, window after window in row-major order: pixel ``k`` of a group is at its row ``k // 2``, column
    ``k % 2``. A person fills a quarter of a window, and the rest is not computed. It also gives the joints
    ``(n, 18, 4)``: their positions in the window (``Window.positions_from_world``) and the logarithm of the expected
    error, both of metres.

    For the joints each cell of 8×8 pixels that shows some of the person votes: it predicts the offset of each joint
    from its own surface, the weight of its vote and the expected error (as the anchors of Xiong et al., "A2J", ICCV
    2019).
    """

    input_shape = (3, WINDOW, WINDOW)
    #: Sides of an input may be any multiples of this.
    size_step: int | None = WINDOW_STEP
    #: Only the person's pixels are learnt.
    learns_background = False
    #: The second output holds the joints.
    predicts_joints = True

    def __init__(
        self,
        widths: tuple[int, ...] = (24, 48, 88, 136, 160),
        depths: tuple[int, ...] = (0, 1, 1, 2, 2),
        norm: bool = True,
    ) -> None:
        """
        Args:
            widths: channels of the levels, from fine to coarse.
            depths: residual blocks of each on the way down; the finest has none.
        """
        super().__init__()
        self.widths, self.depths = widths, depths
        self.stem = nn.Sequential(_Groups(), _block(12, widths[0], norm=norm))
        levels = []
        for i in range(1, len(widths)):
            blocks = [_Residual(widths[i], norm) for _ in range(depths[i])]
            levels.append(nn.Sequential(_block(widths[i - 1], widths[i], 2, norm), *blocks))
        self.down = nn.ModuleList(levels)
        self.lateral = nn.ModuleList(nn.Conv2d(widths[i + 1], widths[i], 1, bias=False) for i in range(len(widths) - 1))
        self.up = nn.ModuleList()
        for i in range(len(widths) - 1):
            self.up.append(_Residual(widths[i], norm) if i > 1 else _block(widths[i], widths[i], norm=norm))
        self.head = nn.Conv2d(widths[0], 4 * CLASSES, 1)
        self.joint_votes = nn.Sequential(_block(widths[_CELLS], 128, norm=norm), nn.Conv2d(128, 5 * len(JOINTS), 1))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        fine, coarse = self.features(x)
        return torch.softmax(self.group_logits(fine, _person_groups(x)), -1), self.joints(x, coarse)

    def group_logits(self, fine: Tensor, groups: Tensor) -> Tensor:
        """Logits (m, 4, 44) of some groups of pixels, numbered window after window in row-major order."""
        rows = fine.permute(0, 2, 3, 1).flatten(0, 2).index_select(0, groups)
        return nn.functional.linear(rows, self.head.weight.flatten(1), self.head.bias).unflatten(1, (4, CLASSES))

    def features(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Features of the head, ``(n, c, h/2, w/2)``, and of the joints, ``(n, c, h/8, w/8)``."""
        x = self.stem(x)
        skips = [x]
        for level in self.down:
            skips.append(level(skips[-1]))
        x = skips.pop()
        coarse = x
        for i in reversed(range(len(self.lateral))):
            x = _upsample(self.lateral[i](x)) + skips[i]
            x = self.up[i](x)
            if i == _CELLS:
                coarse = x
        return x, coarse

    def joints(self, x: Tensor, coarse: Tensor) -> Tensor:
        """The joints of windows and their coarse features."""
        votes = self.joint_votes(coarse).float().unflatten(1, (len(JOINTS), 5)).flatten(3)
        size = x.shape[-1] // coarse.shape[-1]
        depth, shown = (x[:, i : i + 1].unflatten(3, (-1, size)).unflatten(2, (-1, size)).mean((3, 5)) for i in (0, 1))
        depth = depth / shown.clamp(min=1e-3) * DEPTH_SCALE_M
        pixel_m = torch.exp2(x[:, 2:, :1, :1]) * PIXEL_M
        down, right = (
            pixel_m * ((torch.arange(cells, device=x.device) + 0.5) * size - pixels / 2)
            for cells, pixels in zip(coarse.shape[-2:], x.shape[-2:], strict=True)
        )
        right, down = right.expand_as(depth), down.mT.expand_as(depth)
        cells = torch.cat([right, down, depth], 1).flatten(2)
        weights = torch.softmax(votes[:, :, 0].masked_fill((shown == 0).flatten(2), -1e4), -1)
        places = ((cells[:, None] + votes[:, :, 1:4] * _UNIT_M) * weights[:, :, None]).sum(-1)
        return torch.cat([places, (votes[:, :, 4] * weights).sum(-1, keepdim=True)], -1)


#: The level of the U-Net whose cells vote for joints: of 8 pixels.
_CELLS = 2
Network = FastNet | PaperNet
NETWORKS: dict[NetworkName, type[FastNet] | type[PaperNet]] = {
    "fast": FastNet,
    "paper": PaperNet,
}


def _by_squares(images: Tensor, side: int) -> Tensor:
    """Pixels (n, h, w) by squares, (squares, side²), image after image in row-major order; zeros beyond an image."""
    beyond = (0, -images.shape[-1] % side, 0, -images.shape[-2] % side)
    squares = nn.functional.pixel_unshuffle(nn.functional.pad(images[:, None], beyond), side)
    return squares.permute(0, 2, 3, 1).flatten(0, 2)


def masked_outputs(network: Network, x: Tensor, labels: Tensor, mask: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
    """Logits (m, 44) and labels (m,) of the masked pixels alone, and the joints (n, 18, 4) of a network that predicts
    them.

    Our head computes no other pixels: a person fills a quarter of a window. The paper's network computes all of them,
    square after square.

    Args:
        x: (n, c, h, w) windows.
        labels: (n, h, w) integers.
        mask: (n, h, w) bool.
    """
    if isinstance(network, PaperNet):
        mask, labels = (_by_squares(image, network.up1.stride[0]).flatten() for image in (mask.to(torch.uint8), labels))
        pixels = mask.nonzero()[:, 0]
        return network.squares(x).flatten(0, 3).index_select(0, pixels), labels.index_select(0, pixels), None
    fine, coarse = network.features(x)
    mask4, labels4 = _by_squares(mask.to(torch.uint8), 2), _by_squares(labels, 2)
    groups = mask4.any(1).nonzero()[:, 0]
    pixels = mask4[groups].flatten().nonzero()[:, 0]
    logits = network.group_logits(fine, groups).flatten(0, 1).index_select(0, pixels)
    return logits, labels4[groups].flatten()[pixels], network.joints(x, coarse)
