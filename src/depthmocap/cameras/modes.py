"""Modes of cameras, and the mode that a user requests after ``?``, as in ``azure:SERIAL?mode=nfov&fps=15``."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Sequence

from depthmocap.cameras.source import CameraMismatchError
from depthmocap.errors import InputError

#: Width and height in pixels that are chosen, as nearly as a camera has them, if the user requests none.
DEFAULT_SIZE = (640, 480)
#: Frames a second that are chosen, as nearly as a camera has them, if the user requests none.
DEFAULT_FPS = 30
#: The options of a request, and the pattern of their values.
_FORMS = {"mode": r"[\w.-]+", "size": r"[1-9]\d{0,4}[x×][1-9]\d{0,4}", "fps": r"[1-9]\d{0,2}"}


@dataclasses.dataclass(frozen=True)
class Mode:
    """One mode of a camera: width and height in pixels, frames a second, and the maker's name for it."""

    width: int
    height: int
    fps: int
    name: str = ""


@dataclasses.dataclass(frozen=True)
class ModeRequest:
    """The user's request for a camera's mode; ``choose`` fills in what is left open."""

    name: str = ""
    size: tuple[int, int] | None = None
    fps: int | None = None

    @classmethod
    def parse(cls, spec: str, text: str) -> ModeRequest:
        """Read the text after the ``?`` of a camera's spec.

        Raises:
            InputError: when it is not of the form ``mode=NAME&size=WIDTHxHEIGHT&fps=NUMBER``, or parts of it.
        """
        values: dict[str, str] = {}
        for part in text.split("&"):
            key, _, value = part.partition("=")
            if key in values or not re.fullmatch(_FORMS.get(key, r"(?!)"), value):
                raise InputError(
                    f"{spec}: after the ? stand mode=NAME, size=WIDTHxHEIGHT or fps=NUMBER, or several of them "
                    f"joined by &, got {part!r}"
                )
            values[key] = value
        width, _, height = values.get("size", "").replace("×", "x").partition("x")
        return cls(
            values.get("mode", ""), (int(width), int(height)) if width else None,
            int(values["fps"]) if "fps" in values else None,
        )  # fmt: skip

    def choose(
        self,
        camera: str,
        modes: Sequence[Mode],
        default_size: tuple[int, int] = DEFAULT_SIZE,
        default_fps: int = DEFAULT_FPS,
    ) -> int:
        """Index of the requested mode; among several, the one nearest to the default size, then to the default rate.

        Raises:
            CameraMismatchError: when the camera has no such mode; the message lists what it has.
        """
        candidates, chosen = list(range(len(modes))), ""
        for option, value, value_of in (
            ("mode", self.name, lambda mode: mode.name),
            ("size", self.size, lambda mode: (mode.width, mode.height)),
            ("fps", self.fps, lambda mode: mode.fps),
        ):
            if not value:
                continue
            matching = [index for index in candidates if value_of(modes[index]) == value]
            if not matching:
                raise CameraMismatchError(
                    f"camera {camera!r} has no {option}={_text(value)}{chosen and f' with {chosen[1:]}'}: it has "
                    f"{_listed(value_of(modes[index]) for index in candidates) or 'no modes with names'}"
                )
            candidates, chosen = matching, f"{chosen}&{option}={_text(value)}"

        def distance(index: int) -> tuple[int, int]:
            mode = modes[index]
            return abs(mode.width - default_size[0]) + abs(mode.height - default_size[1]), abs(mode.fps - default_fps)

        return min(candidates, key=distance)


def _text(value: object) -> str:
    return f"{value[0]}x{value[1]}" if isinstance(value, tuple) else str(value)


def _listed(values: Iterable[object]) -> str:
    """Each value once, sorted, as a user types it."""
    known = {value for value in values if value}
    in_order = sorted(known, key=lambda value: value if isinstance(value, tuple) else (value,))
    return ", ".join(_text(value) for value in in_order)
