"""Output to the terminal. Printed data can neither control the terminal nor forge lines."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import IO, Any, TextIO, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.text import Text

from depthmocap.core.standard_streams import fault_tolerant
from depthmocap.text import harmless


class Terminal(Console):
    """A console that interprets no text as markup. Every string is one line, also in a table, and no output contains
    control characters except the console's own. Text that the stream does not take is dropped; work continues."""

    def __init__(self, **options: Any) -> None:
        """``options``: those of rich's console."""
        super().__init__(markup=False, highlight=False, emoji=False, **options)

    @property
    def file(self) -> IO[str]:
        """The stream to which it prints."""
        return fault_tolerant(cast(TextIO, super().file))

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


class OneLineFormatter(logging.Formatter):
    """Formats log messages as one harmless line."""

    def format(self, record: logging.LogRecord) -> str:
        return harmless(super().format(record))


def progress_text(text: str) -> str:
    """Text from outside as the description of a progress bar, escaped because rich reads it as markup."""
    return escape(harmless(text))
