"""A measurement of the tables of results: a command, whose numbers are kept as JSON."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import tyro

from depthmocap.errors import InputError

ROOT = Path(__file__).parents[1]


@dataclasses.dataclass(frozen=True)
class Scale:
    """How much is measured.

    Attributes:
        samples: postures of each ordinary set.
        rare: postures of each set of rare ones.
        hard: postures of ``hard``.
        rooms: furnished rooms without anybody.
        meetings: scenes of two people.
        sequences: of moving people.
        minutes: of the long live run; the short one takes a third.
        quick: few sets, scenes and repetitions of everything.
    """

    samples: int = 200
    rare: int = 60
    hard: int = 500
    rooms: int = 60
    meetings: int = 6
    sequences: int = 6
    minutes: float = 30.0
    quick: tyro.conf.Suppress[bool] = False


QUICK = Scale(samples=2, rare=1, hard=2, rooms=1, meetings=1, sequences=1, minutes=0.3, quick=True)


@dataclasses.dataclass(frozen=True)
class Measurement:
    """A command of ``depthmocap``, or a script of ``benchmarks``.

    Attributes:
        words: its arguments, the name of a script (.py) first; ``{folder}`` is a folder of its own and ``{out}`` that
            of all measurements.
        numbers: file in its own folder with its numbers; without a name ``--json`` writes them. None: it has none, and
            others read what it makes.
        cores: how many it may use, where the system can tell a process so; by default all.
    """

    words: tuple[str, ...]
    numbers: str | None = ""
    cores: int | None = None

    def read(self, name: str, out: Path) -> Any:
        """The numbers, measured unless they are there.

        Raises:
            InputError: when the command fails.
        """
        path, folder = out / f"{name}.json", out / name
        if not path.exists():
            words = [word.format(folder=folder, out=out) for word in self.words]
            self._run([*words, "--json", str(path)] if self.numbers == "" else words)
            if self.numbers:
                shutil.copy(folder / self.numbers, path)
            elif self.numbers is None:
                path.write_text("null\n", encoding="utf-8")
        return json.loads(path.read_text(encoding="utf-8"))

    def _run(self, words: list[str]) -> None:
        print("depthmocap" if not words[0].endswith(".py") else "python", *words, flush=True)
        program = (
            [str(ROOT / "benchmarks" / words[0])] if words[0].endswith(".py") else ["-m", "depthmocap.cli", words[0]]
        )
        allowed = os.sched_getaffinity(0) if self.cores and hasattr(os, "sched_getaffinity") else None
        try:
            if allowed:  # what a process may use is what it hands to those that it starts
                os.sched_setaffinity(0, sorted(allowed)[-(self.cores or 0) :])
            failed = subprocess.run([sys.executable, *program, *words[1:]], check=False).returncode
        finally:
            if allowed:
                os.sched_setaffinity(0, allowed)
        if failed:
            raise InputError(f"{' '.join(words[:2])} failed: see above")


def share(value: float, digits: int = 1) -> str:
    """A share (0–1) as a percentage."""
    return f"{100 * value:.{digits}f} %"
