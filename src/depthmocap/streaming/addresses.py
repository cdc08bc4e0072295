"""Addresses of streams: ``--stream SCHEME://HOST:PORT``."""

from __future__ import annotations

from depthmocap.errors import InputError
from depthmocap.streaming.stream_protocol import Stream


def open_stream(address: str) -> Stream:
    """The stream of an address.

    Raises:
        InputError: when it is no address of a stream, or the package that it needs is not installed.
    """
    raise InputError(f"there is no stream {address!r}")
