"""The network of bones' rotations: trained on small clips, written, and read where files are made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clip_files import skeleton, write_bvh
from rich.console import Console

from depthmocap.errors import InputError
from depthmocap.exporting.learnt_rotations import LOOKED_BACK_S, RotationNetwork
from depthmocap.synth.motion.mocap import split_of
from depthmocap.train.train_rotations import RotationTraining, train_rotations

QUIET = Console(quiet=True)


def clip_of(split: str) -> str:
    return next(name for name in (f"clip_{i}" for i in range(1000)) if split_of(name) == split)


def test_a_network_is_trained_and_read(tmp_path: Path) -> None:
    pytest.importorskip("bvhio")
    pytest.importorskip("anny")
    pytest.importorskip("torch")
    swings = [{"forearm.L": (0, 0, 40 + 5 * i), "shin.R": (4 * i, 0, 0)} for i in range(12)]
    write_bvh(tmp_path / f"{clip_of('train')}.bvh", skeleton("mixamo"), swings)
    settings = RotationTraining((tmp_path,), tmp_path / "out.npz", epochs=2, bodies=1, hidden=8)
    with pytest.raises(InputError, match="no readable clip is of the valid split"):
        train_rotations(settings, QUIET)
    write_bvh(tmp_path / f"{clip_of('valid')}.bvh", skeleton("mixamo"), swings)
    network = RotationNetwork.load(train_rotations(settings, QUIET))
    window = np.random.default_rng(0).normal(size=(len(LOOKED_BACK_S), 4, 18, 3))
    found = network(window, 4.0)
    np.testing.assert_allclose(found @ np.swapaxes(found, -1, -2), np.tile(np.eye(3), (4, 18, 1, 1)), atol=1e-6)


def test_settings_that_make_no_network_are_refused() -> None:
    with pytest.raises(InputError, match=r"ends in \.npz"):
        RotationTraining((Path("clips"),), Path("network.onnx"))
    with pytest.raises(InputError, match="at least 1"):
        RotationTraining((), Path("network.npz"))
