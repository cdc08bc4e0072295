"""The examples run as they stand, and print what they say."""

import re
import runpy
import shutil
import socket
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from depthmocap.recordings.open_recording import packaged_recording

EXAMPLES = Path(__file__).parents[1] / "examples"

Run = Callable[..., list[str]]


def beginning(folder: Path, seconds: int) -> Path:
    """The first seconds of the packaged recording, with its background and truth."""
    later = f"*00000[{seconds}-9]?????????.png"
    return shutil.copytree(packaged_recording(), folder / "beginning", ignore=shutil.ignore_patterns(later))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs an example as a user does; gives the lines that it printed."""

    def run_example(name: str, *arguments: object) -> list[str]:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run_example


def numbers(line: str) -> list[float]:
    """The numbers in a line."""
    return [float(number) for number in re.findall(r"-?\d+\.\d+|-?\d+", line)]


def test_every_example_is_run() -> None:
    names = {path.name for path in EXAMPLES.glob("*.py")}
    assert names == set(re.findall(r'run\(\s*"(\d\d_\w+\.py)"', Path(__file__).read_text(encoding="utf-8")))


def test_recording(run: Run, tmp_path: Path) -> None:
    lines = run("01_recording.py", beginning(tmp_path, 2))
    assert len(lines) == 16
    assert all("right wrist at" in line for line in lines)


def test_live(run: Run, tmp_path: Path) -> None:
    lines = run("02_live.py", beginning(tmp_path, 3))
    assert all(line.endswith(("the right hand is higher", "the left hand is higher")) for line in lines)
    assert lines


def test_viewer(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("viser")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    first, last = run("11_viewer.py", beginning(tmp_path, 2), port)
    assert first == f"open http://localhost:{port}" and last.startswith("somebody was in view in")


def test_own_camera(run: Run, tmp_path: Path) -> None:
    lines = run("03_own_camera.py", beginning(tmp_path, 3))
    assert lines
    assert all(0.7 < numbers(line)[-1] < 1.2 for line in lines), "the pelvis is as high as of somebody who stands"


def test_own_filter(run: Run, tmp_path: Path) -> None:
    usual, low = run("04_own_filter.py", beginning(tmp_path, 2))
    assert numbers(usual)[-1] == 100
    assert numbers(low)[-1] < 90


@pytest.mark.slow
def test_calibrate(run: Run, tmp_path: Path) -> None:
    lines = run("05_calibrate.py", beginning(tmp_path, 4), tmp_path / "found")
    assert sum(line.startswith("('cam") for line in lines) == 3
    assert 1.5 < numbers(lines[-1])[-1] < 1.9
    assert (tmp_path / "found" / "rig.html").exists()


def test_export(run: Run, tmp_path: Path) -> None:
    lines = run("06_export.py", beginning(tmp_path, 2), tmp_path)
    assert lines[-1].startswith("8 frames in ")
    assert {path.name for path in tmp_path.glob("half.*")} == {"half.csv", "half.trc", "half.bvh"}
    assert len((tmp_path / "half.csv").read_text(encoding="utf-8").splitlines()) == 9


@pytest.mark.usefixtures("body_model")
def test_data_engine(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "engine.webp"
    run("07_data_engine.py", path)
    with Image.open(path) as image:
        assert image.size == (5 * 240, 2 * 240)
        pixels = np.array(image.convert("RGB"))
    assert len(np.unique(pixels[240:].reshape(-1, 3), axis=0)) > 40  # labels below


@pytest.mark.slow
@pytest.mark.usefixtures("body_model")
def test_training(run: Run, tmp_path: Path) -> None:
    own, ridge, votes = (
        numbers(line)[-1] for line in run("08_training.py", beginning(tmp_path, 1), tmp_path / "out")[-3:]
    )
    assert votes < ridge < own < 15


def test_own_estimator(run: Run, tmp_path: Path) -> None:
    own, votes = (numbers(line)[-1] for line in run("09_own_estimator.py", beginning(tmp_path, 1)))
    assert votes < own < 15


def test_own_stream(run: Run, tmp_path: Path) -> None:
    lines = run("10_own_stream.py", beginning(tmp_path, 4))
    assert lines and all(line.startswith("person 1: ") and line.endswith(" m/s") for line in lines)
    assert all(0 <= numbers(line)[-1] < 10 for line in lines)
