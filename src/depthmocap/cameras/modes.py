"""The mode that a camera is asked for: what a user types after ``?``, as in ``azure:SERIAL?mode=nfov&fps=15``."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Sequence

from depthmocap.cameras.source import MisfitError
from depthmocap.errors import InputError

#: The size and rate that cameras with several are asked for where the user says nothing, as near as they have it.
SIZE, FPS = (640, 480), 30
#: What can be asked for, and the form of its value.
_FORMS = {"mode": r"[\w.-]+", "size": r"[1-9]\d{0,4}[x×][1-9]\d{0,4}", "fps": r"[1-9]\d{0,2}"}


@dataclasses.dataclass(frozen=True)
class Mode:
    """One of the ways in which a camera delivers: pixels, frames a second, and what its maker calls it."""

    width: int
    height: int
    fps: int
    name: str = ""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What the user asks of a camera's mode; what is not asked for is left to ``choose``."""

    name: str = ""
    size: tuple[int, int] | None = None
    fps: int | None = None

    @classmethod
    def parse(cls, spec: str, asked: str) -> Wanted:
        """What stands after the ``?`` of a spec.

        Raises:
            InputError: when it is not of the form ``mode=NAME&size=WIDTHxHEIGHT&fps=NUMBER``, or parts of it.
        """
        found: dict[str, str] = {}
        for part in asked.split("&"):
            key, _, value = part.partition("=")
            if key in found or not re.fullmatch(_FORMS.get(key, r"(?!)"), value):
                raise InputError(
                    f"{spec}: after the ? stand mode=NAME, size=WIDTHxHEIGHT or fps=NUMBER, or several of them "
                    f"joined by &, got {part!r}"
                )
            found[key] = value
        width, _, height = found.get("size", "").replace("×", "x").partition("x")
        return cls(
            found.get("mode", ""), (int(width), int(height)) if width else None,
            int(found["fps"]) if "fps" in found else None,
        )  # fmt: skip

    def choose(self, camera: str, modes: Sequence[Mode], usual: tuple[int, int] = SIZE, usual_fps: int = FPS) -> int:
        """Which of a camera's modes is asked for; of several the nearest to the usual size, then to the usual rate.

        Raises:
            MisfitError: when it has none such; the message lists what it has.
        """
        left, given = list(range(len(modes))), ""
        for what, asked, of in (
            ("mode", self.name, lambda mode: mode.name),
            ("size", self.size, lambda mode: (mode.width, mode.height)),
            ("fps", self.fps, lambda mode: mode.fps),
        ):
            if not asked:
                continue
            fit = [index for index in left if of(modes[index]) == asked]
            if not fit:
                raise MisfitError(
                    f"camera {camera!r} has no {what}={_text(asked)}{given and f' with {given[1:]}'}: it has "
                    f"{_listed(of(modes[index]) for index in left) or 'no modes with names'}"
                )
            left, given = fit, f"{given}&{what}={_text(asked)}"

        def distance(index: int) -> tuple[int, int]:
            mode = modes[index]
            return abs(mode.width - usual[0]) + abs(mode.height - usual[1]), abs(mode.fps - usual_fps)

        return min(left, key=distance)


def _text(value: object) -> str:
    return f"{value[0]}x{value[1]}" if isinstance(value, tuple) else str(value)


def _listed(values: Iterable[object]) -> str:
    """Each of them once, in order, as a user types them."""
    return ", ".join(_text(value) for value in sorted({value for value in values if value}))  # type: ignore[type-var]
