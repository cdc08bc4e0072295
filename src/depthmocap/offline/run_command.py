"""``depthmocap run`` of one recording or many, each into a folder of its own; what is done is not done again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import tyro
from rich.console import Console

from depthmocap.core.console import Terminal
from depthmocap.core.locks import lock_folder
from depthmocap.core.output import write_json
from depthmocap.core.reading.json_text import read_json
from depthmocap.core.settings import plain_settings
from depthmocap.core.version import __version__
from depthmocap.errors import InputError
from depthmocap.exporting.run_result import RunResult
from depthmocap.exporting.summary import SUMMARY_FILE, read_summary
from depthmocap.offline.run import RunSettings, run

#: What tells that a recording's folder is complete, and what it was made from.
DONE_FILE = "run.json"


@dataclasses.dataclass(frozen=True)
class RunCommand(RunSettings):
    """Motion capture of one recording, or of several.

    Where several people are followed, each has a folder ``person-N`` besides, and the files of ``out`` are of the one
    who was followed first.

    Attributes:
        out: folder for pose.csv, files of other formats, summary.json and report.html; of several recordings each has a
            folder of its name in it, and those that are there already, made from the same by the same settings, stay.
        more: other recordings.
    """

    more: tyro.conf.Positional[tuple[Path, ...]] = ()


def run_all(settings: RunCommand, console: Console | None = None) -> list[RunResult]:
    """Process all recordings. One that cannot be processed is told, and the others are done.

    Raises:
        InputError: when a recording could not be processed, at the end.
        KeyboardInterrupt: when one of several was interrupted; what was done of it is written.
    """
    console = console or Terminal(stderr=True)
    if not settings.more:
        return [run(_single(settings, settings.recording, settings.out), console)]
    results, failed = [], []
    with lock_folder(settings.out):
        for name, recording in _named([settings.recording, *settings.more]).items():
            single = _single(settings, recording, settings.out / name)
            try:
                key = _key(single)
                if (done := _done(single, key)) is not None:
                    console.print(f"{name}: done before")
                    results.append(done)
                    continue
                console.print(f"{name}:")
                (single.out / DONE_FILE).unlink(missing_ok=True)
                result = run(single, console)
            except InputError as error:
                console.print(f"{name}: {error}")
                failed.append((name, error))
                continue
            if result.summary["interrupted"]:
                raise KeyboardInterrupt
            write_json(single.out / DONE_FILE, {"key": key, "version": __version__, "recording": str(recording)})
            results.append(result)
    if failed:
        name, error = failed[0]
        count = len(results) + len(failed)
        raise InputError(
            f"{len(failed)} of {count} recordings could not be processed, the others were: {name}: {error}"
        )
    return results


def _single(settings: RunCommand, recording: Path, out: Path) -> RunSettings:
    fields = {field.name: getattr(settings, field.name) for field in dataclasses.fields(RunSettings)}
    return RunSettings(**{**fields, "recording": recording, "out": out})


def _named(recordings: list[Path]) -> dict[str, Path]:
    """Recordings by the names of their folders of results: their own, with a number where two are alike."""
    named: dict[str, Path] = {}
    for recording in recordings:
        path = recording.resolve()
        base = (path.stem if path.is_file() else path.name) or "recording"
        name, number = base, 1
        while any(name.casefold() == other.casefold() for other in named):
            number += 1
            name = f"{base}-{number}"
        named[name] = recording
    return named


def _key(settings: RunSettings) -> str:
    """Changes whenever the recording, a file that settings name, a setting or the version does."""
    plain = {name: value for name, value in plain_settings(settings).items() if name != "out"}
    paths = [settings.recording, settings.rig, settings.weights, Path(settings.estimator)]
    parts = [__version__, plain, [_stamp(path) for path in paths if path is not None]]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def _stamp(path: Path) -> list[int]:
    """Number, size and latest change of the files of a path."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else []
    stats = [file.stat() for file in files]
    return [len(stats), sum(stat.st_size for stat in stats), max((stat.st_mtime_ns for stat in stats), default=0)]


def _done(settings: RunSettings, key: str) -> RunResult | None:
    """The results that are there already; None where they are not, or are of something else."""
    try:
        document = read_json(settings.out / DONE_FILE)
        summary = read_summary(settings.out / SUMMARY_FILE)
    except InputError:
        return None
    same = isinstance(document, dict) and document.get("key") == key and summary["sources"] == [str(settings.recording)]
    return RunResult(settings.out, summary) if same and (settings.out / "pose.csv").is_file() else None
