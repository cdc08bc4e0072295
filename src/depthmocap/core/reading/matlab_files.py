"""Reads MATLAB files of users. It measures compressed variables before it unpacks them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any, BinaryIO

from scipy.io import loadmat

from depthmocap.core.reading.input_files import open_file
from depthmocap.errors import InputError

#: Largest total size (bytes) of the unpacked variables of a file.
LARGEST_MAT = 1 << 28
#: Size of the file's header (bytes).
_HEADER = 128
#: Type number of a compressed variable.
_COMPRESSED = 15
#: Size of the pieces (bytes) in which compressed variables are measured.
_PIECE = 1 << 20


def read_mat(path: Path, missing: str = "", **options: Any) -> dict[str, Any]:
    """Read the variables of a MATLAB file by name.

    Args:
        missing: what to do if there is no such file, for the message.
        options: options of SciPy's ``loadmat``.

    Raises:
        InputError: when it cannot be read, is not of version 5 to 7, is damaged, or unpacks to more than
            :data:`LARGEST_MAT`.
    """
    with open_file(path, missing) as file:
        try:
            if not _is_small(file):
                raise InputError(f"{path} unpacks to more than the {LARGEST_MAT / 1e6:.0f} MB that are read")
            file.seek(0)
            return loadmat(file, **options)
        except InputError:
            raise
        except Exception as error:  # SciPy raises many types for damaged files
            reason = (str(error) or type(error).__name__).splitlines()[0]
            raise InputError(
                f"{path} is not a readable MATLAB file (v5 to v7): {reason}; fetch or write it again"
            ) from None


def _is_small(file: BinaryIO) -> bool:
    """Whether the variables of a file are within the size limit; compressed ones are unpacked piece by piece."""
    header = file.read(_HEADER)
    order = "<" if header[126:128] == b"IM" else ">"
    total = 0
    while len(tag := file.read(8)) == 8:
        kind, length = struct.unpack(f"{order}II", tag)
        if kind != _COMPRESSED:
            total += length
            file.seek(length, 1)
        else:
            stream, data = zlib.decompressobj(), b""
            while not stream.eof and total <= LARGEST_MAT:
                if not data:
                    data = file.read(min(_PIECE, length))
                    length -= len(data)
                    if not data:
                        break
                total += len(stream.decompress(data, _PIECE))
                data = stream.unconsumed_tail
            file.seek(length, 1)
        if total > LARGEST_MAT:
            return False
    return True
