"""Lossless coding of depth pictures for recordings.

``delta-zstd`` is the default, by measurement (docs/results/speed.md). It subtracts from every pixel its left neighbour,
maps the signed differences to unsigned numbers (zigzag), separates low and high bytes, and compresses them with
Zstandard. The high bytes are nearly all zero; the low bytes hold the sensor's noise, which no coding can shrink.
``png`` and ``raw`` are larger, but any viewer shows them.
"""

from __future__ import annotations

import functools
import struct
import threading
from typing import Any, Literal, get_args

import cv2
import numpy as np
from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.core.reading.image_files import check_picture_size, decode_png, png_header
from depthmocap.errors import InputError, missing_extra
from depthmocap.kernels.depth_planes import split_differences

Coding = Literal["delta-zstd", "png", "raw"]
CODINGS: tuple[Coding, ...] = get_args(Coding)

#: Width and height at the beginning of a delta-zstd picture.
_SIZE = struct.Struct("<II")
#: Zstandard's fastest strategy, with a window that holds all bytes of a Kinect 2's picture (logarithm of bytes),
_WINDOW_LOG = 19
#: a table of so few places (their logarithm) that it stays in the fastest cache: noise repeats nothing,
_HASH_LOG = 8
#: and the longest least match (bytes). Higher levels gain little on noise, and lower ones do not code it at all.
_LEAST_MATCH = 7
_PNG_OPTIONS = [
    cv2.IMWRITE_PNG_COMPRESSION, 1,
    cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
    cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP,
]  # fmt: skip
_local = threading.local()  # one thread at a time may use one of the library's objects


@functools.cache
def _zstandard() -> Any:
    try:
        import zstandard
    except ModuleNotFoundError:
        raise missing_extra("zstandard", "record") from None
    return zstandard


def encode_depth(raw: UInt16[ndarray, "h w"], coding: Coding = "delta-zstd") -> bytes:
    """The coded picture. ``delta-zstd`` begins with the width and the height, ``raw`` has no header."""
    if coding == "raw":
        return raw.astype("<u2").tobytes()
    if coding == "png":
        done, data = cv2.imencode(".png", np.ascontiguousarray(raw), _PNG_OPTIONS)
        assert done
        return data.tobytes()
    planes = np.empty((2, *raw.shape), np.uint8)
    split_differences(np.ascontiguousarray(raw, np.uint16), planes[0], planes[1])
    height, width = raw.shape
    return _SIZE.pack(width, height) + _compressor().compress(planes.data)


def _compressor() -> Any:
    """This thread's compressor."""
    compressor = getattr(_local, "compressor", None)
    if compressor is None:
        zstandard = _zstandard()
        parameters = zstandard.ZstdCompressionParameters(
            window_log=_WINDOW_LOG, hash_log=_HASH_LOG, chain_log=_HASH_LOG, search_log=1, min_match=_LEAST_MATCH,
            target_length=0, strategy=zstandard.STRATEGY_FAST, write_content_size=True,
        )  # fmt: skip
        compressor = _local.compressor = zstandard.ZstdCompressor(compression_params=parameters)
    return compressor


def decode_depth(data: bytes, coding: str, size: tuple[int, int] | None = None) -> UInt16[ndarray, "h w"]:
    """Decode a picture.

    Args:
        size: (width, height). ``raw`` needs it; pictures of other codings must have it if it is given.

    Raises:
        InputError: when the data are damaged, of another size, or of an unknown coding.
    """
    if coding == "raw":
        assert size is not None
        if len(data) != 2 * size[0] * size[1]:
            raise InputError(f"a raw picture of {size[0]}×{size[1]} has {2 * size[0] * size[1]} bytes, not {len(data)}")
        return np.frombuffer(data, "<u2").astype(np.uint16).reshape(size[1], size[0])
    if coding == "png":
        header = png_header(data, "the picture")
        _check_size((header.width, header.height), size)
        picture = decode_png(data, "the picture")
        if picture.dtype != np.uint16 or picture.ndim != 2:
            raise InputError(f"the picture is {header.bits}-bit {header.kind}: depth must be 16-bit grey")
    elif coding == "delta-zstd":
        picture = _decode_delta(data, size)
    else:
        raise InputError(f"the coding {coding!r} is not known: expected one of {', '.join(CODINGS)}")
    return picture


class SwappedSizeError(InputError):
    """A picture's width is the camera's height, and its height the width."""


def _check_size(actual_size: tuple[int, int], camera_size: tuple[int, int] | None) -> None:
    if camera_size is not None and actual_size != camera_size:
        raise (SwappedSizeError if actual_size == camera_size[::-1] else InputError)(
            f"the picture is {actual_size[0]}×{actual_size[1]}, but its camera {camera_size[0]}×{camera_size[1]}"
        )


def _decode_delta(data: bytes, size: tuple[int, int] | None) -> UInt16[ndarray, "h w"]:
    width, height = _SIZE.unpack_from(data) if len(data) > _SIZE.size else (0, 0)
    check_picture_size(width, height, "the picture is damaged: it")
    _check_size((width, height), size)
    zstandard = _zstandard()
    decompressor = getattr(_local, "decompressor", None)
    if decompressor is None:
        decompressor = _local.decompressor = zstandard.ZstdDecompressor()
    try:
        # The library allocates as much memory as the data claim, so their claim is checked first.
        if zstandard.frame_content_size(data[_SIZE.size :]) != 2 * width * height:
            raise InputError("the picture is damaged: its data are of another size than it says")
        planes = np.frombuffer(decompressor.decompress(data[_SIZE.size :]), np.uint8).reshape(2, height, width)
    except zstandard.ZstdError as error:
        raise InputError(f"the picture is damaged: {error}") from None
    folded = planes[0] | (planes[1].astype(np.uint16) << 8)
    delta = (folded >> 1) ^ -(folded & 1)
    return np.cumsum(delta, axis=1, dtype=np.uint16)
