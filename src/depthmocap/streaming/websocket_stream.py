"""``ws://HOST:PORT``: a WebSocket server that sends JSON to everybody who connects.

First, of the take:

    {"type": "start", "version": 1, "joints": ["Head", …], "bones": [["Hip", "Spine"], …], "up": "z", "unit": "m"}

then of every set, joints in the order of ``joints`` in the rig's world, null where unobserved:

    {"type": "poses", "unix_s": 1700000000.04,
     "people": [{"number": 1, "joints": [[0.1, 0.2, 1.6], null, …], "confidence": [0.97, 0, …]}, …]}

and, when there is one:

    {"type": "marker", "unix_s": 1700000000.04, "text": "trial 3"}

``unix_s`` is the exposure in seconds since 1970. What clients send is ignored. A client that reads too slowly misses
sets, and gets the newest.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import json
import logging
import math
import os
import re
import socket
import threading
import time
from collections.abc import Coroutine
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINTS
from depthmocap.errors import InputError, missing_extra
from depthmocap.streaming.addresses import place
from depthmocap.streaming.stream_protocol import Marker, Sample, Stream, StreamSetup

#: Version of the messages; it increases when a key is removed or changes its meaning.
VERSION = 1
#: Clients at a time; one more is turned away.
MOST_CLIENTS = 64
#: Markers that may wait for a slow client; beyond them the oldest is dropped.
MAX_MARKERS = 100
#: Bytes on their way to a client, in the system and here: a slow one shall not read what is long past.
_BUFFER = 2**16
#: Seconds for opening the port.
_OPEN_S = 10.0
#: Seconds for clients to take their leave.
_LEAVE_S = 0.5
#: Pages that may connect where the server is for this machine alone: other sites open in the browser must not.
_LOCAL_PAGE = re.compile(r"null|https?://(localhost|127\.\d+\.\d+\.\d+|\[::1\])(:\d+)?")
#: Decimals of a metre, as in pose.csv.
_DECIMALS = 6
#: Decimals of a confidence, as in pose.csv.
_CONFIDENCE_DECIMALS = 4


def start_message(up: str) -> str:
    """What a client is told first."""
    return json.dumps({"type": "start", "version": VERSION, "joints": JOINTS, "bones": BONES, "up": up, "unit": "m"})


def poses_message(sample: Sample) -> str:
    """What a client is told of a set."""
    people = [
        {
            "number": number,
            "joints": _places(pose.joints),
            "confidence": np.round(pose.confidence, _CONFIDENCE_DECIMALS).tolist(),
        }
        for number, pose in sample.people.items()
    ]
    return json.dumps({"type": "poses", "unix_s": sample.unix_ns / 1e9, "people": people}, allow_nan=False)


def _places(joints: Float[ndarray, "18 3"]) -> list[list[float] | None]:
    rows = np.round(joints.astype(np.float64), _DECIMALS).tolist()
    return [row if all(map(math.isfinite, row)) else None for row in rows]


class _Client:
    """What waits for one client."""

    def __init__(self) -> None:
        self.markers: collections.deque[str] = collections.deque(maxlen=MAX_MARKERS)
        self.poses = ""
        self.something = asyncio.Event()

    def taken(self) -> list[str]:
        """What waits, which then waits no more."""
        messages = [*self.markers, *([self.poses] if self.poses else [])]
        self.markers.clear()
        self.poses = ""
        self.something.clear()
        return messages


class WebSocketStream(Stream):
    """Serves poses as JSON. The server's own thread talks to the clients, none of whom waits for another."""

    def __init__(self, host: str, port: int) -> None:
        """Raises InputError when websockets is not installed."""
        try:
            import websockets.asyncio.server
            import websockets.exceptions
        except ModuleNotFoundError:
            raise missing_extra("websockets", "stream") from None
        self._websockets = websockets
        self._host, self._port = host, port
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._server: Any = None
        self._clients: dict[Any, _Client] = {}
        self._hello = ""

    @property
    def port(self) -> int:
        """The port of the running server."""
        return self._server.sockets[0].getsockname()[1]

    def start(self, setup: StreamSetup) -> None:
        """Listen.

        Raises:
            InputError: when the port is taken, or the host is none of this machine's.
        """
        self._hello = start_message(setup.rig.up)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=f"server {self.name}", daemon=True)
        self._thread.start()
        try:
            self._call(self._open(), _OPEN_S)
        except OSError as error:
            self._end()
            number = error.errno or 0
            reason = os.strerror(number) if number > 0 else error.strerror  # asyncio's own texts are longer
            raise InputError(f"cannot serve on {place(self._host, self._port)}: {reason}") from None
        setup.tell(f"JSON for whoever connects to ws://{place(self._host, self.port)}")

    def send(self, sample: Sample) -> None:
        """See :class:`Stream`."""
        if self._clients:
            self._for_all(poses=poses_message(sample))

    def mark(self, marker: Marker) -> None:
        """See :class:`Stream`."""
        self._for_all(marker=json.dumps({"type": "marker", "unix_s": marker.unix_ns / 1e9, "text": marker.text}))

    def close(self) -> None:
        """See :class:`Stream`."""
        self._call(self._shut(), 4 * _LEAVE_S)
        self._end()

    def _call(self, call: Coroutine[Any, Any, None], seconds: float) -> None:
        """Run it in the server's thread, and wait."""
        assert self._loop is not None
        asyncio.run_coroutine_threadsafe(call, self._loop).result(seconds)

    def _end(self) -> None:
        """End the server's thread."""
        assert self._loop is not None and self._thread is not None
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _for_all(self, poses: str = "", marker: str = "") -> None:
        def hand_over() -> None:
            for client in self._clients.values():
                client.poses = poses or client.poses
                client.markers.extend([marker] if marker else [])
                client.something.set()

        assert self._loop is not None
        self._loop.call_soon_threadsafe(hand_over)

    async def _open(self) -> None:
        logger = logging.Logger("websockets", logging.CRITICAL + 1)  # of clients that fail nobody need be told
        self._server = await self._websockets.asyncio.server.serve(
            self._talk, self._host, self._port, process_request=self._check, compression=None, server_header=None,
            max_size=2**10, max_queue=4, write_limit=_BUFFER, close_timeout=_LEAVE_S, logger=logger,
        )  # fmt: skip

    def _check(self, connection: Any, request: Any) -> Any:
        """None where a client may connect; otherwise the answer."""
        local = connection.local_address[0].startswith("127.") or connection.local_address[0] == "::1"
        origin = request.headers.get("Origin")
        if local and origin is not None and not _LOCAL_PAGE.fullmatch(origin):
            return connection.respond(403, f"pages of {urlsplit(origin).netloc} may not connect\n")
        if len(self._clients) >= MOST_CLIENTS:
            return connection.respond(503, "there are too many clients\n")
        return None

    async def _talk(self, connection: Any) -> None:
        """Send a client what comes, until it leaves."""
        system: socket.socket = connection.transport.get_extra_info("socket")
        system.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        client = self._clients[connection] = _Client()
        reading = asyncio.create_task(_ignore(connection))
        reading.add_done_callback(lambda _: client.something.set())
        try:
            await connection.send(self._hello)
            while not reading.done():
                for message in client.taken():
                    await connection.send(message)
                await client.something.wait()
        except self._websockets.exceptions.ConnectionClosed:
            pass
        finally:
            del self._clients[connection]
            reading.cancel()

    async def _shut(self) -> None:
        """Say goodbye to all clients, and cut off those who do not listen."""
        end_s = time.monotonic() + _LEAVE_S
        while any(client.something.is_set() for client in self._clients.values()) and time.monotonic() < end_s:
            await asyncio.sleep(0.001)  # until they have what waits for them
        self._server.close()
        ended = asyncio.create_task(self._server.wait_closed())
        await asyncio.wait([ended], timeout=_LEAVE_S)
        for connection in list(self._clients):
            connection.transport.abort()
        await ended


async def _ignore(connection: Any) -> None:
    """Read whatever a client sends, so that its farewell is seen."""
    with contextlib.suppress(Exception):  # the sender sees what is wrong with the connection
        async for _ in connection:
            pass
