"""PNG files of labels and depth, written several times faster than a general encoder does.

Pictures of one person are mostly empty. Empty rows above and below are not compressed again: deflate's form of so many
zeros is made once and kept. The rest is filtered by "up" and compressed by zlib with run lengths only, which on such
pictures is as fast as its fastest level and smaller than it. Any PNG reader reads the result; its bytes depend on the
picture and the version of zlib alone. Formats: PNG (ISO/IEC 15948), zlib (RFC 1950), deflate (RFC 1951).
"""

from __future__ import annotations

import functools
import struct
import zlib

import numpy as np
from jaxtyping import Integer, UInt8
from numpy import ndarray

from depthmocap.kernels.png import filter_colours

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGBA = 0, 6
_UP = 2
#: An empty last block: the end of a deflate stream.
_END = b"\x03\x00"
_ADLER = 65521


def colour_png(values: Integer[ndarray, "h w"], colours: UInt8[ndarray, "n 4"]) -> bytes:
    """An RGBA picture of ``colours[values]``; colour 0 must be four zeros.

    Raises:
        ValueError: for a value beyond the colours, or when colour 0 is something.
    """
    if colours[0].any():
        raise ValueError(f"colour 0 must be zeros, got {colours[0].tolist()}")
    used = _used(values)
    if values.size and (values.max() >= len(colours) or values.min() < 0):
        raise ValueError(f"values must be 0 to {len(colours) - 1}")
    height, width = values.shape
    rows = np.empty((used.stop - used.start, 1 + 4 * width), np.uint8)
    filter_colours(np.ascontiguousarray(values[used]), colours, rows)
    return _file(rows, used.start, height, width, 8, _RGBA)


def grey_png(image: Integer[ndarray, "h w"]) -> bytes:
    """A grey picture of 8 or 16 bits.

    Raises:
        ValueError: when the image is neither uint8 nor uint16.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"a grey picture must be uint8 or uint16, got {image.dtype}")
    size = image.dtype.itemsize
    used = _used(image)
    height, width = image.shape
    values = np.ascontiguousarray(image[used]).astype(f">u{size}", copy=False).view(np.uint8)
    rows = np.empty((len(values), 1 + size * width), np.uint8)
    rows[:, 0] = _UP
    rows[:1, 1:] = values[:1]
    np.subtract(values[1:], values[:-1], out=rows[1:, 1:])
    return _file(rows, used.start, height, width, 8 * size, _GREY)


def _used(image: ndarray) -> slice:
    """Rows from the first to the last that is not empty."""
    rows = np.flatnonzero(image.any(1))
    return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0, 0)


def _file(rows: ndarray, top: int, height: int, width: int, bits: int, colour: int) -> bytes:
    """The file of filtered ``rows`` that start ``top`` rows down. The empty rows around them are filtered by "none"."""
    before, after = top * rows.shape[1], (height - top - len(rows)) * rows.shape[1]
    compressor = zlib.compressobj(1, zlib.DEFLATED, -15, 9, zlib.Z_RLE)
    middle = compressor.compress(rows.data) + compressor.flush(zlib.Z_FULL_FLUSH)
    checksum = _after_zeros(zlib.adler32(rows.data, _after_zeros(1, before)), after)
    data = b"".join((b"\x78\x01", _zeros(before), middle, _zeros(after), _END, struct.pack(">I", checksum)))
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"".join((_SIGNATURE, _chunk(b"IHDR", header), _chunk(b"IDAT", data), _chunk(b"IEND", b"")))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))


def _after_zeros(adler: int, count: int) -> int:
    """Adler-32 after ``count`` more zero bytes: its first sum stays, its second grows by the first each time."""
    first, second = adler & 0xFFFF, adler >> 16
    return (second + count * first) % _ADLER << 16 | first


@functools.lru_cache(maxsize=1024)
def _zeros(count: int) -> bytes:
    """Deflate blocks of ``count`` zero bytes, on their own: nothing before or after is referred to."""
    if not count:
        return b""
    compressor = zlib.compressobj(1, zlib.DEFLATED, -15, 9, zlib.Z_RLE)
    return compressor.compress(bytes(count)) + compressor.flush(zlib.Z_FULL_FLUSH)
