"""A folder or file of results belongs to one process at a time, and files are there whole or not at all."""

from __future__ import annotations

import dataclasses
import errno
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from depthmocap.commands import COMMANDS
from depthmocap.core.locks import lock_file, lock_folder, locks_outputs
from depthmocap.core.output import atomic_write, remove_unfinished, write_file
from depthmocap.errors import InputError

HOLD = """
import sys, time
from pathlib import Path
from depthmocap.core.locks import lock_folder
with lock_folder(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_folder_is_one_processs_until_it_dies(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "out"
    with subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(InputError, match=rf"out is being written by process {other.pid} on .*: wait for it"):
            lock_folder(folder).__enter__()
        assert (folder / ".lock").exists()  # who was refused has not removed it
        other.kill()
    assert (folder / ".lock").exists()
    (folder / ".pose.part-123.csv").touch()  # as a killed process leaves
    with lock_folder(folder):
        assert [path.name for path in folder.iterdir()] == [".lock"]
        with pytest.raises(InputError, match=f"by process {os.getpid()} on"), lock_folder(folder):
            pass
    assert list((tmp_path / "new").iterdir()) == [folder]  # it was there before
    with lock_folder(tmp_path / "second"):
        pass
    assert not (tmp_path / "second").exists()


def test_a_lock_is_no_way_to_another_file(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("kept")
    for make in (Path.symlink_to, Path.hardlink_to):
        folder = tmp_path / make.__name__
        folder.mkdir()
        make(folder / ".lock", precious)
        with pytest.raises(InputError, match=r"\.lock is a link or no file.*remove it"), lock_folder(folder):
            pass
        assert precious.read_text() == "kept"
    for name in ("mkdir", "mkfifo"):
        if not hasattr(os, name):  # Windows has no pipes of that kind
            continue
        folder = tmp_path / name
        folder.mkdir()
        getattr(os, name)(folder / ".lock")
        with pytest.raises(InputError, match="is a link or no file"), lock_folder(folder):
            pass
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write"), lock_folder(tmp_path / "file"):
        pass


@dataclasses.dataclass(frozen=True)
class _Settings:
    out: Path
    json: Path | None = None


def test_a_command_owns_what_its_settings_name(tmp_path: Path) -> None:
    settings = _Settings(tmp_path / "out", tmp_path / "a.json")

    @locks_outputs(folder="out", files=("json",))
    def command(settings: _Settings, more: int = 0) -> int:
        for taken in (lock_folder(settings.out), lock_file(tmp_path / "a.json")):
            with pytest.raises(InputError, match="is being written"), taken:
                pass
        with lock_file(tmp_path / "b.json"):  # of the same folder, which nobody locks_outputs
            return more

    assert command(settings, more=2) == 2
    assert list(tmp_path.iterdir()) == []


def test_every_command_owns_what_it_writes() -> None:
    pytest.importorskip("torch")
    pytest.importorskip("anny")
    # New files alone; a recording folder, which its writer locks_outputs; a folder for each split.
    otherwise = {"record", "recover", "convert", "synth"}
    for command in COMMANDS:
        module = importlib.import_module(command.module)
        names = {field.name for field in dataclasses.fields(getattr(module, command.settings))}
        if names & {"out", "json", "report", "csv"} and command.words not in otherwise | {"demo"}:  # demo runs run
            assert hasattr(getattr(module, command.function), "__wrapped__"), command.words


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "Küche.json"
    write_file(path, "grün\n")
    assert path.read_bytes() == "grün\n".encode()
    with (
        pytest.raises(InputError, match=r"cannot write .*Küche\.json: No space left"),
        atomic_write(path) as unfinished,
    ):
        assert unfinished.suffix == ".json"
        unfinished.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert [(each.name, each.read_text(encoding="utf-8")) for each in path.parent.iterdir()] == [(path.name, "grün\n")]
    precious = tmp_path / "precious"
    precious.write_text("kept")
    (tmp_path / "link").symlink_to(precious)
    (tmp_path / f".link.part-{os.getpid()}").symlink_to(precious)
    write_file(tmp_path / "link", b"mine")
    assert (precious.read_text(), (tmp_path / "link").read_bytes()) == ("kept", b"mine")
    if Path("/dev/null").exists():
        with pytest.raises(InputError, match="/dev/null: it is no file"):
            write_file(Path("/dev/null"), "")
    for name in (".a.part-1.json", ".b.part-22", ".c.part", "d.part-1", ".e.json"):
        (tmp_path / name).touch()
    remove_unfinished(tmp_path, tmp_path / "a.json")
    assert not (tmp_path / ".a.part-1.json").exists() and (tmp_path / ".b.part-22").exists()
    remove_unfinished(tmp_path)
    left = {each.name for each in tmp_path.iterdir()}
    assert left == {".c.part", "d.part-1", ".e.json", "folder", "precious", "link"}
