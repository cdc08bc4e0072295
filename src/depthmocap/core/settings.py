"""Settings as plain values, for the settings.json that every run writes beside its results."""

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
    """The fields of a settings dataclass, also nested ones, as JSON values: paths become strings."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: plain(item) for name, item in value.items()}
        if isinstance(value, tuple):
            return tuple(plain(item) for item in value)
        return str(value) if isinstance(value, Path) else value

    return plain(dataclasses.asdict(settings))


def check_seed(seed: int) -> None:
    """Raise InputError unless the seed is valid for random generators."""
    if seed < 0:
        raise InputError(f"--seed must be at least 0, got {seed}")


def check_above_0(numbers: Mapping[str, int | float | None]) -> None:
    """Raise InputError unless all numbers, by option, are finite and above 0; None is ignored."""
    for option, value in numbers.items():
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{option} must be finite and above 0, got {value}")


def check_at_least(least: int, numbers: Mapping[str, int | float | None]) -> None:
    """Raise InputError unless all numbers, by option, are finite and at least ``least``; None is ignored."""
    for option, value in numbers.items():
        if value is not None and not least <= value < math.inf:
            raise InputError(f"{option} must be finite and at least {least}, got {value}")


def read_settings(path: Path, what: str) -> dict[str, Any]:
    """Read the settings that a command has written beside its results.

    Args:
        what: the contents of the folder, for the message.

    Raises:
        InputError: when the file cannot be read or holds something else.
    """
    remedy = "choose another --out, or remove its folder"
    try:
        settings = read_json(path)
    except InputError as error:
        raise InputError(f"{error}: {remedy}") from None
    if not isinstance(settings, dict):
        raise InputError(f"{path} does not hold the settings of {what}: {remedy}")
    return settings


def claim_folder(folder: Path, settings: Any, what: str, free: Collection[str]) -> None:
    """Write settings.json into the folder of a command, or compare it with the existing one, so that a command that is
    run again continues with the same settings.

    Args:
        what: the contents of the folder, for the message.
        free: settings that may change.

    Raises:
        InputError: when the folder was made with other settings.
    """
    current = json.loads(json.dumps(plain_settings(settings)))  # JSON has lists in place of tuples
    path = folder / "settings.json"
    if path.exists():
        stored = read_settings(path, what)
        differ = [name for name, value in current.items() if name not in free and stored.get(name) != value]
        if differ:
            options = ", ".join(f"--{name.replace('_', '-')} {stored.get(name)}" for name in differ)
            raise InputError(f"{folder} holds {what} with {options}: use the same, or another --out")
    write_file(path, json.dumps(current, indent=1) + "\n")
