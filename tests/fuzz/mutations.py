"""Files spoilt at random: by bytes, by words, and by what their format is made of, with sizes and checksums put right
again, so that readers are reached behind their first checks. A generator's state decides all, so that a seed and a
number make the same file again."""

from __future__ import annotations

import contextlib
import io
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap_mutations import spoilt_mcap
from plain_mutations import ODD_REAL, Rng, pick, spoilt_bytes, spoilt_json, spoilt_text

Mutation = Callable[[bytes, Rng], bytes]


def spoilt(path: Path, data: bytes, rng: Rng) -> bytes:
    """The file's bytes, spoilt in one way or a few that its name's ending allows."""
    own = _BY_ENDING.get(path.suffix.lower(), ())
    for _ in range(int(rng.choice((1, 1, 1, 2, 3)))):
        ways = (*own, *own, spoilt_bytes) if own else (spoilt_bytes,)
        with contextlib.suppress(Exception):  # what an earlier way has spoilt cannot always be taken apart again
            data = pick(ways, rng)(data, rng)
    return data


def spoilt_npz(data: bytes, rng: Rng) -> bytes:
    """An array of another shape or type, with odd values, of another name, or absent; or a header that lies."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = pick(list(arrays), rng)
    array, held = arrays[name], io.BytesIO()
    match int(rng.integers(9)):
        case 0:
            del arrays[name]
        case 1:
            arrays[str(pick(list(arrays), rng))] = array
        case 2:
            flat = array.reshape(-1)
            arrays[name] = pick((array[None], flat, flat[:0], array.T, flat[:1]), rng)
        case 3:
            arrays[name] = array.reshape(-1)[: max(array.size // 2, 1)] if array.ndim else array[None]
        case 4:
            with np.errstate(all="ignore"):
                arrays[name] = array.astype(pick(("f2", "f4", "f8", "i1", "i8", "u1", "?", "U3", "S2", "c8"), rng))
        case 5:
            arrays[name] = np.array(pick((0, -1, np.nan, "x", "[]", "[" * 3000, True, [], b"\xff"), rng))
        case 6 if array.size and array.dtype.kind in "fiu":
            flat = array.ravel().copy()
            odd = pick(ODD_REAL, rng) if array.dtype.kind == "f" else pick((0, -1, 127, 10**4), rng)
            with np.errstate(all="ignore"):
                flat[int(rng.integers(len(flat)))] = np.float64(odd).astype(array.dtype)
            arrays[name] = flat.reshape(array.shape)
        case 7:
            arrays[name] = np.array([{}, []], object)
        case _:
            shape = pick(((10**9,), (2**40,), (-1,), (0,), (10**6, 10**6, 10**6), (1,) * 40), rng)
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
    name = pick(list(members), rng)
    content = members.pop(name)
    if rng.random() < 0.8:
        members[name] = spoilt(Path(name), content, rng)
    elif rng.random() < 0.5:
        members[str(pick(list(members) or ["x"], rng))] = content
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
            header[field] = int(pick((0, 1, 2, 3, 4, 6, 8, 16, 255, *((30000, 2**31 - 1) if field < 2 else ())), rng))
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
            members[i] = (pick(("x", "..", "000000000.json", name + "x", name.replace("cam1", "cam9")), rng), content)
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
        name = pick(list(file), rng)
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
                file[name] = pick(others, rng)
            case 3:
                file[name] = np.array([b"x", b""]) if values.dtype.kind != "S" else np.arange(len(values))
            case 4 if values.dtype.kind != "S":
                file[name] = values.astype(pick(("f2", "f4", "f8", "i1", "i8", "u1", "c8"), rng))
            case _ if values.dtype.kind == "f":
                values.ravel()[int(rng.integers(values.size))] = pick(ODD_REAL, rng)
                file[name] = values
            case _:
                file[name] = np.roll(values, 1)
    return held.getvalue()


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
