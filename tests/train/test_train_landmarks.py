"""Where landmarks are is learnt from bodies, measured on others, and read where files are made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from two_people_take import walking

from depthmocap.body.landmarks import LANDMARK_INDEX
from depthmocap.errors import InputError
from depthmocap.exporting.bone_rotations import rest_offsets
from depthmocap.exporting.landmark_model import LandmarkModel
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP
from depthmocap.train.train_landmarks import LandmarkTraining, train_landmarks


def test_a_few_bodies_tell_nearly_what_many_do(tmp_path: Path) -> None:
    pytest.importorskip("anny")
    settings = LandmarkTraining(tmp_path / "out.npz", bodies=20, held_out=1, postures=2)
    found = LandmarkModel.load(train_landmarks(settings, Console(quiet=True)))
    packaged = LandmarkModel.load()
    person = rest_offsets(walking(30) @ Y_UP_FROM_Z_UP.T)
    apart = np.linalg.norm(found.offsets_m(person) - packaged.offsets_m(person), axis=-1)
    assert np.median(apart) < 0.01
    heel = LANDMARK_INDEX["RHeel"]
    assert found.error[heel] < 0.003 > packaged.error[heel]


def test_settings_that_learn_nothing_are_refused() -> None:
    with pytest.raises(InputError, match=r"ends in \.npz"):
        LandmarkTraining(Path("landmarks.onnx"))
    with pytest.raises(InputError, match="at least 20"):
        LandmarkTraining(Path("landmarks.npz"), bodies=3)
