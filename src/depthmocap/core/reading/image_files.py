"""Reads pictures of users. It checks their size in the header before it unpacks them."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Shaped
from numpy import ndarray
from PIL import Image

from depthmocap.core.reading.input_files import read_bytes
from depthmocap.errors import InputError

#: Largest number of pixels of a picture; depth cameras have about a megapixel.
MOST_PIXELS = 1 << 26
#: Largest size of a picture's file (bytes).
LARGEST_PICTURE = 1 << 28

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_IHDR = struct.Struct(">IIBB")
_KINDS = {0: "grey", 2: "RGB", 3: "palette", 4: "grey and alpha", 6: "RGBA"}
#: Formats that Pillow may read; others of its formats run external programs, or hold many pictures.
_FORMATS = ("PNG", "TIFF", "JPEG", "BMP", "PPM", "WEBP")


class PngHeader(NamedTuple):
    """The header of a PNG: size in pixels, bits per channel, and the channels in words."""

    width: int
    height: int
    bits: int
    kind: str


def check_picture_size(width: int, height: int, where: str) -> None:
    """Raise InputError if a picture has no pixels, or more than the limit.

    Args:
        where: the origin of the picture, for the message.
    """
    if not 0 < width * height <= MOST_PIXELS or min(width, height) < 1:
        raise InputError(
            f"{where} is {width}×{height}: a picture must have at least a pixel and at most {MOST_PIXELS >> 20} million"
        )


def png_header(data: bytes, where: str) -> PngHeader:
    """Read the header of a PNG.

    Raises:
        InputError: when it has none, or :func:`check_picture_size` refuses its size.
    """
    if len(data) < 33 or data[:8] != _SIGNATURE or data[12:16] != b"IHDR":
        raise InputError(_damaged(where))
    width, height, bits, colour = _IHDR.unpack_from(data, 16)
    check_picture_size(width, height, where)
    return PngHeader(width, height, bits, _KINDS.get(colour, "unknown"))


def decode_png(data: bytes, where: str) -> Shaped[ndarray, "h w ..."]:
    """Decode the pixels of a PNG as they are stored, with colours in OpenCV's order.

    Raises:
        InputError: when it is damaged, cut off or too large.
    """
    header = _check_png(data, where)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.shape[:2] != (header.height, header.width):
        raise InputError(_damaged(where))
    return picture


def read_picture(
    path: Path, mode: str | None = None, size: tuple[int, int] | None = None, missing: str = ""
) -> Shaped[ndarray, "h w ..."]:
    """Read the pixels of a picture of any usual format, in its own mode of Pillow.

    Args:
        mode: the required mode of Pillow.
        size: the required width and height.
        missing: what to do if there is no such file, for the message.

    Raises:
        InputError: when it cannot be read, is damaged, cut off, too large, or of another mode or size.
    """
    data = read_bytes(path, LARGEST_PICTURE, missing)
    if data[:8] == _SIGNATURE:
        _check_png(data, str(path))
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
            check_picture_size(image.width, image.height, str(path))
            if (mode or image.mode, size or image.size) != (image.mode, image.size):
                required = [f"{mode} picture" if mode else "picture", f"of {size[0]}×{size[1]}" if size else ""]
                raise InputError(
                    f"{path}: expected a {' '.join(required).strip()}, got {image.mode} {image.width}×{image.height}"
                )
            return np.array(image)
    except InputError:
        raise
    except Exception as error:  # Pillow raises many types for damaged files
        reason = "" if isinstance(error, Image.UnidentifiedImageError) else f" ({error})"
        raise InputError(f"{path} is not a readable picture{reason}: fetch or write it again") from None


def _check_png(data: bytes, where: str) -> PngHeader:
    # Incomplete files never reach a decoder: some fill up the missing part, others write to the terminal.
    header = png_header(data, where)
    if not _is_complete(data):
        raise InputError(_damaged(where))
    return header


def _damaged(where: str) -> str:
    return f"{where} is not a complete PNG: copy or record it again, or delete it"


def _is_complete(data: bytes) -> bool:
    """Whether a PNG has all its chunks up to its end, each with the correct checksum."""
    offset = 8
    while offset + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, offset)
        end = offset + 8 + length
        if end + 4 > len(data):
            return False
        kind = data[offset + 4 : offset + 8]
        if zlib.crc32(memoryview(data)[offset + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return False
        if kind == b"IEND":
            return True
        offset = end + 4
    return False
