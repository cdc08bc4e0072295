"""``depthmocap info``: what is in a recording, and with ``--check`` what is wrong with its cameras."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.recordings.convert import recording_info
from depthmocap.recordings.open_recording import open_recording
from depthmocap.text import offset_lines


@dataclasses.dataclass(frozen=True)
class InfoSettings(NetworkSettings):
    """What is in a recording.

    Attributes:
        recording: a recording folder or an MCAP file.
        check: look for people in up to 200 frames of each camera, and tell by them which depth unit, picture or pose of
            a camera is wrong.
    """

    recording: tyro.conf.Positional[Path]
    check: bool = False


def info(settings: InfoSettings, console: Console | None = None) -> dict[str, Any]:
    """Print what is in a recording.

    Raises:
        InputError: when the path is no recording.
    """
    console = console or Terminal()
    recording = open_recording(settings.recording)
    summary = recording_info(recording)
    table = Table(title=summary["recording"], title_justify="left")
    for column in ("camera", "size", "frames", "a second", "lost", "depth unit", "clock", "background"):
        table.add_column(column)
    for name, camera in summary["cameras"].items():
        rate = camera["frames_per_second"]
        table.add_row(
            name, "×".join(map(str, camera["size"])), str(camera["frames"]), "" if rate is None else f"{rate:.2f}",
            str(camera["lost"]), f"{camera['depth_unit_m'] * 1e3:g} mm", camera["clock"] or "",
            "yes" if camera["background"] else "no",
        )  # fmt: skip
    console.print(table)
    console.print(
        f"{summary['sets']} sets in {summary['seconds']:.1f} s, {summary['megabytes']:.1f} MB, "
        f"{summary['compression']:.2f}:1, up is {summary['up']}, {summary['true_joints']} true poses"
    )
    for line in offset_lines({name: camera["time_offset_s"] for name, camera in summary["cameras"].items()}):
        console.print(line)
    for problem in summary["problems"]:
        console.print(f"• {problem}")
    if settings.check:
        from depthmocap.calibration.recording_check import MOST_SETS, check_recording  # which takes a while to load

        with networks_on(settings.device) as devices:
            problems = check_recording(recording, console)
        for line in devices.lines():
            console.print(f"• {line}")
        summary["check"] = dataclasses.asdict(problems)
        seen = ", ".join(f"{name!r} in {seen} of {frames}" for name, (seen, frames) in problems.frames.items())
        console.print(f"checked in up to {MOST_SETS} frames of each camera; people are found by {seen}")
        for line in problems.faults:
            console.print(f"wrong: {line}")
        if not problems.faults:
            console.print("nothing wrong is found with depth units, pictures and poses")
        for line in problems.unknown:
            console.print(f"not known: {line}")
    return summary
