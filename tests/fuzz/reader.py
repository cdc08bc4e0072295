"""What a reader of files that users give is, and what the inputs of many have in common."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from depthmocap.geometry import DepthCamera, Rig, look_at

START, PERIOD = 1_700_000_000_000_000_000, 33_000_000


@dataclasses.dataclass(frozen=True)
class Reader:
    """How to read, and what.

    Attributes:
        make: writes a whole input into an empty folder.
        read: reads what is in the folder; raises InputError for what it cannot.
        only: files that are spoilt: those with any of these in their name.
        needs: packages of extras.
    """

    make: Callable[[Path], None]
    read: Callable[[Path], object]
    only: tuple[str, ...] = ("",)
    needs: tuple[str, ...] = ()


def make_rig() -> Rig:
    """Two cameras of different sizes, one with a lens that distorts."""
    pose = look_at(np.array([0.1, -3.0, 1.3]), np.array([0.0, 0.0, 1.0]))
    lens = (0.1, -0.2, 1e-3, 2e-3, 0.05)
    left = DepthCamera("left", 40, 24, 30.1, 31.2, 19.3, 12.1, pose, lens, 0.00025)
    return Rig((left, DepthCamera("right", 32, 16, 33.3, 30.0, 16.0, 8.0, pose)), "y")


def depth_of(camera: DepthCamera, seed: int) -> np.ndarray:
    """A picture of noise, in the camera's units."""
    rng = np.random.default_rng(seed)
    return rng.integers(2000, 9000, (camera.height, camera.width)).astype(np.uint16)


def read_all(frames: Any) -> None:
    """Read every frame of a set, and its problems."""
    for _ in frames:
        pass
    assert all(isinstance(problem, str) for problem in frames.problems)


def either(call: Callable[[], object]) -> None:
    """An input that is refused must not keep the next from being read."""
    from depthmocap.errors import InputError

    try:
        call()
    except InputError as error:
        check_message(str(error))


def check_message(text: str) -> None:
    """An error is one line of bounded length that a terminal shows as it is."""
    assert 0 < len(text) <= 300 and text.isprintable(), f"an error of another form than one line: {text[:300]!r}"
