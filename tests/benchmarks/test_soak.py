"""The soak counts what its simulated cameras lose, in virtual time and with a pipeline that costs nothing."""

import importlib.util
import json
from pathlib import Path

import pytest
from fakes import Board, fake_pipeline
from rich.console import Console

from depthmocap.recordings.recording_writer import RecordingWriter

pytest.importorskip("foxglove")
PATH = Path(__file__).parents[2] / "benchmarks" / "soak.py"


@pytest.fixture
def soak(monkeypatch, virtual):
    spec = importlib.util.spec_from_file_location("soak", PATH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(__import__("sys").modules, "soak", module)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "time", virtual)
    monkeypatch.setattr(module, "load_pipeline", lambda *arguments, **others: fake_pipeline())
    monkeypatch.setattr(module, "FRAMES_PER_FILE", 200)
    return module


@pytest.fixture
def recording(tmp_path):
    scene = Board(4)
    with RecordingWriter(tmp_path / "recording", scene.rig) as writer:
        for i in range(20):
            writer.write(i * 100_000_000, {name: scene.depth(name, i * 0.1) for name in scene.rig.names})
    return tmp_path / "recording"


def run(soak, recording, tmp_path, minutes, faults):
    console = Console(record=True, width=200)
    folder = tmp_path / "files"
    folder.mkdir()
    settings = soak.SoakSettings(minutes, recording, rate_hz=10.0, faults=faults)
    numbers = json.loads(json.dumps(soak.soak(settings, folder, console)))
    for table in soak.tables(numbers):
        console.print(table)
    assert len(list(folder.iterdir())) == 1  # of all files only the last is kept
    return numbers, console.export_text()


def test_perfect_cameras_lose_nothing(soak, recording, tmp_path):
    numbers, text = run(soak, recording, tmp_path, 0.2, False)
    assert numbers["frames_sent"] == dict.fromkeys(Board(4).rig.names, 120)
    assert numbers["recording"]["written"] == numbers["recording"]["offered"] == numbers["frames_sent"]
    assert (numbers["recording"]["lost"], numbers["recording"]["last_file_complete"]) == (0, True)
    assert {status["counts"]["used"] for status in numbers["cameras"].values()} == {120}
    assert numbers["sets_per_second"] == pytest.approx(10, rel=0.06)
    assert numbers["latency_ms"]["p95"] < 1  # nothing costs time
    assert not numbers["problems"]
    assert len(numbers["memory"]["mb"]) >= 2
    assert "frames not recorded" in text


@pytest.mark.slow
def test_every_fault_comes_and_is_counted(soak, recording, tmp_path):
    numbers, text = run(soak, recording, tmp_path, 0.7, True)
    assert numbers["recording"]["written"] == numbers["recording"]["offered"]
    for name, status in numbers["cameras"].items():
        counts = status["counts"]
        assert {"frozen", "noise", "dark"} <= {kind for kind, times in counts.items() if times}, name
        assert status["opened_in_vain"] > 3, name
        assert status["clock_restarts"] >= 2, name  # one jump, and one new beginning
        assert counts["outages"] >= 2, name
        assert status["state"] == "at its end"
    assert numbers["sets_per_second"] > 9.5
    assert "cam3" in text
