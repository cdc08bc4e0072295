"""Programs that take what streams send, each by the library that its users have. All on this machine alone."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest


def wait_until(ready: Callable[[], Any], seconds: float = 20.0) -> Any:
    """What ``ready`` gives once that is true."""
    end_s = time.monotonic() + seconds
    while not (outcome := ready()):
        assert time.monotonic() < end_s, "nothing came"
        time.sleep(0.002)
    return outcome


def attempted(call: Callable[[], Any]) -> Any:
    """What ``call`` gives; None where the system refuses it."""
    try:
        return call()
    except OSError:
        return None


def free_port() -> int:
    """A port of this machine where nobody listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class OscReceiver:
    """python-osc's server, which keeps every message: its address and arguments."""

    def __init__(self) -> None:
        from pythonosc.dispatcher import Dispatcher
        from pythonosc.osc_server import BlockingOSCUDPServer

        dispatcher = Dispatcher()
        dispatcher.set_default_handler(lambda address, *values: self.messages.append((address, values)))
        self.messages: list[tuple[str, tuple[Any, ...]]] = []
        self._server = BlockingOSCUDPServer(("127.0.0.1", 0), dispatcher)
        self.port = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)
        self._thread.start()

    def of(self, address: str) -> list[tuple[Any, ...]]:
        """Arguments of the messages to an address, in order."""
        return [values for each, values in list(self.messages) if each == address]

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@pytest.fixture
def osc() -> Iterator[OscReceiver]:
    """A listening OSC server."""
    pytest.importorskip("pythonosc")
    receiver = OscReceiver()
    yield receiver
    receiver.close()
