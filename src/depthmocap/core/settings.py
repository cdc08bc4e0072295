"""Settings as plain values, for the settings.json that every run leaves beside its results."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from depthmocap.core.output import write_file
from depthmocap.core.reading.json_text import read_json
from depthmocap.errors import InputError


def plain_settings(settings: Any) -> dict[str, Any]:
    """The fields of a settings dataclass, and of those in it, as JSON can hold them: paths become strings."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: plain(each) for name, each in value.items()}
        if isinstance(value, tuple):
            return tuple(plain(each) for each in value)
        return str(value) if isinstance(value, Path) else value

    return plain(dataclasses.asdict(settings))


def check_seed(seed: int) -> None:
    """Raise InputError unless generators can be made from a seed."""
    if seed < 0:
        raise InputError(f"--seed must be at least 0, got {seed}")


def check_above_0(numbers: Mapping[str, float | None]) -> None:
    """Raise InputError unless numbers, by option, are finite and above 0; None is left out."""
    for option, value in numbers.items():
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{option} must be finite and above 0, got {value}")


def check_at_least(least: int, numbers: Mapping[str, float | None]) -> None:
    """Raise InputError unless numbers, by option, are finite and at least so much; None is left out."""
    for option, value in numbers.items():
        if value is not None and not least <= value < math.inf:
            raise InputError(f"{option} must be finite and at least {least}, got {value}")


def read_settings(path: Path, what: str) -> dict[str, Any]:
    """The settings that a command left beside its results.

    Args:
        what: the folder holds, for the message.

    Raises:
        InputError: when the file cannot be read or holds something else.
    """
    way_out = "choose another --out, or remove its folder"
    try:
        settings = read_json(path)
    except InputError as error:
        raise InputError(f"{error}: {way_out}") from None
    if not isinstance(settings, dict):
        raise InputError(f"{path} does not hold the settings of {what}: {way_out}")
    return settings


def claim_folder(folder: Path, settings: Any, what: str, free: Collection[str]) -> None:
    """Write settings.json into a folder that a command fills, or compare with what is there, so that what is run again
    goes on with the same.

    Args:
        what: what the folder holds, for the message.
        free: settings that may change.

    Raises:
        InputError: when the folder holds something of other settings.
    """
    mine = json.loads(json.dumps(plain_settings(settings)))  # which has lists for tuples
    path = folder / "settings.json"
    if path.exists():
        theirs = read_settings(path, what)
        differ = [name for name, value in mine.items() if name not in free and theirs.get(name) != value]
        if differ:
            options = ", ".join(f"--{name.replace('_', '-')} {theirs.get(name)}" for name in differ)
            raise InputError(f"{folder} holds {what} with {options}: use the same, or another --out")
    write_file(path, json.dumps(mine, indent=1) + "\n")
