"""Reads the four Foxglove message types that recordings use (docs.foxglove.dev/docs/sdk/schemas) from protobuf bytes.

The SDK only writes them. Reading four types needs little code, so no protobuf runtime has to be installed.
"""

from __future__ import annotations

import dataclasses
import struct

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.errors import InputError

CALIBRATION, TRANSFORM = "foxglove.CameraCalibration", "foxglove.FrameTransform"
RAW_IMAGE, COMPRESSED_IMAGE = "foxglove.RawImage", "foxglove.CompressedImage"


def _varint(data: bytes, offset: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[offset]
        value |= (byte & 0x7F) << shift
        offset += 1
        if byte < 0x80:
            return value, offset
        shift += 7
        if shift > 63:
            raise ValueError("a number is too long")


def read_fields(data: bytes) -> dict[int, list[int | bytes]]:
    """The values of a message by field number: integers of varints, bytes of everything else.

    Raises:
        InputError: when the bytes are no protobuf message.
    """
    fields: dict[int, list[int | bytes]] = {}
    offset = 0
    try:
        while offset < len(data):
            key, offset = _varint(data, offset)
            kind = key & 7
            if kind == 0:
                value, offset = _varint(data, offset)
            else:
                length, offset = _varint(data, offset) if kind == 2 else ({1: 8, 5: 4}[kind], offset)
                value, offset = data[offset : offset + length], offset + length
                if len(value) != length:
                    raise ValueError("a field ends beyond its message")
            fields.setdefault(key >> 3, []).append(value)
    except (IndexError, KeyError, ValueError):
        raise InputError("the message is damaged: it is not protobuf") from None
    return fields


def _blob(fields: dict[int, list[int | bytes]], number: int) -> bytes:
    value = fields.get(number, [b""])[-1]
    if not isinstance(value, bytes):
        raise InputError("the message is damaged: a field is of another type")
    return value


def _text(fields: dict[int, list[int | bytes]], number: int) -> str:
    return _blob(fields, number).decode("utf-8", "replace")


def _fixed(fields: dict[int, list[int | bytes]], number: int) -> int:
    return int.from_bytes(_blob(fields, number), "little")


def _doubles(fields: dict[int, list[int | bytes]], number: int) -> Float[ndarray, " n"]:
    packed = b"".join(value for value in fields.get(number, []) if isinstance(value, bytes))
    if len(packed) % 8:
        raise InputError("the message is damaged: a list of numbers is cut")
    return np.frombuffer(packed, "<f8").astype(np.float64)


def _time_ns(fields: dict[int, list[int | bytes]], number: int) -> int:
    time = read_fields(_blob(fields, number))
    seconds, nanos = time.get(1, [0])[-1], time.get(2, [0])[-1]
    if not isinstance(seconds, int) or not isinstance(nanos, int):
        raise InputError("the message is damaged: its time is no number")
    return seconds * 10**9 + nanos


@dataclasses.dataclass(frozen=True)
class Image:
    """A RawImage or a CompressedImage. ``size`` is (width, height), or None if the message does not tell it."""

    timestamp_ns: int
    frame_id: str
    format: str
    data: bytes
    size: tuple[int, int] | None = None


def read_image(data: bytes, schema: str) -> Image:
    """Raises InputError when the message is damaged, or a RawImage has rows with padding."""
    fields = read_fields(data)
    if schema == COMPRESSED_IMAGE:
        return Image(_time_ns(fields, 1), _text(fields, 4), _text(fields, 3), _blob(fields, 2))
    width, height, step = _fixed(fields, 2), _fixed(fields, 3), _fixed(fields, 5)
    if step != 2 * width:
        raise InputError(f"an image of {width} columns of 16 bits must have rows of {2 * width} bytes, not {step}")
    return Image(_time_ns(fields, 1), _text(fields, 7), _text(fields, 4), _blob(fields, 6), (width, height))


def image_time_ns(data: bytes) -> int:
    """The timestamp of either type of image, from the first bytes of its message."""
    return _time_ns({1: [data[2 : 2 + data[1]]]}, 1) if data[:1] == b"\x0a" and len(data) > 1 else _time_ns({}, 1)


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """A CameraCalibration."""

    frame_id: str
    width: int
    height: int
    model: str
    distortion: Float[ndarray, " n"]
    matrix: Float[ndarray, "3 3"]


def read_calibration(data: bytes) -> Calibration:
    """Raises InputError when the message is damaged."""
    fields = read_fields(data)
    matrix = _doubles(fields, 6)
    if matrix.size != 9:
        raise InputError(f"a camera's matrix K has 9 numbers, not {matrix.size}")
    return Calibration(
        _text(fields, 9), _fixed(fields, 2), _fixed(fields, 3), _text(fields, 4), _doubles(fields, 5),
        matrix.reshape(3, 3),
    )  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class Transform:
    """A FrameTransform: ``parent_from_child``, its rotation a quaternion x, y, z, w."""

    parent: str
    child: str
    translation: Float[ndarray, "3"]
    rotation: Float[ndarray, "4"]


def read_transform(data: bytes) -> Transform:
    """Raises InputError when the message is damaged. Protobuf leaves out numbers that are zero."""
    fields = read_fields(data)

    def vector(number: int, size: int) -> Float[ndarray, " n"]:
        vector_fields = read_fields(_blob(fields, number))
        values = [vector_fields.get(i + 1, [bytes(8)])[-1] for i in range(size)]
        return np.array([struct.unpack("<d", v)[0] if isinstance(v, bytes) and len(v) == 8 else 0.0 for v in values])

    return Transform(_text(fields, 2), _text(fields, 3), vector(4, 3), vector(5, 4))
