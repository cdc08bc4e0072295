"""PNG files of labels and depth, in memory.

Such pictures are mostly flat or empty: a compressor made for them (``kernels.deflate``) is several times as fast as
libpng, for RGBA, and its files are no larger. The bytes depend on the picture alone.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from jaxtyping import Integer, UInt8
from numpy import ndarray

from depthmocap.kernels.deflate import deflate

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGBA = 0, 6
_BYTES = np.arange(1 << 8, dtype=np.uint8)[:, None]
#: PNG has the high byte first.
_PAIRS = np.arange(1 << 16, dtype=">u2").view(np.uint8).reshape(-1, 2)


def colour_png(values: Integer[ndarray, "h w"], colours: UInt8[ndarray, "n 4"]) -> bytes:
    """An RGBA picture of ``colours[values]``.

    Raises:
        ValueError: for a value beyond the colours, or without pixels.
    """
    if values.size and (values.max() >= len(colours) or values.min() < 0):
        raise ValueError(f"values must be 0 to {len(colours) - 1}")
    return _png(values, colours, 8, _RGBA)


def grey_png(image: Integer[ndarray, "h w"]) -> bytes:
    """A grey picture of 8 or 16 bits.

    Raises:
        ValueError: when the image is neither uint8 nor uint16, or without pixels.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"a grey picture must be uint8 or uint16, got {image.dtype}")
    wide = image.dtype == np.uint16
    return _png(image, _PAIRS if wide else _BYTES, 16 if wide else 8, _GREY)


def _png(values: Integer[ndarray, "h w"], pixels: UInt8[ndarray, "n k"], depth: int, kind: int) -> bytes:
    if not values.size:
        raise ValueError("a picture needs at least one pixel")
    height, width = values.shape
    stream = deflate(np.ascontiguousarray(values), np.ascontiguousarray(pixels)).tobytes()
    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", stream) + _chunk(b"IEND", b"")


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(name)))
