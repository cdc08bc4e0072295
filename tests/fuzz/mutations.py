"""Files spoilt at random: by bytes, by words, and by what their format is made of, with sizes and checksums put right
again, so that readers are reached behind their first checks. A generator's state decides all, so that a seed and a
number make the same file again."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import re
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Rng = np.random.Generator
Mutation = Callable[[bytes, Rng], bytes]

_ODD_WORDS = (
    *("", "0", "-0", "-1", "1", "nan", "NaN", "-Infinity", "inf", "1e400", "1e-320", "1e308", "0.5", "9" * 20),
    *("true", "null", '""', '"x"', "x", "[]", "{}", "[", "}", ":", ",", "..", "/", "\\", "CON", "\0", "\x1b[31m"),
    *("[/x]", "$\\frac{$", "<b>", "\u202e", "é", "٣", "1_000", "0x10", "1,5", "-", "+", ".", "e", "\r", "\n\n"),
    *("\ufeff", "9" * 5000, "[" * 3000, "{" * 3000, "a" * 3000),
)  # fmt: skip
_ODD_VALUES = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, 10**30, 10**400, -0.0, 0.5, 1e308, 1e-320, float("nan")),
    *(float("inf"), "", "x", "0.001", "..", "a/b", "\ud800", "\0", "[/x]", "\x1b[31m", "$\\frac{$", "x" * 3000),
    *([], [[]], {}, [0], [None], [1e308]),
)  # fmt: skip
_ODD_WHOLE = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1)
_ODD_REAL = (0.0, -0.0, -1.0, 0.5, 1e-320, 1e-9, 1e9, 1e308, float("nan"), float("inf"), float("-inf"))
_WORD = re.compile(r'"[^"\n]*"|[-+.\w]+|[^\s\w]')


def spoilt(path: Path, data: bytes, rng: Rng) -> bytes:
    """The file's bytes, spoilt in one way or a few that its name's ending allows."""
    own = _BY_ENDING.get(path.suffix.lower(), ())
    for _ in range(int(rng.choice((1, 1, 1, 2, 3)))):
        ways = (*own, *own, spoilt_bytes) if own else (spoilt_bytes,)
        with contextlib.suppress(Exception):  # what an earlier way has spoilt cannot always be taken apart again
            data = _pick(ways, rng)(data, rng)
    return data


def _pick(choices: Sequence[Any], rng: Rng) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _place(length: int, rng: Rng) -> int:
    """Somewhere in a file; at its beginning as often as anywhere."""
    return int(rng.integers(max(min(length, 400) if rng.random() < 0.5 else length, 1)))


def spoilt_bytes(data: bytes, rng: Rng) -> bytes:
    """A few bytes changed, and pieces cut out, repeated, or put in."""
    held = bytearray(data)
    at, length = _place(len(held), rng), int(rng.choice((1, 2, 4, 8, 30, 300)))
    match int(rng.integers(8)):
        case 0 if held:
            held[at] ^= 1 << int(rng.integers(8))
        case 1 if held:
            held[at] = int(rng.choice((0, 1, 0x20, 0x7F, 0x80, 0xFF)))
        case 2 | 3:
            held[at : at + 8] = _odd_number(rng)[: len(held) - at]
        case 4:
            del held[at : at + length]
        case 5:
            held[at:at] = held[at : at + length] * int(rng.choice((1, 2, 50)))
        case 6:
            held[at:at] = rng.bytes(length)
        case _:
            del held[at:]
    return bytes(held)


def _odd_number(rng: Rng) -> bytes:
    order = _pick("<>", rng)
    form = _pick("BHIQfd", rng)
    if form in "fd":
        value = min(_pick(_ODD_REAL, rng), 3e38) if form == "f" else _pick(_ODD_REAL, rng)
        return struct.pack(order + form, value)
    size = struct.calcsize(form)
    return int(_pick(_ODD_WHOLE, rng) & (2 ** (8 * size) - 1)).to_bytes(size, "little" if order == "<" else "big")


def spoilt_text(data: bytes, rng: Rng) -> bytes:
    """A word or a line exchanged, repeated or left out."""
    text = data.decode("utf-8", "surrogateescape")
    if rng.random() < 0.3:
        lines = text.split("\n")
        row = int(rng.integers(len(lines)))
        match int(rng.integers(4)):
            case 0:
                del lines[row]
            case 1:
                lines.insert(row, lines[row])
            case 2:
                lines[row] = lines[int(rng.integers(len(lines)))]
            case _:
                lines = lines[:row]
        return "\n".join(lines).encode("utf-8", "surrogateescape")
    words = list(_WORD.finditer(text))
    if not words:
        return data
    word = _pick(words, rng)
    new = _pick(words, rng)[0] if rng.random() < 0.2 else _pick(_ODD_WORDS, rng)
    start = word.end() if rng.random() < 0.2 else word.start()
    return (text[:start] + new + text[word.end() :]).encode("utf-8", "surrogateescape")


def spoilt_json(data: bytes, rng: Rng) -> bytes:
    """A value of a document exchanged, repeated, put deeper or left out."""
    document = [json.loads(data)]  # so that the whole can be exchanged too
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(document)
    node, key = _pick(places, rng)
    match int(rng.integers(8)):
        case 0 if node is not document:
            del node[key]
        case 1:
            other, its = _pick(places, rng)
            node[key] = copy.deepcopy(other[its])
        case 2:
            for _ in range(int(rng.choice((1, 70, 300)))):
                node[key] = [node[key]]
        case 3 if isinstance(node, dict):
            node[str(_pick(_ODD_WORDS, rng))] = node.pop(key)
        case 4 if isinstance(node[key], list):
            node[key] = node[key] * 2 if rng.random() < 0.5 else node[key][:-1]
        case 5 if isinstance(node[key], int | float):
            node[key] = node[key] * float(_pick((-1, 0, 1e-9, 1e9, 1e200), rng))
        case _:
            node[key] = _pick(_ODD_VALUES, rng)
    return json.dumps(document[0]).encode()


def spoilt_npz(data: bytes, rng: Rng) -> bytes:
    """An array of another shape or type, with odd values, of another name, or absent; or a header that lies."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = _pick(list(arrays), rng)
    array, held = arrays[name], io.BytesIO()
    match int(rng.integers(9)):
        case 0:
            del arrays[name]
        case 1:
            arrays[str(_pick(list(arrays), rng))] = array
        case 2:
            flat = array.reshape(-1)
            arrays[name] = _pick((array[None], flat, flat[:0], array.T, flat[:1]), rng)
        case 3:
            arrays[name] = array.reshape(-1)[: max(array.size // 2, 1)] if array.ndim else array[None]
        case 4:
            with np.errstate(all="ignore"):
                arrays[name] = array.astype(_pick(("f2", "f4", "f8", "i1", "i8", "u1", "?", "U3", "S2", "c8"), rng))
        case 5:
            arrays[name] = np.array(_pick((0, -1, np.nan, "x", "[]", "[" * 3000, True, [], b"\xff"), rng))
        case 6 if array.size and array.dtype.kind in "fiu":
            flat = array.ravel().copy()
            odd = _pick(_ODD_REAL, rng) if array.dtype.kind == "f" else _pick((0, -1, 127, 10**4), rng)
            with np.errstate(all="ignore"):
                flat[int(rng.integers(len(flat)))] = np.float64(odd).astype(array.dtype)
            arrays[name] = flat.reshape(array.shape)
        case 7:
            arrays[name] = np.array([{}, []], object)
        case _:
            shape = _pick(((10**9,), (2**40,), (-1,), (0,), (10**6, 10**6, 10**6), (1,) * 40), rng)
            lie = io.BytesIO()
            np.lib.format.write_array_header_1_0(lie, {"descr": "<f8", "fortran_order": False, "shape": shape})
            with zipfile.ZipFile(held, "w") as archive:
                for each, value in arrays.items():
                    whole = io.BytesIO()
                    np.lib.format.write_array(whole, value)
                    archive.writestr(f"{each}.npy", lie.getvalue() + bytes(64) if each == name else whole.getvalue())
            return held.getvalue()
    np.savez_compressed(held, **arrays)
    return held.getvalue()


def spoilt_zip(data: bytes, rng: Rng) -> bytes:
    """A member of an archive spoilt, of another name, or absent; checksums fit."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = _pick(list(members), rng)
    content = members.pop(name)
    if rng.random() < 0.8:
        members[name] = spoilt(Path(name), content, rng)
    elif rng.random() < 0.5:
        members[str(_pick(list(members) or ["x"], rng))] = content
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        for each, value in members.items():
            archive.writestr(each, value)
    return held.getvalue()


def spoilt_png(data: bytes, rng: Rng) -> bytes:
    """A chunk of a PNG spoilt, repeated or left out, or its pixels packed anew; checksums fit."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    i = int(rng.integers(len(chunks)))
    kind, content = chunks[i]
    match int(rng.integers(6)):
        case 0:
            del chunks[i]
        case 1:
            chunks.insert(i, chunks[i])
        case 2 | 3 if chunks[0][0] == b"IHDR" and len(chunks[0][1]) == 13:
            header = list(struct.unpack(">IIBBBBB", chunks[0][1]))
            field = int(rng.integers(len(header)))
            header[field] = int(_pick((0, 1, 2, 3, 4, 6, 8, 16, 255, *((30000, 2**31 - 1) if field < 2 else ())), rng))
            chunks[0] = (b"IHDR", struct.pack(">IIBBBBB", *header))
        case 4:
            pixels = zlib.decompress(b"".join(content for kind, content in chunks if kind == b"IDAT"))
            first = next(i for i, (kind, _) in enumerate(chunks) if kind == b"IDAT")
            chunks = [chunk for chunk in chunks if chunk[0] != b"IDAT"]
            chunks.insert(first, (b"IDAT", zlib.compress(spoilt_bytes(pixels, rng))))
        case _:
            chunks[i] = (kind, spoilt_bytes(content, rng))
    whole = [struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks]
    return data[:8] + b"".join(whole)


def spoilt_tar(data: bytes, rng: Rng) -> bytes:
    """A member of an archive spoilt, of another name, repeated or absent; checksums fit."""
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        members = [(each.name, file.read()) for each in archive if (file := archive.extractfile(each)) is not None]
    i = int(rng.integers(len(members)))
    name, content = members[i]
    match int(rng.integers(6)):
        case 0:
            del members[i]
        case 1:
            members.insert(i, members[int(rng.integers(len(members)))])
        case 2:
            members[i] = (_pick(("x", "..", "000000000.json", name + "x", name.replace("cam1", "cam9")), rng), content)
        case _:
            members[i] = (name, spoilt(Path(name), content, rng))
    held = io.BytesIO()
    with tarfile.open(fileobj=held, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in members:
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return held.getvalue()


def spoilt_safetensors(data: bytes, rng: Rng) -> bytes:
    """The header spoilt, its length right."""
    (length,) = struct.unpack_from("<Q", data)
    header = spoilt_json(data[8 : 8 + length], rng)
    return struct.pack("<Q", len(header)) + header + data[8 + length :]


def spoilt_hdf5(data: bytes, rng: Rng) -> bytes:
    """A data set of another shape or type, with odd values, in place of a group, or absent."""
    import h5py

    held = io.BytesIO(data)
    with h5py.File(held, "r+") as file:
        name = _pick(list(file), rng)
        stored = file[name]
        assert isinstance(stored, h5py.Dataset)
        values = stored[()]
        del file[name]
        match int(rng.integers(6)):
            case 0:
                pass
            case 1:
                file.create_group(name)
            case 2:
                others = (values[:0], values[:1], values[None], values.ravel(), np.array(1.0), np.array(b"x"))
                file[name] = _pick(others, rng)
            case 3:
                file[name] = np.array([b"x", b""]) if values.dtype.kind != "S" else np.arange(len(values))
            case 4 if values.dtype.kind != "S":
                file[name] = values.astype(_pick(("f2", "f4", "f8", "i1", "i8", "u1", "c8"), rng))
            case _ if values.dtype.kind == "f":
                values.ravel()[int(rng.integers(values.size))] = _pick(_ODD_REAL, rng)
                file[name] = values
            case _:
                file[name] = np.roll(values, 1)
    return held.getvalue()


def spoilt_mcap(data: bytes, rng: Rng) -> bytes:
    """A record spoilt, in a chunk or beside it, by bytes or by its texts; lengths fit, and checksums are left out."""
    magic, records = data[:8], _records(data[8:])
    i = int(rng.integers(len(records)))
    chunks = [k for k, (opcode, _) in enumerate(records) if opcode == 6]
    if chunks and rng.random() < 0.8:
        i = _pick(chunks, rng)
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
        size = int(_pick(_ODD_WHOLE, rng))
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
        head[int(rng.choice((0, 6, 14))) :] = _odd_number(rng)
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
    at, length = _pick(texts, rng)
    new = str(_pick(_ODD_WORDS, rng)).encode("utf-8", "surrogatepass")
    changed = content[:at] + struct.pack("<I", len(new)) + new + content[at + 4 + length :]
    # Of a map the length of the whole stands before the texts.
    for back in range(at - 4, max(at - 200, -1), -1):
        whole = int.from_bytes(content[back : back + 4], "little")
        if back + 4 + whole == len(content):
            return changed[:back] + struct.pack("<I", whole + len(new) - length) + changed[back + 4 :]
    return changed


_BY_ENDING: dict[str, tuple[Mutation, ...]] = {
    ".json": (spoilt_json, spoilt_text),
    **dict.fromkeys((".csv", ".bvh", ".asf", ".amc", ".yml", ".txt", ".trc", ".spec"), (spoilt_text,)),
    ".npz": (spoilt_npz,),
    ".pt": (spoilt_zip,),
    ".png": (spoilt_png,),
    ".tar": (spoilt_tar,),
    ".safetensors": (spoilt_safetensors,),
    ".h5": (spoilt_hdf5,),
    ".mcap": (spoilt_mcap,),
}
