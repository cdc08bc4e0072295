"""Writes ONI files as OpenNI's recorder lays them out, with depth that is not compressed."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

_MAGIC = 0x0052494E
_ADDED, _INT, _GENERAL, _REMOVED, _BEGIN, _READY, _DATA, _END, _SEEK = 0xD, 3, 6, 7, 8, 9, 0xA, 0xB, 0xE


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def write_oni(
    path: Path, frames: Sequence[tuple[int, np.ndarray]], fov: tuple[float, float] = (1.0, 0.8), mirror: int = 0,
    extra: int = 0,
) -> None:  # fmt: skip
    """``frames``: time (microseconds) and depth. ``extra``: frames that the header promises and the file lacks."""
    height, width = frames[0][1].shape
    records: list[bytes] = []
    position = 24

    def record(kind: int, fields: bytes = b"", payload: bytes = b"", node: int = 1) -> int:
        nonlocal position
        records.append(struct.pack("<5IQ", _MAGIC, kind, node, 28 + len(fields), len(payload), 0) + fields + payload)
        at, position = position, position + len(records[-1])
        return at

    def integer(name: str, value: int) -> None:
        record(_INT, _text(name) + struct.pack("<IQ", 8, value))

    def general(name: str, value: bytes) -> None:
        record(_GENERAL, _text(name) + struct.pack("<I", len(value)) + value)

    stamps = [stamp for stamp, _ in frames]
    added = _text("Depth") + struct.pack("<I4sIQQ", 2, b"NONE", len(frames) + extra, min(stamps), max(stamps))
    record(_ADDED, added + bytes(8))
    integer("oniRequiredFrameSize", width * height * 2)
    integer("xnDeviceMaxDepth", 10_000)
    integer("xnMirror", mirror)
    general("xnMapOutputMode", struct.pack("<3I", width, height, 30))
    general("xnCropping", struct.pack("<I4H", 0, 0, 0, width, height))
    general("xnFOV", struct.pack("<2d", *fov))
    integer("oniPixelFormat", 100)
    record(_READY)
    record(_BEGIN, struct.pack("<IQ", len(frames), max(stamps)))
    index = [(0, 0, 0)]
    for number, (stamp, depth) in enumerate(frames, 1):
        at = record(_DATA, struct.pack("<QI", stamp, number), depth.astype("<u2").tobytes())
        index.append((stamp, 0, at))
    record(_REMOVED)
    seek = record(_SEEK, payload=b"".join(struct.pack("<QIQ", *entry) for entry in index))
    record(_END, node=0)
    # The first record tells where the index is.
    records[0] = records[0][:28] + added + struct.pack("<Q", seek)
    path.write_bytes(b"NI10" + struct.pack("<BBHIQI", 1, 0, 1, 0, max(stamps), 1) + b"".join(records))
