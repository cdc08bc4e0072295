"""The page in the browser: one viser server on one address. It asks nothing of other machines, and text from outside is
shown as text."""

from __future__ import annotations

import contextlib
import html
import io
import logging
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from typing import Any

import viser

from depthmocap.errors import InputError
from depthmocap.text import harmless, shortened

#: Largest number of characters of a name on the page.
LONGEST_LABEL = 60
#: Seconds that the end waits for browsers.
_CLOSE_S = 1.5


class _Server(viser.ViserServer):
    """A server that no page can make open a tunnel to another machine."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        return None


class Page:
    """A served page; a context manager.

    Attributes:
        server: viser's.
        url: the address for a browser.
    """

    def __init__(self, host: str, port: int, title: str) -> None:
        """
        Args:
            host: the address to serve on; 127.0.0.1 is this machine alone.
            port: 0 takes any that is free.

        Raises:
            InputError: when it cannot be served there.
        """
        _check_address(host, port)
        # Whoever sends something else than a browser does is cut off, which would be told with a stack.
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        with _quiet():
            self.server = _Server(host, port, label=plain(title), verbose=False)
        if port and self.server.get_port() != port:  # somebody else was faster
            self.close()
            raise InputError(f"cannot serve on {host}:{port}: choose another --port")
        shown = "localhost" if host in ("0.0.0.0", "::", "") else f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self.server.get_port()}"
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(380)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving. A browser that has stalled is not waited for."""
        # viser waits for each browser to close its side.
        stopping = threading.Thread(target=self.server.stop, name="page closing", daemon=True)
        with _quiet():
            stopping.start()
            stopping.join(_CLOSE_S)

    def open_browser(self) -> bool:
        """Open a browser with the page, unless only browsers in the terminal could; returns whether one was asked."""
        if sys.platform not in ("win32", "darwin") and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
            return False
        return webbrowser.open(self.url)

    def tell(self, text: str, wrong: bool = False) -> None:
        """Show a line in every browser for a few seconds."""
        for client in self.server.get_clients().values():
            color = "red" if wrong else "teal"
            client.add_notification(plain(text, 290), "", auto_close_seconds=8.0, color=color)

    @contextlib.contextmanager
    def errors_shown(self) -> Iterator[None]:
        """Show an error that the user has caused, in place of raising it."""
        try:
            yield
        except InputError as error:
            self.tell(str(error), wrong=True)
        except OSError as error:
            self.tell(error.strerror or str(error), wrong=True)


def _check_address(host: str, port: int) -> None:
    if not 0 <= port <= 65535:
        raise InputError(f"--port must be from 0 to 65535, got {port}")
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        with socket.socket(family, kind) as probe:
            if os.name == "posix":
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot serve on {host}:{port} ({reason}): choose another --host or --port") from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without what viser prints about itself."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def plain(text: str, most: int = LONGEST_LABEL) -> str:
    """Text from outside for labels, which show it as it is: one line of limited length."""
    return shortened(harmless(text), most)


def as_html(text: str, most: int = LONGEST_LABEL) -> str:
    """Text from outside within HTML."""
    return html.escape(plain(text, most))


def every(handle: Any, call: Callable[[], None]) -> None:
    """Call a function whenever a user changes an input or clicks a button, but not when the program sets it."""
    register = getattr(handle, "on_click", None) or handle.on_update
    register(lambda event: call() if event.client_id is not None else None)
