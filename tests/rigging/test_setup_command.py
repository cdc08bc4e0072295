"""``depthmocap setup`` on three cameras of the packaged recording, played in virtual time, and what it says of cameras
that will not do."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rig_states import calibration, rig_state

from depthmocap.cameras.source import ConnectedCamera
from depthmocap.cli import main
from depthmocap.core.console import Terminal
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet
from depthmocap.geometry import Rig, load_rig, rigid_inverse
from depthmocap.realtime.synced_reader import SyncedReader
from depthmocap.recordings.open_recording import open_recording, packaged_recording
from depthmocap.rigging import setup_command
from depthmocap.rigging.rig_session import RigSession, RigState, seen_enough
from depthmocap.rigging.setup_command import SetupSettings


@pytest.fixture(scope="module")
def frames() -> FrameSet:
    return open_recording(packaged_recording())[0]


def recording(path: Path, every: int = 2) -> Path:
    """Every so many-th frame of the packaged recording."""
    shutil.copytree(packaged_recording(), path)
    for folder in path.glob("cam*"):
        for i, frame in enumerate(sorted(file for file in folder.glob("*.png") if file.stem.isdecimal())):
            if i % every:
                frame.unlink()
    return path


@pytest.mark.slow
def test_a_rig_is_found_while_somebody_walks(virtual: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = recording(tmp_path / "walk"), tmp_path / "rig.json"
    command = ["setup", "--cameras", str(path), "--realtime", "--no-view", "--no-live", "--out", str(out)]
    assert main(command) == 0
    found, true = load_rig(out), load_rig(packaged_recording() / "rig.json")
    assert found.names == true.names
    for one, other in ((0, 1), (0, 2)):
        ours, theirs = (
            rigid_inverse(rig.cameras[one].world_from_camera) @ rig.cameras[other].world_from_camera
            for rig in (found, true)
        )
        assert np.linalg.norm(ours[:3, 3] - theirs[:3, 3]) < 0.04
    told = " ".join(capsys.readouterr().err.split())
    assert "cam0 – cam1 ±" in told and "walk" in told
    # A long path is broken where the terminal's line ends.
    assert "3 of 3 cameras are placed" in told and f"{out}hasthecameras" in told.replace(" ", "")


@pytest.mark.parametrize(
    ("cameras", "told"),
    [
        (["{walk}"], "is a recording: depthmocap calibrate places its cameras, and --realtime plays it"),
        (["{walk}#cam0", "--realtime"], "a rig has two cameras or more, and this is one (cam0)"),
        (["nowhere", "--realtime"], "is neither a recording nor a camera"),
        (["{walk}", "--realtime", "--out", "rig.txt"], "--out must end in .json"),
        (["{walk}", "--realtime", "--seconds", "0"], "--seconds must be positive"),
    ],
)
def test_what_cannot_be_set_up_is_one_line(
    cameras: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [word.format(walk=packaged_recording()) for word in cameras]
    assert main(["setup", "--no-view", "--cameras", *words]) == 2
    assert told in " ".join(capsys.readouterr().err.split())


def test_what_is_connected_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    found = [ConnectedCamera("azure:1", "Azure Kinect", "1", "it is on USB 2: use a blue port")]
    monkeypatch.setattr(setup_command, "find_cameras", lambda: (found, {"openni": "pip install it"}))
    assert main(["setup", "--no-view"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "found azure:1: Azure Kinect 1" in told
    assert "no depth camera was found: azure:1: it is on USB 2: use a blue port" in told


class Session(RigSession):
    """A session whose state is given."""

    def __init__(self, state: RigState) -> None:
        self.given, self.reader = state, SyncedReader([])

    def state(self) -> RigState:
        return self.given


class Shown:
    """A page on which somebody asks for something."""

    def __init__(self, *wanted: str, taken: bool = False) -> None:
        self.wanted: tuple[str, ...] | None = wanted or None
        self.taken, self.told_lines = threading.Event(), list[str]()
        self.page = SimpleNamespace(errors_shown=self._errors_shown)
        if taken:
            self.taken.set()

    def show(self, state: RigState) -> None:
        assert state.statuses

    @contextlib.contextmanager
    def _errors_shown(self) -> Iterator[None]:
        try:
            yield
        except InputError as error:
            self.told_lines.append(str(error))
            self.taken.set()


def until_end(state: RigState, shown: Any = None, **settings: Any) -> tuple[Any, str]:
    console = Terminal(record=True, width=300)
    walk = setup_command._Walk(SetupSettings(**settings), Session(state), shown, console)
    return walk.until_end(), console.export_text()


def test_the_walk_ends_when_the_rig_is_good_or_the_time_is_over_or_somebody_takes_it(frames: FrameSet) -> None:
    fair = rig_state(frames, 30.0, 8.0, faults={"cam1": "it is covered"})
    end, told = until_end(rig_state(frames, 5.0, 8.0))
    assert end is None and "cam0 – cam1 ± 5.0 mm, 0.20°: good; cam0 – cam2 ± 8.0 mm" in told
    end, told = until_end(fair, seconds=0.01)
    assert end is None and "• camera 'cam1': it is covered" in told and "• walk on" in told
    assert until_end(fair, Shown(taken=True))[0] is None
    assert until_end(dataclasses.replace(fair, ended=True))[0] is None


def test_good_pairs_of_few_poses_are_not_enough(frames: FrameSet) -> None:
    known = calibration(Rig(tuple(view.camera for view in frames.views)), 5.0, 8.0)
    few = [dataclasses.replace(pair, shared_poses=30) for pair in known.pairs]
    assert seen_enough(known) and not seen_enough(dataclasses.replace(known, pairs=[known.pairs[0], few[1]]))


def test_other_names_and_modes_open_the_cameras_anew_and_wrong_ones_are_told(frames: FrameSet) -> None:
    fair = rig_state(frames, 30.0, 8.0)
    specs, sources = until_end(fair, Shown(str(packaged_recording())))[0]
    assert specs == (str(packaged_recording()),) and [each.name for each in sources] == ["cam0", "cam1", "cam2"]
    wrong = Shown("nowhere")
    assert until_end(fair, wrong)[0] is None and "nowhere is neither" in wrong.told_lines[0]


def test_the_live_view_goes_on_with_the_rig(
    frames: FrameSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    rig = Rig(tuple(view.camera for view in frames.views))
    captures: list[Any] = []
    monkeypatch.setattr(setup_command, "_ready_classifier", lambda *others: None)
    monkeypatch.setattr(setup_command, "_walk", lambda *others: (calibration(rig, 5.0, 8.0), ("walk",), 3, False))
    monkeypatch.setattr(setup_command, "run_live", lambda *asked: captures.append(asked))
    out = tmp_path / "rig.json"
    command = ["setup", "--cameras", "synthetic", "--no-open", "--port", "0", "--out", str(out)]
    assert main(command) == 0
    ((live, _, page),) = captures
    assert (live.sources, live.rig, live.view) == (("walk",), out, True) and page.url.startswith("http://127.0.0.1:")
    assert load_rig(out).names == rig.names
    assert "Good: 3 of 3 cameras are placed" in " ".join(capsys.readouterr().err.split())
