"""Commands whose streams are closed, full or of another encoding, and names and paths of any kind."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from file_contents import tree

from depthmocap.cli import main
from depthmocap.core.standard_streams import FaultTolerantStream
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording_writer import RecordingWriter

SETS = 3
NAMES = ("Küche", "b")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in a folder whose name is no UTF-8, where the file system has such names."""
    folder = tmp_path_factory.mktemp("streams") / os.fsdecode(b"caf\xe9")
    try:
        folder.mkdir()
    except (OSError, UnicodeError):
        folder = folder.with_name("cafe")
    pose = np.eye(4)
    pose[2, 3] = 1.0
    rig = Rig(tuple(DepthCamera(name, 8, 6, 8.0, 8.0, 4.0, 3.0, pose) for name in NAMES))
    with RecordingWriter(folder / "take", rig) as writer:
        for i in range(SETS):
            frames = {name: np.arange(48, dtype=np.uint16).reshape(6, 8) + 1000 + 7 * i for name in NAMES}
            writer.write(1_700_000_000_000_000_000 + i * 40_000_000, frames)
    return folder / "take"


@pytest.fixture
def full() -> Iterator[io.TextIOWrapper]:
    """A file that nothing can be written to."""
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with open("/dev/full", "w", encoding="utf-8") as file:  # noqa: PTH123 - of the type of the standard streams
        yield file


def test_full_streams_end_no_recording(recording: Path, full: io.TextIOWrapper, tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("foxglove")
    monkeypatch.setattr(sys, "stderr", full)
    assert main(["record", str(recording), "--out", str(tmp_path / "take.mcap")]) == 0
    assert len(open_recording(tmp_path / "take.mcap")) == SETS


def test_output_that_is_lost_is_told(recording: Path, full: io.TextIOWrapper, capsys, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stdout", full)
    assert main(["info", str(recording)]) == 1
    assert capsys.readouterr().err == "error: cannot write to the standard output: No space left on device\n"


def test_a_reader_who_left_is_not_told(recording: Path, capsys, monkeypatch) -> None:
    there, here = os.pipe()
    os.close(there)
    with os.fdopen(here, "w", encoding="utf-8") as file:
        monkeypatch.setattr(sys, "stdout", file)
        assert main(["info", str(recording)]) == 1
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")
def test_closed_streams_do_not_get_into_a_recording(recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    out = tmp_path / "take.mcap"
    command = [sys.executable, "-m", "depthmocap.cli", "record", str(recording), "--out", str(out)]
    subprocess.run(["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *command], check=True)
    assert len(open_recording(out)) == SETS and open_recording(out).complete


def test_any_name_in_any_locale(recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    code = (
        "import sys\n"
        "from depthmocap.cli import main\n"
        "assert main(['info', sys.argv[1]]) == 0\n"
        "assert main(['convert', sys.argv[1], 'take.mcap']) == 0\n"
        "assert main(['convert', 'take.mcap', 'again']) == 0\n"
    )
    plain = {
        "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii", "COLUMNS": "200",
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", code, str(recording)], env=os.environ | plain, cwd=tmp_path, check=False,
        capture_output=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert rb"K\xfcche" in done.stdout
    assert tree(tmp_path / "again") == tree(recording)


def test_letters_that_the_encoding_lacks() -> None:
    data = io.BytesIO()
    stream = FaultTolerantStream(io.TextIOWrapper(data, encoding="latin-1"))
    assert stream.write("• Küche \udcff") == 9
    stream.flush()
    assert data.getvalue() == b"\\u2022 K\xfcche \\udcff"
    assert stream.failure is None and stream.status() == 0


def test_a_stream_that_is_closed_here() -> None:
    file = io.StringIO()
    stream = FaultTolerantStream(file)
    file.close()
    assert stream.write("gone") == 4 and stream.status() == 1
