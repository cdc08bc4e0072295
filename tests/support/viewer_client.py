"""A browser's side of a viewer's connection: it connects, clicks and reads, and draws nothing."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import msgspec
import viser
from viser import _messages
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from depthmocap.viewing.viewer_page import Page


class ViewerClient:
    """A connection to a page; a context manager."""

    def __init__(self, page: Page) -> None:
        self._page = page
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        self.connection: ClientConnection = connect(
            page.url.replace("http:", "ws:"), subprotocols=[protocol], max_size=None, close_timeout=0.2
        )

    def __enter__(self) -> ViewerClient:
        known = set(self._page.server.get_clients())
        camera = _messages.ViewerCameraMessage(
            (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, 0.01, 100.0, 600, 800, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)
        )
        self._send(camera)
        end_s = time.monotonic() + 10
        while set(self._page.server.get_clients()) == known and time.monotonic() < end_s:
            time.sleep(0.005)
        return self

    def __exit__(self, *failure: object) -> None:
        self.connection.close()

    def set(self, handle: Any, value: Any) -> None:
        """Change an input, or click a button of the page."""
        self._send(_messages.GuiUpdateMessage(handle._impl.uuid, {"value": value}))

    def read(self, seconds: float = 5.0) -> int:
        """Read one message; returns its bytes."""
        return len(self.connection.recv(timeout=seconds))

    def _send(self, message: Any) -> None:
        fields = {field.name: getattr(message, field.name) for field in dataclasses.fields(message) if field.init}
        self.connection.send(msgspec.msgpack.encode({"type": type(message).__name__, **fields}))
