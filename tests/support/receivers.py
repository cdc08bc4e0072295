"""Programs that take what streams send, each by the library that its users have. All on this machine alone."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
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


#: Lab Streaming Layer looks nowhere but on this machine, and finds nothing but what these tests make.
_LSL_CONFIGURATION = """
[ports]
IPv6 = disable
[multicast]
ResolveScope = machine
ListenAddress = 127.0.0.1
AddressesOverride = {127.0.0.1}
[lab]
KnownPeers = {127.0.0.1}
SessionID = depthmocap-tests-%d
[tuning]
MulticastMinRTT = 0.02
UnicastMinRTT = 0.02
[log]
level = -3
"""


@pytest.fixture
def lsl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """pylsl, restricted to this machine. The library reads its configuration when it is first used in a process."""
    path = tmp_path / "lsl_api.cfg"
    path.write_text(_LSL_CONFIGURATION % os.getpid(), encoding="utf-8")
    monkeypatch.setenv("LSLAPICFG", str(path))
    return pytest.importorskip("pylsl")


def lsl_inlet(lsl: Any, name: str) -> Any:
    """The receiving end of a stream, connected. It is found by asking one port after the other, not by a broadcast."""
    (found,) = lsl.resolve_byprop("name", name, 1, 20)
    inlet = lsl.StreamInlet(found, recover=False)
    inlet.open_stream(20)
    return inlet


@pytest.fixture
def osc() -> Iterator[OscReceiver]:
    """A listening OSC server."""
    pytest.importorskip("pythonosc")
    receiver = OscReceiver()
    yield receiver
    receiver.close()


class FoxgloveClient:
    """Speaks Foxglove's protocol over a WebSocket: keeps the messages of all topics, or of some.

    Attributes:
        messages: topic, log time (ns) and data, in order.
        schemas: the name of every topic's schema.
        listening: while it is cleared, nothing is read.
    """

    def __init__(self, port: int, wanted: Callable[[str], bool] = lambda topic: True) -> None:
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        address = f"ws://127.0.0.1:{port}"
        protocols = [Subprotocol("foxglove.sdk.v1")]
        self._connection = wait_until(
            lambda: attempted(lambda: connect(address, subprotocols=protocols, close_timeout=0.1))
        )
        self.messages: list[tuple[str, int, bytes]] = []
        self.schemas: dict[str, str] = {}
        self.listening = threading.Event()
        self.listening.set()
        self._wanted, self._topics = wanted, dict[int, str]()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):  # the SDK's server bids no farewell
            self._read()

    def _read(self) -> None:
        for message in self._connection:
            self.listening.wait()
            if isinstance(message, bytes):
                if message[0] == 1:  # a message of a subscription
                    number, stamp_ns = struct.unpack_from("<IQ", message, 1)
                    self.messages.append((self._topics[number], stamp_ns, message[13:]))
                continue
            told = json.loads(message)
            for channel in told["channels"] if told["op"] == "advertise" else ():
                self.schemas[channel["topic"]] = channel["schemaName"]
                if self._wanted(channel["topic"]):
                    self._topics[channel["id"]] = channel["topic"]
                    subscription = {"id": channel["id"], "channelId": channel["id"]}
                    self._connection.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))

    def of(self, topic: str) -> list[tuple[int, bytes]]:
        """Log times and data of a topic's messages, in order."""
        return [(stamp_ns, data) for each, stamp_ns, data in list(self.messages) if each == topic]

    def close(self) -> None:
        """Leave."""
        self._connection.close()
        self._thread.join()
