"""WebSocket clients: good ones, slow ones, and such as do not keep to any rule."""

from __future__ import annotations

import dataclasses
import json
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from receivers import wait_until
from samples import EMPTY_RIG, sample_of, standing_pose

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.errors import InputError
from depthmocap.streaming import websocket_stream
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.stream_protocol import Marker, StreamSetup
from depthmocap.streaming.websocket_stream import WebSocketStream

pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.sync.connection import Connection
from websockets.typing import Origin


@pytest.fixture
def stream() -> Iterator[WebSocketStream]:
    opened = WebSocketStream("127.0.0.1", 0)
    opened.start(StreamSetup(EMPTY_RIG))
    yield opened
    opened.close()


def client(stream: WebSocketStream, origin: str | None = None) -> ClientConnection:
    """One that was told of the take, from when on it gets what is sent."""
    connection = connect(
        f"ws://127.0.0.1:{stream.port}", close_timeout=0.1, origin=None if origin is None else Origin(origin)
    )
    assert received(connection)["type"] == "start"
    return connection


def received(connection: Connection) -> Any:
    return json.loads(connection.recv(timeout=10))


def raw_client(stream: WebSocketStream) -> socket.socket:
    """One that has shaken hands and then does not read."""
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.connect(("127.0.0.1", stream.port))
    raw.sendall(
        b"GET / HTTP/1.1\r\nHost: here\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    wait_until(lambda: stream._clients)
    return raw


def test_json_of_every_set(stream: WebSocketStream) -> None:
    one, two = standing_pose(40_000_000), standing_pose(40_000_000, x=1.0)
    two.joints[JOINT_INDEX["LHand"]], two.confidence[JOINT_INDEX["LHand"]] = np.nan, 0
    with connect(f"ws://127.0.0.1:{stream.port}") as connection:
        assert received(connection) == {
            "type": "start", "version": 1, "joints": list(JOINTS), "bones": [list(bone) for bone in BONES],
            "up": "z", "unit": "m",
        }  # fmt: skip
        stream.send(sample_of(one, two))
        poses = received(connection)
        assert poses["type"] == "poses" and poses["unix_s"] == pytest.approx(1_700_000_000.04, abs=1e-6)
        assert [person["number"] for person in poses["people"]] == [1, 2]
        first, second = poses["people"]
        np.testing.assert_allclose(first["joints"], one.joints, atol=6e-7)
        np.testing.assert_allclose(second["confidence"], two.confidence, atol=6e-5)
        assert second["joints"][JOINT_INDEX["LHand"]] is None
        stream.mark(Marker("trial \u2028 3", 5, 5))
        assert received(connection) == {"type": "marker", "unix_s": 5e-9, "text": "trial \u2028 3"}
        stream.send(sample_of())
        assert received(connection)["people"] == []


def test_what_waits_is_sent_before_the_end() -> None:
    stream = WebSocketStream("127.0.0.1", 0)
    told = list[str]()
    stream.start(StreamSetup(EMPTY_RIG, tell=told.append))
    assert told == [f"JSON for whoever connects to ws://127.0.0.1:{stream.port}"]
    with client(stream) as connection:
        stream.mark(Marker("end", 0, 0))
        stream.close()
        assert received(connection)["type"] == "marker"
        with pytest.raises(ConnectionClosed):
            connection.recv(timeout=10)


def test_one_that_never_reads_holds_nobody_up() -> None:
    stream = WebSocketStream("127.0.0.1", 0)
    stream.start(StreamSetup(EMPTY_RIG))
    with raw_client(stream), client(stream) as other:
        start_s, sample = time.monotonic(), sample_of(*[standing_pose()] * 8)
        for i in range(300):  # 450 kB
            stream.send(dataclasses.replace(sample, unix_ns=i * 10**9))
            assert received(other)["unix_s"] == i
        assert time.monotonic() - start_s < 20
        start_s = time.monotonic()
        stream.close()
        assert time.monotonic() - start_s < 2


def test_one_that_reads_late_gets_the_newest(stream: WebSocketStream) -> None:
    raw, sample = raw_client(stream), sample_of(*[standing_pose()] * 8)
    for i in range(400):  # 600 kB
        stream.send(dataclasses.replace(sample, unix_ns=i * 10**9))
        time.sleep(0.0005)
    raw.settimeout(10)
    data = b""
    while b'"unix_s": 399.0' not in data:
        data += raw.recv(2**16)
    raw.close()
    assert data.count(b'"type": "poses"') < 200


@pytest.mark.parametrize("garbage", [b"\x00" * 5000, b"GET /\r\n\r\n", b"\xff" * 100, b"POST / HTTP/1.1\r\n\r\n", b""])
def test_what_is_no_client(stream: WebSocketStream, garbage: bytes, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(("127.0.0.1", stream.port)) as raw:
        raw.sendall(garbage)
        raw.shutdown(socket.SHUT_WR)
        raw.settimeout(10)
        while raw.recv(1000):
            pass
    client(stream).close()
    assert caplog.records == []


def test_what_a_client_sends_is_ignored_and_too_much_ends_it(stream: WebSocketStream) -> None:
    with client(stream) as good, client(stream) as bad:
        for connection in (good, bad):
            connection.send("what is this?")
        bad.send("x" * 5000)
        stream.send(sample_of())
        assert received(good)["type"] == "poses"
        with pytest.raises(ConnectionClosed):
            for _ in range(3):
                received(bad)
    wait_until(lambda: not stream._clients)


def test_other_sites_in_a_browser_may_not_connect(stream: WebSocketStream) -> None:
    for origin in ("https://example.org", "http://127.0.0.1.example.org", "http://localhost.example.org:80"):
        with pytest.raises(InvalidStatus, match="403"):
            client(stream, origin)
    for origin in ("null", "http://localhost:8000", "http://127.0.0.1", "http://[::1]:3000"):
        client(stream, origin).close()


def test_too_many_clients(stream: WebSocketStream, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket_stream, "MOST_CLIENTS", 1)
    with client(stream), pytest.raises(InvalidStatus, match="503"):
        connect(f"ws://127.0.0.1:{stream.port}")


def test_a_port_that_is_taken(stream: WebSocketStream) -> None:
    threads = threading.active_count()
    second = open_stream(f"ws://:{stream.port}")
    with pytest.raises(InputError, match=f"^cannot serve on 127.0.0.1:{stream.port}: Address already in use$"):
        second.start(StreamSetup(EMPTY_RIG))
    assert threading.active_count() == threads
