"""What is left of run and live when they are killed or the disk is full, and that memory does not grow with frames."""

import itertools
import os
import subprocess
import sys
import textwrap
import weakref
from pathlib import Path

import pytest
from fakes import Board, fake_pipeline
from full_disk import files_of_at_most
from rich.console import Console

from depthmocap.cli import main
from depthmocap.exporting import read_csv, read_trc
from depthmocap.exporting.result_files import RESULT_FILES
from depthmocap.offline import run as offline
from depthmocap.offline.pipeline_settings import open_source
from depthmocap.realtime import live_capture as live
from depthmocap.realtime import live_command as command
from depthmocap.recordings.recording_writer import RecordingWriter

SETS = 40


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scene, path = Board(2), tmp_path_factory.mktemp("take") / "recording"
    with RecordingWriter(path, scene.rig) as writer:
        for i in range(SETS):
            writer.write(10**18 + i * 40_000_000, {name: scene.depth(name, i * 0.04) for name in scene.rig.names})
    return path


@pytest.fixture
def pipelines(monkeypatch):
    for module in (offline, command, live):
        monkeypatch.setattr(module, "load_pipeline", lambda *arguments, **others: fake_pipeline())


def words(name, recording, out):
    return [name, str(recording), "--out", str(out), *(["--no-report"] if name == "run" else [])]


SUPPORT = Path(__file__).parents[1] / "support"
KILLED = """
    import os, signal, sys
    tests, recording, out = sys.argv[1:]
    sys.path.insert(0, tests)
    from fakes import fake_pipeline
    from depthmocap.core import output
    from depthmocap.offline import run as offline
    from depthmocap.cli import main
    from depthmocap.realtime import live_capture as live, live_command as command

    for module in (offline, command, live):
        module.load_pipeline = lambda *arguments, **others: fake_pipeline()

    def die(*arguments):
        os.kill(os.getpid(), signal.SIGKILL)

    def at_pose(number):
        add, lines = output.LineFile.add, []
        def adding(self, line):
            add(self, line)
            lines.append(line)
            if len(lines) > number:
                die()
        output.LineFile.add = adding

    def at_trc():
        output.Path.replace = die

    for name in ("run", "live"):
        for moment in (lambda: at_pose(7), at_trc):
            if not os.fork():
                moment()
                main([name, recording, "--out", os.path.join(out, name), *["--no-report"][: name == "run"]])
                os._exit(1)
            assert os.waitstatus_to_exitcode(os.wait()[1]) == -signal.SIGKILL
            print(len(open(os.path.join(out, name, "pose.csv")).readlines()))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes of POSIX")
@pytest.mark.slow
def test_after_a_kill_poses_are_there_and_the_next_run_is_right(recording, pipelines, tmp_path):
    script = [sys.executable, "-c", textwrap.dedent(KILLED), str(SUPPORT), str(recording), str(tmp_path)]
    told = subprocess.run(script, check=True, capture_output=True, text=True).stdout.splitlines()
    assert [int(line) for line in told] == [8, SETS + 1, 8, SETS + 1]
    for name in ("run", "live"):
        left = [path.name for path in (tmp_path / name).iterdir()]
        assert ".lock" in left and any(".part-" in each for each in left)
        assert len(read_csv(tmp_path / name / "pose.csv")[0]) == SETS
        assert main(words(name, recording, tmp_path / name)) == 0
        assert {path.name for path in (tmp_path / name).iterdir()} == {*RESULT_FILES}
        assert main(words(name, recording, tmp_path / "new" / name)) == 0
        for each in ("pose.csv", "pose.trc", "pose.bvh"):
            assert (tmp_path / name / each).read_bytes() == (tmp_path / "new" / name / each).read_bytes()


@pytest.mark.parametrize("name", ["run", "live"])
def test_a_full_disk_is_one_line_and_leaves_whole_poses(recording, pipelines, tmp_path, capsys, name):
    out = tmp_path / "out"
    with files_of_at_most(20_000):
        assert main(words(name, recording, out)) == 2
    told = capsys.readouterr().err
    assert "pose.csv: File too large" in told and "Traceback" not in told
    assert 5 < len(read_csv(out / "pose.csv")[0]) < SETS
    assert main(words(name, recording, out)) == 0
    assert len(read_trc(out / "pose.trc")[0]) == SETS


def test_frames_are_let_go(recording, pipelines, monkeypatch, tmp_path):
    """Of a recording of any length so many are held at a time."""
    source = open_source(recording)
    alive, counted, most, read = weakref.WeakValueDictionary(), itertools.count(), 0, type(source).__iter__

    def frames(self):
        nonlocal most
        for each in read(self):
            for view in each.views:
                alive[next(counted)] = view.depth_m
            most = max(most, len(alive))
            yield each

    monkeypatch.setattr(type(source), "__iter__", frames)
    settings = offline.RunSettings(recording, tmp_path / "out", report=False)
    assert offline.run(settings, Console(quiet=True)).summary["frames"] == SETS
    assert next(counted) > 2 * SETS
    assert 0 < most <= 12
