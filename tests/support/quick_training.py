"""Training of which a test wants no files for use, which take longer to make than its training."""

from __future__ import annotations

from pathlib import Path

import pytest


def skip_export(patch: pytest.MonkeyPatch) -> None:
    """Let the training of a classifier end without its ONNX files."""
    from depthmocap.train import train_classifier as train

    patch.setattr(train, "export_onnx", lambda network, path, metadata: path)
    patch.setattr(train, "quantise", lambda source, windows, path: path)
    patch.setattr(train, "_CALIBRATION", 0)  # windows that nothing would be done with


def skip_export_of_votes(patch: pytest.MonkeyPatch) -> None:
    """Let the training of the voting network end with an empty ONNX file."""
    from depthmocap.train import train_votes as votes_train

    def empty(network: object, path: Path) -> Path:
        path.touch()
        return path

    patch.setattr(votes_train, "export_votes", empty)
