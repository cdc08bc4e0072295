"""The terminal: what is printed there is data, and can neither steer it nor forge lines."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import IO, Any, TextIO, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.text import Text

from depthmocap.core.standard_streams import lasting
from depthmocap.text import harmless


class Terminal(Console):
    """A console for which no text is markup. A string, also one in a table, is one line; nothing that is printed, by
    whatever way, holds a control character that is not the console's own. Work does not end because it cannot be told
    of: what its stream does not take is dropped."""

    def __init__(self, **options: Any) -> None:
        """``options``: of rich's console."""
        super().__init__(markup=False, highlight=False, emoji=False, **options)

    @property
    def file(self) -> IO[str]:
        """What it prints to."""
        return lasting(cast(TextIO, super().file))

    @file.setter
    def file(self, new_file: IO[str]) -> None:
        self._file = new_file

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(harmless(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            text = segment.text
            if segment.control or text.isprintable() or text == "\n":
                yield segment
            else:
                yield Segment("\n".join(map(harmless, text.split("\n"))), segment.style)


class OneLine(logging.Formatter):
    """Warnings as harmless lines."""

    def format(self, record: logging.LogRecord) -> str:
        return harmless(super().format(record))


def description(text: str) -> str:
    """Text of others as the description of a progress bar, which would be read as markup."""
    return escape(harmless(text))
