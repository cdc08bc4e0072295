"""Addresses of streams: ``--stream SCHEME://HOST:PORT``."""

from __future__ import annotations

import importlib
import re
from typing import cast
from urllib.parse import SplitResult, urlsplit

from depthmocap.errors import InputError
from depthmocap.streaming.stream_protocol import Stream

#: Host of an address without one.
LOCAL_HOST = "127.0.0.1"
#: For each scheme the module and the class of its stream, and its usual port; None where a name stands in place of host
#: and port.
_STREAMS: dict[str, tuple[str, str, int | None]] = {
    "osc": ("depthmocap.streaming.osc_stream", "OscStream", 9000),
    "vmc": ("depthmocap.streaming.vmc_stream", "VmcStream", 39539),
    "ws": ("depthmocap.streaming.websocket_stream", "WebSocketStream", 8770),
    "lsl": ("depthmocap.streaming.lsl_stream", "LslStream", None),
    "foxglove": ("depthmocap.streaming.foxglove_stream", "FoxgloveStream", 8765),
}
#: Characters of a name.
_LONGEST_NAME = 100


def open_stream(address: str) -> Stream:
    """The stream of an address.

    Raises:
        InputError: when it is no address of a stream, or the package that it needs is not installed.
    """
    scheme, _, rest = address.partition("://")
    if not rest and not address.endswith("://"):
        raise InputError(f"a stream is SCHEME://HOST:PORT, such as osc://127.0.0.1:9000, not {address!r}")
    if scheme not in _STREAMS:
        raise InputError(f"there is no stream {scheme}://, only {', '.join(f'{known}://' for known in _STREAMS)}")
    module, name, port = _STREAMS[scheme]
    arguments = (_name(rest),) if port is None else _host_and_port(address, port)
    stream = getattr(importlib.import_module(module), name)(*arguments)
    stream.name = address
    return cast(Stream, stream)


def _name(name: str) -> str:
    """The name of a stream, ``depthmocap`` by default."""
    if not name.isprintable() or len(name) > _LONGEST_NAME:
        raise InputError(f"the name of a stream is at most {_LONGEST_NAME} printable characters, not {name!r}")
    return name or "depthmocap"


def _host_and_port(address: str, usual_port: int) -> tuple[str, int]:
    try:
        parts = urlsplit(address)
        port = usual_port if parts.port is None else parts.port
    except ValueError as error:
        raise InputError(f"the address {address!r} is wrong: {error}") from None
    if parts != SplitResult(parts.scheme, parts.netloc, "", "", "") or "@" in parts.netloc or re.search(r"\s", address):
        raise InputError(f"the address {address!r} has more than a host and a port")
    return parts.hostname or LOCAL_HOST, port


def place(host: str, port: int) -> str:
    """Host and port as they are in an address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
