"""Completion of commands and options, in real shells."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from depthmocap.cli import main
from depthmocap.commands import COMMANDS
from depthmocap.completion import completion_script, options

CASES = {
    "depthmocap rec": {"record", "recover"},
    "depthmocap postures ": {"build", "report"},
    "depthmocap run take --smooth k": {"kalman"},
    "depthmocap evaluate recording --least": set(),
    "depthmocap evaluate recording --peo": {"--people"},
    "depthmocap --print-completion ": {"bash", "zsh"},
}
#: The same variables that a shell sets when somebody asks for completion.
ASK = '_depthmocap; echo "${COMPREPLY[*]}"'


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_words_are_completed(shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell}")
    script = completion_script("bash")
    if shell == "zsh":  # as its module for bash's functions runs them
        script = f'setopt ksh_arrays sh_word_split\ncompgen() {{ bash -c \'compgen "$@"\' _ "$@"; }}\n{script}'
        script = script.replace("complete -F _depthmocap depthmocap\n", "")
    for line in CASES:
        words = line.split(" ")
        quoted = " ".join(f"'{word}'" for word in words)
        script += f"COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; COMPREPLY=(); {ASK}\n"
    done = subprocess.run([shell, "-c", script], capture_output=True, text=True, check=True)
    answers = [set(line.split()) for line in done.stdout.splitlines()]
    assert dict(zip(CASES, answers, strict=True)) == CASES
    assert not done.stderr


@pytest.mark.parametrize("words", ["run", "live", "label", "evaluate recording", "calibrate"])
def test_options_are_those_of_help(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    (command,) = (command for command in COMMANDS if command.words == words)
    with pytest.raises(SystemExit):
        main([*words.split(), "--help"])
    told = set(re.findall(r"--[a-z0-9][a-z0-9.-]*", capsys.readouterr().out.split("options")[1]))
    assert {option.name for option in options(command.load()[0])} <= told | {"--none"}


def test_options_of_dataclasses_within_have_no_prefix() -> None:
    pytest.importorskip("torch")
    (command,) = (command for command in COMMANDS if command.words == "synth")
    names = {option.name for option in options(command.load()[0])}
    assert {"--subset", "--distance-m", "--samples"} <= names and not any("." in name for name in names)


def test_another_shell_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--print-completion", "fish"]) == 2
    assert "takes one of bash, zsh" in capsys.readouterr().err
