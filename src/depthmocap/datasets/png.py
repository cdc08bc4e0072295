"""PNG files of labels and depth, in memory (extra: train).

Such pictures are mostly flat or empty. ISA-L's compressor without PNG's filters is many times as fast on them as
libpng, and its files are about a quarter larger. ISA-L may pack the same picture into different bytes; the unpacked
picture is the same.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from jaxtyping import Integer, UInt8
from numpy import ndarray

from depthmocap.errors import missing_extra

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGBA = 0, 6
#: ISA-L's level of compression, 0 to 3; higher ones save next to nothing here.
_LEVEL = 1


def colour_png(values: Integer[ndarray, "h w"], colours: UInt8[ndarray, "n 4"]) -> bytes:
    """An RGBA picture of ``colours[values]``.

    Raises:
        ValueError: for a value beyond the colours, or without pixels.
    """
    if values.size and (values.max() >= len(colours) or values.min() < 0):
        raise ValueError(f"values must be 0 to {len(colours) - 1}")
    # Looking up four bytes as one number is many times as fast.
    pixels = np.ascontiguousarray(colours).view(np.uint32)[:, 0].take(values)
    return _png(pixels.view(np.uint8).reshape(len(values), -1), values.shape, 8, _RGBA)


def grey_png(image: Integer[ndarray, "h w"]) -> bytes:
    """A grey picture of 8 or 16 bits.

    Raises:
        ValueError: when the image is neither uint8 nor uint16, or without pixels.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"a grey picture must be uint8 or uint16, got {image.dtype}")
    wide = image.dtype == np.uint16
    rows = np.ascontiguousarray(image, ">u2" if wide else np.uint8).view(np.uint8)  # the high byte comes first
    return _png(rows, image.shape, 16 if wide else 8, _GREY)


def _png(rows: UInt8[ndarray, "h b"], shape: tuple[int, ...], depth: int, kind: int) -> bytes:
    if not rows.size:
        raise ValueError("a picture needs at least one pixel")
    try:
        from isal import isal_zlib
    except ModuleNotFoundError:
        raise missing_extra("isal", "train") from None
    filtered = np.zeros((shape[0], rows.shape[1] + 1), np.uint8)  # each row begins with its filter: none
    filtered[:, 1:] = rows
    height, width = shape
    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    stream = isal_zlib.compress(filtered, _LEVEL)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", stream) + _chunk(b"IEND", b"")


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(name)))
