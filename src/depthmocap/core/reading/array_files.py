"""Reads arrays from .npz files of users. It checks shapes and types in the headers before it unpacks anything, and
refuses pickles."""

from __future__ import annotations

import dataclasses
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from depthmocap.core.reading.input_files import open_file
from depthmocap.errors import InputError

#: Largest total size (bytes) of the arrays that are read from one file.
LARGEST_ARRAYS = 1 << 29
#: Functions that read headers, by version of the format.
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@dataclasses.dataclass(frozen=True)
class ArrayType:
    """The expected shape and type of an array.

    Attributes:
        shape: the lengths of its axes, such as ``"n 20 3"``; a name means any length, the same in all arrays of a file.
        kinds: NumPy's letters of the allowed kinds of type, such as ``"iu"``.
    """

    shape: str
    kinds: str


def check_type(shape: tuple[int, ...], dtype: Any, expected: ArrayType, sides: dict[str, int], what: str) -> None:
    """Check an array's header.

    Args:
        sides: known lengths by name; new ones are added.
        what: the name of the array, for the message.

    Raises:
        InputError: when its shape or type differs from the expected one.
    """
    if dtype.kind not in expected.kinds or dtype.hasobject:
        raise InputError(f"{what} has the type {dtype}: expected one of the kinds {', '.join(expected.kinds)}")
    names = expected.shape.split()
    fits = len(names) == len(shape) and all(
        length == (int(name) if name.isdecimal() else sides.setdefault(name, length))
        for name, length in zip(names, shape, strict=True)
    )
    if not fits:
        lengths = ", ".join(str(sides.get(name, name)) for name in names)
        raise InputError(f"{what} has the shape {shape}: expected ({lengths})")


def read_npz(
    path: Path,
    expected: Mapping[str, ArrayType],
    largest: int = LARGEST_ARRAYS,
    optional: Mapping[str, ArrayType] | None = None,
) -> dict[str, ndarray]:
    """Read arrays of an .npz file by name. All that are expected must exist; other arrays are not read.

    Args:
        expected: types by name.
        optional: the same of arrays that a file may lack.
        largest: largest total size in bytes.

    Raises:
        InputError: when the file cannot be read, is of another kind, is damaged, holds pickles, lacks an array, has an
            array of another shape or type, or is too large.
    """
    with open_file(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                return _read(archive, path, expected, optional or {}, largest)
        except InputError:
            raise
        except Exception as error:  # zipfile and NumPy raise many types for damaged files
            raise InputError(f"{path} is not a readable .npz file, or cut off: {_line(error)}") from None


def _read(
    archive: zipfile.ZipFile,
    path: Path,
    expected: Mapping[str, ArrayType],
    optional: Mapping[str, ArrayType],
    largest: int,
) -> dict[str, ndarray]:
    members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    if absent := [name for name in expected if name not in members]:
        raise InputError(f"{path} lacks the array {absent[0]!r}")
    expected = {**expected, **{name: kind for name, kind in optional.items() if name in members}}
    if (total := sum(members[name].file_size for name in expected)) > largest:
        raise InputError(f"{path} holds {total / 1e6:,.0f} MB: at most {largest / 1e6:,.0f} MB are read")
    sides: dict[str, int] = {}
    for name, kind in expected.items():
        check_type(*_header(archive, members[name], f"{path}: {name}"), kind, sides, f"{path}: {name}")
    arrays = {}
    for name in expected:
        with archive.open(members[name]) as member:
            arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
            member.read(1)  # zipfile compares the checksum only at the end
    return arrays


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo, what: str) -> tuple[tuple[int, ...], Any]:
    """Shape and type of an array whose data have the length that they require."""
    with archive.open(info) as member:
        read = _HEADERS[np.lib.format.read_magic(member)]
        shape, _, dtype = read(member)
        start = member.tell()
    if dtype.hasobject:
        raise InputError(f"{what} holds Python objects (pickles), which are not read")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != info.file_size - start:
        raise InputError(f"{what} has {info.file_size - start:,} bytes of data, which its shape {shape} has not")
    return shape, dtype


def _line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


def error_reason(error: InputError, path: Path) -> str:
    """The text of an error without the name of the file, for a message that names it already."""
    return str(error).removeprefix(f"{path}: ").removeprefix(f"{path} ")
