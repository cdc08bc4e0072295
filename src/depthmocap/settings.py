"""Settings as plain values, for the settings.json that every run leaves beside its results."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from depthmocap.errors import InputError


def plain_settings(settings: Any) -> dict[str, Any]:
    """The fields of a settings dataclass, and of those in it, as JSON can hold them: paths become strings."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: plain(each) for name, each in value.items()}
        return str(value) if isinstance(value, Path) else value

    return plain(dataclasses.asdict(settings))


def check_seed(seed: int) -> None:
    """Raise InputError unless generators can be made from a seed."""
    if seed < 0:
        raise InputError(f"--seed must be at least 0, got {seed}")
