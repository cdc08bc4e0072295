"""The network that tells which way a trunk faces (extra: train)."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from depthmocap.classify.front import DIRECTION_COUNT
from depthmocap.classify.window import WINDOW, WINDOW_STEP
from depthmocap.train.checkpoints import load_weights
from depthmocap.train.networks import FastNet

#: Places that the network attends to.
_GLANCES = 4
#: Width of the hidden layer.
_HIDDEN = 128


class FrontNet(nn.Module):
    """The way down of the classifier's U-Net, and a head on its coarsest level.

    ``forward`` takes windows ``(n, 3, h, w)`` and gives the logits ``(n, 64)`` of the directions
    (``classify.front.DIRECTIONS``). The head takes four weighted means over the cells.
    """

    input_shape = (3, WINDOW, WINDOW)
    #: Sides of an input may be any multiples of this.
    size_step = WINDOW_STEP

    def __init__(self) -> None:
        super().__init__()
        classifier = FastNet()
        channels = classifier.widths[-1]
        self.stem, self.down = classifier.stem, classifier.down
        self.attention = nn.Conv2d(channels, _GLANCES, 1)
        self.head = nn.Sequential(
            nn.Linear(_GLANCES * channels, _HIDDEN), nn.ReLU(), nn.Dropout(0.1), nn.Linear(_HIDDEN, DIRECTION_COUNT)
        )

    def encode(self, x: Tensor) -> Tensor:
        """Features ``(n, c, h/32, w/32)``."""
        x = self.stem(x)
        for level in self.down:
            x = level(x)
        return x

    def forward(self, x: Tensor) -> Tensor:
        cells = self.encode(x)
        weights = torch.softmax(self.attention(cells).flatten(2), -1)
        return self.head((weights @ cells.flatten(2).mT).flatten(1))

    def encoder_weights(self) -> list[nn.Parameter]:
        """Weights that a classifier has as well."""
        return [*self.stem.parameters(), *self.down.parameters()]

    def head_weights(self) -> list[nn.Parameter]:
        """The other weights."""
        return [*self.attention.parameters(), *self.head.parameters()]


def load_encoder(network: FrontNet, path: Path) -> None:
    """Load the way down of a classifier's .safetensors file.

    Raises:
        InputError: as ``load_weights``.
    """
    classifier = FastNet()
    load_weights(classifier, path)
    network.stem.load_state_dict(classifier.stem.state_dict())
    network.down.load_state_dict(classifier.down.state_dict())
