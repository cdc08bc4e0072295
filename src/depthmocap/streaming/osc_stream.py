"""``osc://HOST:PORT``: joints and their confidence by name, over Open Sound Control (UDP), by python-osc.

Everybody is a bundle of their own, so that it fits into one packet:

    /depthmocap/time          seconds, nanoseconds      the exposure, since 1970
    /depthmocap/people        numbers                   of everybody in view
    /depthmocap/N/Head        x, y, z, confidence       of person N, metres, the rig's world; and so on for every joint

A joint that is not observed is left out. Where nobody is in view, the bundle has the first two alone.
"""

from __future__ import annotations

import functools
import math
import socket
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError, missing_extra
from depthmocap.streaming.stream_protocol import Sample, Stream, StreamSetup

#: Messages of one bundle: with the headers of all layers below 1,500 bytes, beyond which a packet is cut in pieces.
MOST_BYTES = 1400
#: The beginning of a bundle that is due at once.
_BUNDLE = b"#bundle\0" + struct.pack(">Q", 1)
#: Whole numbers beyond this have 64 bits.
_LARGEST_INT = 2**31 - 1


@functools.lru_cache(4096)
def _text(text: str) -> bytes:
    """A text in OSC's form: zeros after it, up to a multiple of four bytes. It is the same names with every set."""
    data = text.encode()
    return data + bytes(4 - len(data) % 4)


def osc_message(address: str, values: Sequence[str | int | float]) -> bytes:
    """A message as python-osc builds it, in a tenth of its time: with every set there are some for each person."""
    tags, parts = ",", []
    for value in values:
        if isinstance(value, str):
            tag, part = "s", _text(value)
        elif isinstance(value, float):
            tag, part = "f", struct.pack(">f", value)
        elif abs(value) <= _LARGEST_INT:
            tag, part = "i", struct.pack(">i", value)
        else:
            tag, part = "h", struct.pack(">q", value)
        tags += tag
        parts.append(part)
    return b"".join([_text(address), _text(tags), *parts])


class _Bundle(NamedTuple):
    """What python-osc sends of a bundle."""

    dgram: bytes


class OscSender:
    """Sends bundles of messages to one host. Times are in the messages: a bundle is due at once, whatever clock the
    receiver has."""

    def __init__(self, host: str, port: int) -> None:
        """Raises InputError when python-osc is not installed, or the port cannot be one."""
        try:
            import pythonosc.udp_client
        except ModuleNotFoundError:
            raise missing_extra("python-osc", "stream") from None
        if port == 0:
            raise InputError("an OSC receiver's port is from 1 to 65535, got 0")
        self._osc, self._host, self._port = pythonosc, host, port
        self._client: Any = None

    def connect(self) -> None:
        """Look the host up.

        Raises:
            InputError: when there is none of this name.
        """
        try:
            hosts = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            raise InputError(f"no host {self._host!r}: {getattr(error, 'strerror', error)}") from None
        family, _, _, _, place = hosts[0]
        self._client = self._osc.udp_client.UDPClient(str(place[0]), self._port, True, family)

    def send(self, messages: list[tuple[str, list[Any]]]) -> None:
        """Send addresses and their arguments as a bundle, or as several where they do not fit into one packet."""
        bundle, size = [_BUNDLE], 0
        for address, values in messages:
            message = osc_message(address, values)
            if size + len(message) > MOST_BYTES:
                self._send(bundle)
                bundle, size = [_BUNDLE], 0
            bundle += [struct.pack(">i", len(message)), message]
            size += len(message) + 4  # and its length
        self._send(bundle)

    def _send(self, bundle: list[bytes]) -> None:
        self._client.send(_Bundle(b"".join(bundle)))

    def close(self) -> None:
        """Close the socket."""
        self._client._sock.close()


class OscStream(Stream):
    """Sends joints to whoever listens at a port."""

    def __init__(self, host: str, port: int) -> None:
        """Raises InputError when python-osc is not installed, or the port cannot be one."""
        self._sender = OscSender(host, port)

    def start(self, setup: StreamSetup) -> None:
        """See :class:`Stream`."""
        self._sender.connect()

    def send(self, sample: Sample) -> None:
        """See :class:`Stream`."""
        head: list[tuple[str, list[Any]]] = [
            ("/depthmocap/time", list(divmod(sample.unix_ns, 10**9))),
            ("/depthmocap/people", list(sample.people)),
        ]
        for number, pose in sample.people.items():
            rows = zip(JOINTS, np.column_stack([pose.joints, pose.confidence]).tolist(), strict=True)
            seen = [(f"/depthmocap/{number}/{name}", row) for name, row in rows if all(map(math.isfinite, row))]
            self._sender.send([*head, *seen])
        if not sample.people:
            self._sender.send(head)

    def close(self) -> None:
        """See :class:`Stream`."""
        self._sender.close()
