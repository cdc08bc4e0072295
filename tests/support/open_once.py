"""A process of the tests opens each network once: that takes long, and a session keeps nothing of what it ran."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from collections.abc import Iterator

import onnxruntime
import pytest

from depthmocap.core import network_devices

_OPEN = network_devices._open
_ONNX_RUNTIME = onnxruntime.InferenceSession


@contextlib.contextmanager
def networks_open_once() -> Iterator[None]:
    """Networks on the CPU are opened once; where a test puts something in place of ONNX Runtime, each time."""
    opened: dict[bytes, onnxruntime.InferenceSession] = {}

    @functools.wraps(_OPEN)
    def once(network: bytes, device: str | None) -> onnxruntime.InferenceSession:
        if device is not None or onnxruntime.InferenceSession is not _ONNX_RUNTIME:
            return _OPEN(network, device)
        key = hashlib.sha256(network).digest()
        if key not in opened:
            opened[key] = _OPEN(network, None)
        return opened[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_devices, "_open", once)
        yield
