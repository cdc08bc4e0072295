"""What files hold, to compare data sets by. ISA-L does not always pack the same picture into the same bytes."""

from __future__ import annotations

import io
import tarfile
import zlib
from pathlib import Path

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def tree(folder: Path) -> dict[str, bytes]:
    """Files of a folder by name, those in a shard by the shard's name and their own; pictures unpacked."""
    found: dict[str, bytes] = {}
    for path in folder.rglob("*"):
        if path.is_file():
            found |= contents(path, str(path.relative_to(folder)))
    return found


def contents(path: Path, name: str = "") -> dict[str, bytes]:
    """A file, or the files in a shard; pictures unpacked."""
    data = path.read_bytes()
    if path.suffix != ".tar":
        return {name: _unpacked(data)}
    with tarfile.open(fileobj=io.BytesIO(data)) as shard:
        # Of a member's header all but its size, which is that of the packed picture.
        return {
            f"{name}/{member.name} {member.mode:o} {member.mtime} {member.uid}": _unpacked(file.read())
            for member in shard
            if (file := shard.extractfile(member)) is not None
        }


def _unpacked(data: bytes) -> bytes:
    """A PNG with its pixels' stream unpacked, as filtered rows; anything else as it is."""
    if not data.startswith(_SIGNATURE):
        return data
    place, header, stream = len(_SIGNATURE), b"", b""
    while place < len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        kind, body = data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
        assert int.from_bytes(data[place + 8 + length : place + 12 + length], "big") == zlib.crc32(kind + body)
        if kind == b"IDAT":
            stream += body
        else:
            header += kind + body
        place += 12 + length
    return header + zlib.decompress(stream)
