"""Networks that label every pixel of a window (extra: train). Inference runs their ONNX form, see ``runtime``."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.paper import PaperNet
from depthmocap.classify.preprocess import DEPTH_SCALE_M, PIXEL_M, WINDOW

CLASSES = REGION_COUNT + 1
#: Offsets of joints are told in units of so many metres.
_UNIT_M = 0.3


def _block(channels_in: int, channels_out: int, stride: int = 1, kernel: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(channels_out),
        nn.ReLU(inplace=True),
    )


class _Residual(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _block(channels, channels)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


class FastNet(nn.Module):
    """A U-Net for laptop CPUs: half resolution is its finest level, and the head predicts 2×2 pixels at once.

    ``forward`` gives the head's logits, ``(n, 4·44, s/2, s/2)``: channel ``44·k + c`` is class ``c`` of the pixel
    at row ``k // 2``, column ``k % 2`` of each 2×2 group; and the joints ``(n, 18, 4)``: their places in the window
    (see ``Window.places_from_world``) and the logarithm of the error to expect, both of metres.

    For the joints every cell of 8×8 pixels that shows some of the person votes: it tells where it takes each joint to
    be, relative to its own surface, how much it has to say and how wrong it may be (as the anchors of Xiong et al.,
    "A2J", ICCV 2019).
    """

    input_shape = (3, WINDOW, WINDOW)
    #: Only the person's pixels are learnt.
    learns_background = False
    #: The second output is where the joints are.
    tells_joints = True

    def __init__(self, widths: tuple[int, ...] = (24, 48, 88, 136, 160), depths: tuple[int, ...] = (0, 1, 1, 2, 2)):
        super().__init__()
        self.widths, self.depths = widths, depths
        self.stem = nn.Sequential(nn.PixelUnshuffle(2), _block(12, widths[0]))
        levels = []
        for i in range(1, len(widths)):
            blocks = [_Residual(widths[i]) for _ in range(depths[i])]
            levels.append(nn.Sequential(_block(widths[i - 1], widths[i], 2), *blocks))
        self.down = nn.ModuleList(levels)
        self.lateral = nn.ModuleList(nn.Conv2d(widths[i + 1], widths[i], 1, bias=False) for i in range(len(widths) - 1))
        self.up = nn.ModuleList(
            _Residual(widths[i]) if i > 1 else _block(widths[i], widths[i]) for i in range(len(widths) - 1)
        )
        self.head = nn.Conv2d(widths[0], 4 * CLASSES, 1)
        self.joint_votes = nn.Sequential(_block(widths[_CELLS], 128), nn.Conv2d(128, 5 * len(JOINTS), 1))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        fine, coarse = self.features(x)
        return self.head(fine), self.joints(x, coarse)

    def features(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """What the head reads, ``(n, c, s/2, s/2)``, and what the joints are read from, ``(n, c, s/8, s/8)``."""
        x = self.stem(x)
        skips = [x]
        for level in self.down:
            skips.append(level(skips[-1]))
        x = skips.pop()
        coarse = x
        for i in reversed(range(len(self.lateral))):
            x = nn.functional.interpolate(self.lateral[i](x), scale_factor=2.0, mode="nearest") + skips[i]
            x = self.up[i](x)
            if i == _CELLS:
                coarse = x
        return x, coarse

    def joints(self, x: Tensor, coarse: Tensor) -> Tensor:
        """The joints of windows and their coarse features."""
        votes = self.joint_votes(coarse).float().unflatten(1, (len(JOINTS), 5)).flatten(3)
        size = x.shape[-1] // coarse.shape[-1]
        shown = nn.functional.avg_pool2d(x[:, 1:2], size)
        depth = nn.functional.avg_pool2d(x[:, :1], size) / shown.clamp(min=1e-3) * DEPTH_SCALE_M
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
NETWORKS: dict[str, type[FastNet] | type[PaperNet]] = {"fast": FastNet, "paper": PaperNet}


def masked_outputs(network: Network, x: Tensor, labels: Tensor, mask: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
    """Logits (m, 44) and labels (m,) of the masked pixels alone, and the joints (n, 18, 4) of a network that tells
    them.

    Ours never makes its head's output for the rest: a person fills a sixth of a window. The paper's last layer covers
    19×19 pixels and makes them all.

    Args:
        x: (n, c, s, s) windows.
        labels: (n, s, s) integers.
        mask: (n, s, s) bool.
    """
    if isinstance(network, PaperNet):
        return network(x).permute(0, 2, 3, 1)[mask], labels[mask], None
    fine, coarse = network.features(x)
    features = fine.permute(0, 2, 3, 1).flatten(0, 2)
    mask4 = nn.functional.pixel_unshuffle(mask[:, None].to(torch.uint8), 2).permute(0, 2, 3, 1).reshape(-1, 4)
    labels4 = nn.functional.pixel_unshuffle(labels[:, None], 2).permute(0, 2, 3, 1).reshape(-1, 4)
    groups = mask4.any(1).nonzero()[:, 0]
    pixels = mask4[groups].flatten().nonzero()[:, 0]
    head = network.head
    logits = nn.functional.linear(features.index_select(0, groups), head.weight.flatten(1), head.bias)
    chosen = logits.reshape(-1, CLASSES).index_select(0, pixels)
    return chosen, labels4[groups].flatten()[pixels], network.joints(x, coarse)
