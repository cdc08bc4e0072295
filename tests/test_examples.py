"""The examples run as they stand."""

import importlib.resources
import runpy
import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_recording_example(monkeypatch, capsys, tmp_path):
    demo = Path(str(importlib.resources.files("depthmocap") / "demo_recording"))
    later = "*00000[2-9]?????????.png"  # from two seconds after the first frame
    beginning = shutil.copytree(demo, tmp_path / "beginning", ignore=shutil.ignore_patterns(later))
    monkeypatch.setattr(sys, "argv", ["01_recording.py", str(beginning)])
    runpy.run_path(str(EXAMPLES / "01_recording.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 16
    assert all("right hand at" in line for line in lines)


def test_data_engine_example(body_model, monkeypatch, tmp_path):
    path = tmp_path / "engine.webp"
    monkeypatch.setattr(sys, "argv", ["02_data_engine.py", str(path)])
    runpy.run_path(str(EXAMPLES / "02_data_engine.py"), run_name="__main__")
    with Image.open(path) as image:
        assert image.size == (5 * 240, 2 * 240)
        pixels = np.array(image.convert("RGB"))
    assert len(np.unique(pixels[240:].reshape(-1, 3), axis=0)) > 40  # labels below
