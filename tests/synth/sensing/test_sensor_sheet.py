"""The contact sheet of sensors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("anny")

from depthmocap.errors import InputError
from depthmocap.synth.sensing import sensor_sheet
from depthmocap.synth.sensing.sensor_sheet import SensorSheetSettings, write_sensor_sheet


def test_the_sheet_shows_what_a_seed_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensor_sheet, "SHOWN", ("itop", "azure-nfov-binned"))
    pictures = []
    for name, seed in (("a.png", 0), ("b.png", 0), ("c.png", 1)):
        write_sensor_sheet(SensorSheetSettings(tmp_path / name, seed))
        pictures.append(np.array(Image.open(tmp_path / name)))
    assert pictures[0].shape[1] == 1400 and pictures[0].std() > 20
    assert (pictures[0] == pictures[1]).all() and (pictures[0] != pictures[2]).mean() > 0.02
    with pytest.raises(InputError, match="cannot write"):
        write_sensor_sheet(SensorSheetSettings(tmp_path / "a.png" / "b.png"))


def test_settings_that_cannot_be() -> None:
    with pytest.raises(InputError, match=r"--out must end in \.png or \.webp, got a\.jpg"):
        SensorSheetSettings(Path("a.jpg"))
    with pytest.raises(InputError, match="--seed"):
        SensorSheetSettings(seed=-1)
