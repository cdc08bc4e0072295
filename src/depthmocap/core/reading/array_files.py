"""Arrays in .npz files that users give. Shapes and types are read from the headers before anything is unpacked; pickles
are refused."""

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

#: Bytes of all arrays that are read of one file.
LARGEST_ARRAYS = 1 << 29
#: By the version of the format.
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@dataclasses.dataclass(frozen=True)
class ArrayType:
    """What an array must be.

    Attributes:
        shape: its sides in words, such as ``"n 20 3"``: a name stands for any length, the same in all arrays of a file.
        kinds: NumPy's letters for types that it may have, such as ``"iu"``.
    """

    shape: str
    kinds: str


def check_type(shape: tuple[int, ...], dtype: Any, wanted: ArrayType, sides: dict[str, int], what: str) -> None:
    """See that an array's header is as wanted.

    Args:
        sides: lengths by name, as far as they are known; new ones are added.
        what: the array is, for the message.

    Raises:
        InputError: when it is not.
    """
    if dtype.kind not in wanted.kinds or dtype.hasobject:
        raise InputError(f"{what} has the type {dtype}: expected one of the kinds {', '.join(wanted.kinds)}")
    names = wanted.shape.split()
    fits = len(names) == len(shape) and all(
        length == (int(name) if name.isdecimal() else sides.setdefault(name, length))
        for name, length in zip(names, shape, strict=True)
    )
    if not fits:
        expected = ", ".join(str(sides.get(name, name)) for name in names)
        raise InputError(f"{what} has the shape {shape}: expected ({expected})")


def read_npz(path: Path, wanted: Mapping[str, ArrayType], largest: int = LARGEST_ARRAYS) -> dict[str, ndarray]:
    """Arrays of an .npz file by name; all must be there, and others are left alone.

    Args:
        wanted: types by name.
        largest: bytes that all of them may have.

    Raises:
        InputError: when the file cannot be read or is another kind of file, is damaged, holds pickles, lacks an array,
            or has one of another shape or type or more than may be.
    """
    with open_file(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                return _read(archive, path, wanted, largest)
        except InputError:
            raise
        except Exception as error:  # zipfile and NumPy raise many types for damaged files
            raise InputError(f"{path} is not a readable .npz file, or cut off: {_line(error)}") from None


def _read(archive: zipfile.ZipFile, path: Path, wanted: Mapping[str, ArrayType], largest: int) -> dict[str, ndarray]:
    members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    if absent := [name for name in wanted if name not in members]:
        raise InputError(f"{path} lacks the array {absent[0]!r}")
    if (total := sum(members[name].file_size for name in wanted)) > largest:
        raise InputError(f"{path} holds {total / 1e6:,.0f} MB: at most {largest / 1e6:,.0f} MB are read")
    sides: dict[str, int] = {}
    for name, kind in wanted.items():
        check_type(*_header(archive, members[name], f"{path}: {name}"), kind, sides, f"{path}: {name}")
    arrays = {}
    for name in wanted:
        with archive.open(members[name]) as member:
            arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
            member.read(1)  # past the last byte, where the checksum is compared
    return arrays


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo, what: str) -> tuple[tuple[int, ...], Any]:
    """Shape and type of an array, if its data are as long as they say."""
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


def why(error: InputError, path: Path) -> str:
    """What an error says of a file, for a message that names it already."""
    return str(error).removeprefix(f"{path}: ").removeprefix(f"{path} ")
