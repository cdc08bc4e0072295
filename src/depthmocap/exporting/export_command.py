"""``depthmocap export``: the results of a take as files for other tools."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import make_inner_folder, write_json
from depthmocap.core.version import __version__
from depthmocap.errors import InputError
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.edits import TakeMarker
from depthmocap.exporting.exported_take import ExportedTake, exported_take
from depthmocap.exporting.file_formats import FORMATS, check_formats
from depthmocap.exporting.file_settings import FileSettings, FormatName
from depthmocap.exporting.gap_filling import METHOD
from depthmocap.exporting.result_files import WRITTEN_FORMATS
from depthmocap.exporting.stored_result import StoredPerson, StoredResult, read_result
from depthmocap.exporting.summary import frame_ranges

#: Version of the keys of export.json; it increases when a key is removed or changes its meaning.
SCHEMA = 1
EXPORT_FILE = "export.json"


@dataclasses.dataclass(frozen=True)
class ExportSettings(FileSettings):
    """Files for other tools, of a take that ``run`` or ``live`` made.

    The files are those that ``run`` and ``live`` write by the same options, with the corrections that were made in
    ``view``. export.json tells which joints were filled, and which were held.

    Attributes:
        result: the folder of results.
        out: another folder, for the files.
        formats: of the files: csv, trc, bvh, npz, osim (OpenSim's model) and mot (its inverse kinematics) for every
            person; c3d, glb, usd and fbx with everybody in one file.
        least_confidence: joints below it are gaps in csv, trc, c3d and npz, and are held in bvh, glb, usd and fbx.
    """

    result: tyro.conf.Positional[Path]
    out: Path
    formats: tuple[FormatName, ...] = dataclasses.field(kw_only=True)


@locks_outputs(folder="out")
def export(settings: ExportSettings, console: Console | None = None) -> list[Path]:
    """Write the files; returns their paths.

    Raises:
        InputError: when the results cannot be read, a package is missing, or a file cannot be written.
    """
    console = console or Terminal(stderr=True)
    settings.check()
    check_formats(settings.formats)
    if not settings.result.is_dir():
        raise InputError(
            f"{settings.result} is no folder of results: name one that depthmocap run or live wrote (--out)"
        )
    if settings.out.resolve() == settings.result.resolve():
        raise InputError(f"--out must not be the folder of the results, got {settings.out}: choose another name")
    with console.status("reading the results"):
        result = read_result(settings.result)
    with console.status("writing"):
        paths = write_formats(result, settings, settings.formats, settings.out)
    console.print(f"{len(paths)} files written to {settings.out}")
    return paths


def write_formats(result: StoredResult, settings: FileSettings, formats: Sequence[FormatName], out: Path) -> list[Path]:
    """Write a take's files of some formats into a folder, and export.json; returns their paths.

    Where several people were followed, each has a folder for the formats of one person. A person without a sure joint
    is left out.

    Raises:
        InputError: when a file cannot be written, or nobody has a sure joint.
    """
    take = exported_take(result)
    people, unsure = [], None
    for person in take.people:
        try:
            take.rows(person, settings.least_confidence)
            people.append(person)
        except InputError as error:
            unsure = error
    if not people:
        raise unsure or InputError(f"{result.folder}: nobody is left after the corrections in edits.json")
    take = dataclasses.replace(take, people=tuple(people))
    paths: list[Path] = []
    told: dict[int, dict[str, Any]] = {person.number: {} for person in people}
    for name in formats:
        file_format = FORMATS[name]
        file_name = file_format.name or f"pose.{name}"
        if file_format.together:
            paths.append(out / file_name)
            file_format.write(paths[-1], take, settings)
            continue
        for person in people:
            folder = out / f"person-{person.number}" if take.several else out
            if take.several:
                make_inner_folder(folder)
            paths.append(folder / file_name)
            lines = file_format.write(paths[-1], take.of(person), settings)
            if lines is not None:
                told[person.number][name] = lines
    document = {
        "schema": SCHEMA,
        "version": __version__,
        "result": str(result.folder),
        "sources": result.summary["sources"] if result.summary else [],
        "take": result.name,
        "first_timestamp_ns": take.origin_ns,
        "up": take.up,
        "corrections": len(result.edits.edits),
        "markers": [{"time_s": time_s, "text": text} for time_s, text in take.markers],
        "settings": {field.name: getattr(settings, field.name) for field in dataclasses.fields(FileSettings)},
        "filled_by": METHOD if settings.fill_s else None,
        "files": [path.relative_to(out).as_posix() for path in paths],
        "people": [{**_person_entry(take, person, settings), **told[person.number]} for person in people],
    }
    write_json(out / EXPORT_FILE, document)
    return paths


def write_more_formats(settings: FileSettings, folder: Path, markers: Sequence[TakeMarker] = ()) -> list[str]:
    """Write the formats of a new take that are not yet in its folder; returns problems, one line each, for the take
    itself is there in any case. CSV adds columns to pose.csv, in which all joints stay as they were measured.

    Args:
        markers: instants that were named while the take was made.
    """
    formats: list[FormatName] = [name for name in settings.formats if name not in WRITTEN_FORMATS]
    if not formats and not settings.fill_s:
        return []
    try:
        with deferred_interrupts():
            result = read_result(folder, edited=False)
            result = result.edited(dataclasses.replace(result.edits, markers=tuple(markers)))
            if "csv" in formats:
                everything = dataclasses.replace(settings, least_confidence=0.0, fill_s=0.0)
                write_formats(result, everything, ["csv"], folder)
            write_formats(result, settings, [name for name in formats if name != "csv"], folder)
    except InputError as error:
        return [str(error)]
    return []


def _person_entry(take: ExportedTake, person: StoredPerson, settings: FileSettings) -> dict[str, Any]:
    """What was filled and held of a person, by ranges of its poses."""
    motion = solve_body(take.rows(person, settings.least_confidence), settings.fill_s)

    def ranges(mask: Any) -> dict[str, list[list[int]]]:
        by_joint = {joint: frame_ranges(mask[:, i]) for i, joint in enumerate(JOINTS)}
        return {joint: stretches for joint, stretches in by_joint.items() if stretches}

    return {
        "person": person.number,
        "name": take.name(person),
        "frames": len(motion.times_s),
        "filled": ranges(motion.filled),
        "held": ranges(motion.held),
    }
