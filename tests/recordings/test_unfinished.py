"""A recording that was not finished is told of, whatever ended it, and a copy is made anew by the same command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

pytest.importorskip("foxglove")
pytest.importorskip("zstandard")

from file_contents import tree
from full_disk import files_of_at_most

from depthmocap.cli import main
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.offline.info_command import InfoSettings, info
from depthmocap.recordings.convert import ConvertSettings, RecoverSettings, convert, recover
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter

QUIET = Console(quiet=True)
CAMERAS = tuple(DepthCamera(name, 24, 16, 20.0, 20.0, 12.0, 8.0) for name in "ab")
SETS = 6


def frame(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(1000, 3000, (16, 24)).astype(np.uint16)


def write_sets(writer: RecordingWriter, sets: int = SETS) -> None:
    for i in range(sets):
        writer.write(10**18 + i * 33_333_333, {"a": frame(i), "b": frame(-i - 1 & 255)}, np.full((18, 3), i + 0.123456))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with RecordingWriter(tmp_path / "take", Rig(CAMERAS), {"a": frame(99)}) as writer:
        write_sets(writer)
    return tmp_path / "take"


KILLED = """
    import io, os, signal, sys
    from pathlib import Path
    from rich.console import Console
    from depthmocap.recordings.convert import ConvertSettings, convert
    from depthmocap.cli import main

    write, written = Path.write_bytes, []

    def half(self, data):
        written.append(self)
        if len(written) == int(moment):
            write(self, bytes(data)[: len(data) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        return write(self, data)

    Path.write_bytes = half
    source, *copies = sys.argv[1:]
    for moment, copy in zip((2, 3, 8), copies):
        written.clear()
        if not os.fork():
            convert(ConvertSettings(Path(source), Path(copy)), Console(quiet=True))
        os.wait()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes of POSIX")
def test_a_killed_copy_is_told_of_and_made_anew(folder: Path, tmp_path: Path) -> None:
    """At the rig, the background and a frame, half of which is in its file."""
    copies = [tmp_path / name for name in ("x", "y", "z")]
    command = [sys.executable, "-c", textwrap.dedent(KILLED), str(folder), *map(str, copies)]
    subprocess.run(command, check=True)
    for copy in copies[:2]:
        with pytest.raises(
            InputError, match=r"is a copy of .*take that was not finished: run depthmocap convert again"
        ):
            Recording(copy)
    found = info(InfoSettings(copies[2]), QUIET)
    assert not found["complete"]
    assert "was not finished" in found["problems"][0]
    assert 0 < sum(camera["frames"] for camera in found["cameras"].values()) < 2 * SETS
    for copy in copies:
        assert convert(ConvertSettings(folder, copy), QUIET)["frames"] == 2 * SETS
        assert tree(copy) == tree(folder)


def test_a_copy_that_met_a_full_disk_or_was_interrupted(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with files_of_at_most(2500), pytest.raises(InputError, match=r"cannot write .*truth\.csv: File too large"):
        convert(ConvertSettings(folder, tmp_path / "copy"), QUIET)
    cut = Recording(tmp_path / "copy")
    assert not cut.complete and 0 < len(cut.truth_rows()) < SETS
    with pytest.raises(InputError, match="exists already"):  # of something else nothing is removed
        convert(ConvertSettings(tmp_path / "copy", tmp_path / "copy"), QUIET)
    (tmp_path / "copy" / "notes.txt").touch()
    with pytest.raises(InputError, match="exists already"):
        convert(ConvertSettings(folder, tmp_path / "copy"), QUIET)
    assert (tmp_path / "copy" / "notes.txt").exists()
    (tmp_path / "copy" / "notes.txt").unlink()

    write = RecordingWriter.write

    def interrupted(self: RecordingWriter, stamp: int, *rest: Any) -> None:
        write(self, stamp, *rest)
        if stamp > 10**18 + 10**8:
            signal.raise_signal(signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(RecordingWriter, "write", interrupted)
        assert main(["convert", str(folder), str(tmp_path / "copy")]) == 143
    assert not Recording(tmp_path / "copy").complete
    convert(ConvertSettings(folder, tmp_path / "copy"), QUIET)
    assert tree(tmp_path / "copy") == tree(folder)


def test_a_new_file_is_whole_or_not_there(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    new, whole = tmp_path / "x.mcap", tmp_path / "whole.mcap"
    convert(ConvertSettings(folder, whole), QUIET)
    size = whole.stat().st_size
    for most in (size // 2, size - 10):  # the second at the file's end
        with files_of_at_most(most), pytest.raises(InputError, match=r"cannot write .*x\.mcap: File too large"):
            convert(ConvertSettings(folder, new), QUIET)
        assert not new.exists()
    with files_of_at_most(size // 2), pytest.raises(InputError, match=r"cannot write .*x\.mcap"):
        recover(RecoverSettings(whole, new), QUIET)

    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("depthmocap.recordings.mcap_writer.McapWriter.write_truth", stopped)
    with pytest.raises(KeyboardInterrupt):
        convert(ConvertSettings(folder, new), QUIET)
    assert not new.exists()
    with pytest.raises(InputError, match="exists already"):  # and what was there stays
        convert(ConvertSettings(folder, whole), QUIET)
    assert whole.stat().st_size == size


def test_a_recording_of_cameras_is_never_begun_anew(tmp_path: Path) -> None:
    rig = Rig(CAMERAS)
    with pytest.raises(KeyboardInterrupt), RecordingWriter(tmp_path / "take", rig) as writer:
        write_sets(writer, 3)
        with pytest.raises(InputError, match=f"take is being written by process {os.getpid()} on"):
            RecordingWriter(tmp_path / "take", rig)
        raise KeyboardInterrupt
    recording = Recording(tmp_path / "take")
    assert len(recording.stamps("a")) == 3
    assert recording.problems == [f"{tmp_path / 'take'} was not finished by who wrote it: what is in it is read"]
    for copy_of in (None, tmp_path / "other"):
        with pytest.raises(InputError, match="exists already"):
            RecordingWriter(tmp_path / "take", rig, copy_of=copy_of)
    assert len(Recording(tmp_path / "take").stamps("a")) == 3
