"""Records of an MCAP file spoilt, within its chunks and beside them."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from plain_mutations import ODD_WHOLE, ODD_WORDS, Rng, odd_number, pick, spoilt_bytes, spoilt_json


def spoilt_mcap(data: bytes, rng: Rng) -> bytes:
    """A record spoilt, in a chunk or beside it, by bytes or by its texts; lengths fit, and checksums are left out."""
    magic, records = data[:8], _records(data[8:])
    i = int(rng.integers(len(records)))
    chunks = [k for k, (opcode, _) in enumerate(records) if opcode == 6]
    if chunks and rng.random() < 0.8:
        i = pick(chunks, rng)
        records[i] = (6, _spoilt_chunk(records[i][1], rng))
    else:
        records[i] = _spoilt_record(*records[i], rng)
    return magic + _joined(records) + magic


def _records(data: bytes) -> list[tuple[int, bytes]]:
    found, at = [], 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 0x89:  # the magic at the end
            break
        found.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def _joined(records: Sequence[tuple[int, bytes]]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in records)


def _spoilt_chunk(chunk: bytes, rng: Rng) -> bytes:
    start, end, size, _, length = struct.unpack_from("<QQQII", chunk)
    compression = chunk[32 : 32 + length].decode()
    packed = chunk[40 + length :]
    records = _records(_unpacked(compression, packed, size))
    i = int(rng.integers(len(records)))
    if rng.random() < 0.1:
        del records[i]
    else:
        records[i] = _spoilt_record(*records[i], rng)
    plain = _joined(records)
    packed, size = _packed(compression, plain), len(plain)
    if rng.random() < 0.1:
        size = int(pick(ODD_WHOLE, rng))
    if rng.random() < 0.1:
        packed = spoilt_bytes(packed, rng)
    name = compression.encode() if rng.random() < 0.97 else b"x"
    return struct.pack("<QQQII", start, end, size, 0, len(name)) + name + struct.pack("<Q", len(packed)) + packed


def repacked(data: bytes, compression: str) -> bytes:
    """An MCAP file whose chunks are compressed so, without checksums."""
    records = []
    for opcode, content in _records(data[8:]):
        if opcode == 6:
            start, end, size, _, length = struct.unpack_from("<QQQII", content)
            plain = _unpacked(content[32 : 32 + length].decode(), content[40 + length :], size)
            packed, name = _packed(compression, plain), compression.encode()
            head = struct.pack("<QQQII", start, end, len(plain), 0, len(name)) + name
            content = head + struct.pack("<Q", len(packed)) + packed
        records.append((opcode, content))
    return data[:8] + _joined(records) + data[:8]


def _unpacked(compression: str, packed: bytes, size: int) -> bytes:
    if compression == "zstd":
        import zstandard

        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if compression == "lz4":
        import lz4.frame

        return lz4.frame.decompress(packed)
    return packed


def _packed(compression: str, plain: bytes) -> bytes:
    if compression == "zstd":
        import zstandard

        return zstandard.ZstdCompressor().compress(plain)
    if compression == "lz4":
        import lz4.frame

        return lz4.frame.compress(plain)
    return plain


def _spoilt_record(opcode: int, content: bytes, rng: Rng) -> tuple[int, bytes]:
    if rng.random() < 0.03:
        return int(rng.integers(1, 18)), content
    if rng.random() < 0.4:
        return opcode, spoilt_bytes(content, rng)
    if opcode == 5 and rng.random() < 0.5:  # the head of a message: channel, number, times
        head = bytearray(content[:22])
        head[int(rng.choice((0, 6, 14))) :] = odd_number(rng)
        return opcode, bytes(head[:22]).ljust(22, b"\0") + content[22:]
    return opcode, _spoilt_strings(content, rng)


def _spoilt_strings(content: bytes, rng: Rng) -> bytes:
    """A text that stands after its length exchanged for another, and the length with it."""
    texts = [
        (at, length)
        for at in range(len(content) - 4)
        if 0 < (length := int.from_bytes(content[at : at + 4], "little")) < 300
        and at + 4 + length <= len(content)
        and content[at + 4 : at + 4 + length].isascii()
        and content[at + 4 : at + 4 + length].decode().isprintable()
    ]
    if not texts:
        return spoilt_json(content[22:], rng) if content[22:23] == b"{" else spoilt_bytes(content, rng)
    at, length = pick(texts, rng)
    new = str(pick(ODD_WORDS, rng)).encode("utf-8", "surrogatepass")
    changed = content[:at] + struct.pack("<I", len(new)) + new + content[at + 4 + length :]
    # Of a map the length of the whole stands before the texts.
    for back in range(at - 4, max(at - 200, -1), -1):
        whole = int.from_bytes(content[back : back + 4], "little")
        if back + 4 + whole == len(content):
            return changed[:back] + struct.pack("<I", whole + len(new) - length) + changed[back + 4 :]
    return changed
