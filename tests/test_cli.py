"""The command line: help, errors, and that importing the package stays light."""

import subprocess
import sys

import pytest

from depthmocap.cli import main
from depthmocap.commands import Command


def test_help_lists_the_commands(capsys):
    assert main([]) == 0
    printed = capsys.readouterr().out
    for command in ("demo", "run", "label", "synth", "train classifier", "train pose", "evaluate ubc3v"):
        assert f"depthmocap {command}" in printed


def test_help_of_half_a_command_lists_the_commands(capsys):
    for half in ("postures", "train"):
        assert main([half, "--help"]) == 0
        assert f"depthmocap {half} " in capsys.readouterr().out
        assert main([half]) == 2
        assert f"no command '{half}'" in capsys.readouterr().err


def test_unknown_command_is_an_error(capsys):
    assert main(["dance"]) == 2
    assert "no command 'dance'" in capsys.readouterr().err


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == "0.1.0"


def test_importing_is_light():
    code = (
        "import sys, depthmocap, depthmocap.cli\n"
        "heavy = {'torch', 'anny', 'onnxruntime', 'matplotlib', 'scipy', 'numba'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_running_needs_no_torch(tmp_path):
    code = (
        "import sys\n"
        "class Absent:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] in ('torch', 'anny', 'bvhio', 'sklearn', 'onnx', 'safetensors'):\n"
        "            raise ModuleNotFoundError(f'no {name}', name=name)\n"
        "sys.meta_path.insert(0, Absent())\n"
        "import depthmocap.offline.run, depthmocap.offline.demo, depthmocap.offline.label\n"
        "import depthmocap.evaluate.ubc3v_protocol, depthmocap.train.train_pose\n"
        "from depthmocap.cli import main\n"
        f"assert main(['synth', '--out', {str(tmp_path)!r}, '--samples', '1']) == 2\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "depthmocap[train]" in done.stderr


def test_help_that_nobody_reads_to_its_end_is_no_error():
    command = [sys.executable, "-m", "depthmocap.cli", "run", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 1


@pytest.mark.parametrize(
    ("error", "status", "told"),
    [
        (KeyboardInterrupt(), 130, "stopped"),
        (PermissionError(13, "Permission denied", "rig.json"), 2, "rig.json: Permission denied"),
        (OSError("no more"), 2, "no more"),
        (UnicodeEncodeError("ascii", "grün", 2, 3, "ordinal"), 2, "'grün' is no ascii: rename it, or set PYTHONUTF8=1"),
    ],
)
def test_what_ends_a_command_is_one_line(error, status, told, monkeypatch, capsys):
    def load(command):
        raise error

    monkeypatch.setattr(Command, "load", load)
    assert main(["cameras"]) == status
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
