"""``depthmocap view``: a recording, the results of a run, or both, in a browser."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import tyro
from rich.console import Console

from depthmocap.core.console import Terminal
from depthmocap.viewing.edit_controls import EditControls
from depthmocap.viewing.take_page import TakePage
from depthmocap.viewing.viewed_take import open_take
from depthmocap.viewing.viewer_page import Page

#: Address where viewers listen.
HOST = "127.0.0.1"
#: Port where viewers listen.
PORT = 8080


@dataclasses.dataclass(frozen=True)
class ViewSettings:
    """Look through a take in a browser, and correct it.

    Attributes:
        paths: a recording, a folder of results of run or live, or both; with results alone, their recording is shown
            where it is still there.
        beside: a second folder of results, drawn over the first in violet.
        rig: a rig.json that tells where the cameras stand, instead of what the recording says.
        host: address to serve on; 0.0.0.0 lets other machines watch and correct.
        port: of the server; 0 takes any that is free.
        open: open the page in the browser.
    """

    paths: tyro.conf.Positional[tuple[Path, ...]]
    beside: Path | None = None
    rig: Path | None = None
    host: str = HOST
    port: int = PORT
    open: bool = True


def view(settings: ViewSettings, console: Console | None = None) -> None:
    """Serve the page until Ctrl-C.

    Raises:
        InputError: when a path is neither a recording nor a folder of results, or the page cannot be served there.
    """
    console = console or Terminal(stderr=True)
    with console.status("reading"):
        take = open_take(settings.paths, settings.beside, settings.rig)
    with Page(settings.host, settings.port, "depthmocap") as page, TakePage(page, take) as shown:
        if take.result is not None:
            EditControls(shown)
        for note in take.notes:
            console.print(f"• {note}")
        console.print(f"open {page.url} in a browser; Ctrl-C ends")
        if settings.open:
            page.open_browser()
        while True:
            time.sleep(1.0)
