"""Receivers of streams, and a viewer's client, in processes of their own: they read every message and draw nothing."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import multiprocessing
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any, Literal

Scheme = Literal["osc", "vmc", "ws", "foxglove"]


@dataclasses.dataclass(frozen=True)
class Arrival:
    """A set that arrived: when (ns of the machine's monotonic clock), and how many people were told."""

    ns: int
    people: int


#: By exposure (milliseconds since 1970).
Arrivals = dict[int, Arrival]


def _listen_osc(pipe: Connection) -> None:
    """Receive by OSC until told to end; VMC tells no exposure, so that its sets are counted in order."""
    from pythonosc.dispatcher import Dispatcher
    from pythonosc.osc_server import BlockingOSCUDPServer

    arrivals: Arrivals = {}
    dispatcher = Dispatcher()
    key = 0

    def take(_: str, seconds: int, nanoseconds: int) -> None:
        nonlocal key
        key = round(seconds * 1e3 + nanoseconds * 1e-6)
        arrivals.setdefault(key, Arrival(time.monotonic_ns(), 0))

    def take_people(_: str, *numbers: int) -> None:
        arrivals[key] = Arrival(arrivals[key].ns, len(numbers))

    def take_bones(_: str, seconds: float) -> None:
        arrivals[len(arrivals)] = Arrival(time.monotonic_ns(), 1)

    dispatcher.map("/depthmocap/time", take)
    dispatcher.map("/depthmocap/people", take_people)
    dispatcher.map("/VMC/Ext/T", take_bones)
    with BlockingOSCUDPServer(("127.0.0.1", 0), dispatcher) as server:
        server.timeout = 0.2
        pipe.send(server.server_address[1])
        while not pipe.poll():
            server.handle_request()
    pipe.send(arrivals)


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def _connected(pipe: Connection, port: int, protocol: str) -> Any:
    """A connection, as soon as there is a server; None if it is told to end before."""
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    asked = [Subprotocol(protocol)] if protocol else None
    while not pipe.poll():
        try:
            return connect(f"ws://127.0.0.1:{port}", subprotocols=asked, close_timeout=0.1, max_size=None)
        except OSError:
            time.sleep(0.01)
    return None


def _listen_ws(pipe: Connection, protocol: str = "") -> None:
    """Connect, and receive until the server ends."""
    from websockets.exceptions import ConnectionClosed

    port = _free_port()
    pipe.send(port)
    arrivals: Arrivals = {}
    connection = _connected(pipe, port, protocol)
    if connection is None:
        return pipe.send(arrivals)
    with contextlib.suppress(ConnectionClosed), connection:
        for message in connection:
            now_ns = time.monotonic_ns()
            if isinstance(message, bytes):  # Foxglove's, of a subscription
                arrivals.setdefault(round(int.from_bytes(message[5:13], "little") * 1e-6), Arrival(now_ns, 1))
                continue
            told = json.loads(message)
            if "unix_s" in told:
                arrivals.setdefault(round(told["unix_s"] * 1e3), Arrival(now_ns, len(told.get("people", ()))))
            for channel in told.get("channels", ()):
                subscription = {"id": channel["id"], "channelId": channel["id"]}
                connection.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
    return pipe.send(arrivals)


def _listen_foxglove(pipe: Connection) -> None:
    _listen_ws(pipe, "foxglove.sdk.v1")


def watch_page(pipe: Connection) -> None:
    """Be a browser of a page: connect, say where the camera is, and read until the server ends. The messages and bytes
    are sent at the end."""
    import msgspec
    import viser
    from viser import _messages
    from websockets.exceptions import ConnectionClosed

    port = _free_port()
    pipe.send(port)
    messages = size = 0
    connection = _connected(pipe, port, f"viser-v{viser.__version__}")
    if connection is None:
        return pipe.send((messages, size))
    camera = _messages.ViewerCameraMessage(
        (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, 0.01, 100.0, 600, 800, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)
    )
    fields = {field.name: getattr(camera, field.name) for field in dataclasses.fields(camera) if field.init}
    with contextlib.suppress(ConnectionClosed), connection:
        connection.send(msgspec.msgpack.encode({"type": type(camera).__name__, **fields}))
        for message in connection:
            messages, size = messages + 1, size + len(message)
    return pipe.send((messages, size))


_LISTENERS: dict[str, Callable[[Connection], None]] = {
    "osc": _listen_osc, "vmc": _listen_osc, "ws": _listen_ws, "foxglove": _listen_foxglove, "page": watch_page,
}  # fmt: skip


@contextlib.contextmanager
def receivers(kinds: Sequence[Scheme | Literal["page"]]) -> Iterator[tuple[list[int], dict[str, Any]]]:
    """Receivers in processes of their own: the ports, and at the end what each tells."""
    context, told = multiprocessing.get_context("spawn"), dict[str, Any]()
    started, ports = [], []
    for kind in kinds:
        ours, theirs = context.Pipe()
        process = context.Process(target=_LISTENERS[kind], args=(theirs,), daemon=True)
        process.start()
        started.append((kind, process, ours))
        ports.append(ours.recv())
    yield ports, told
    for kind, process, pipe in started:
        with contextlib.suppress(BrokenPipeError):  # it has seen that the server ended
            pipe.send(None)
        told[kind] = pipe.recv()
        process.join()
