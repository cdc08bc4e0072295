"""The examples run as they stand."""

import importlib.resources
import runpy
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_recording_example(monkeypatch, capsys):
    demo = importlib.resources.files("depthmocap") / "demo_recording"
    monkeypatch.setattr(sys, "argv", ["01_recording.py", str(demo)])
    runpy.run_path(str(EXAMPLES / "01_recording.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 50
    assert all("right hand at" in line for line in lines)
