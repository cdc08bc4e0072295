"""Arrays: shapes and types are checked before anything is unpacked."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from depthmocap.core.reading.array_files import ArrayType, read_npz
from depthmocap.errors import InputError

WANTED = {"a": ArrayType("n 3", "f"), "b": ArrayType("n", "iu"), "name": ArrayType("", "U")}


def _save(path: Path, **changes: np.ndarray) -> Path:
    arrays = {"a": np.zeros((5, 3)), "b": np.arange(5), "name": np.array("x")} | changes
    np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType] - none is called allow_pickle
    return path


def test_arrays_of_the_wanted_shapes_are_read(tmp_path: Path) -> None:
    path = _save(tmp_path / "a.npz", other=np.zeros(2))
    found = read_npz(path, WANTED)
    assert sorted(found) == ["a", "b", "name"]
    assert found["a"].shape == (5, 3)
    assert str(found["name"]) == "x"


def test_other_shapes_types_and_pickles_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    for changes, told in (
        ({"a": np.zeros((5, 4))}, r"a has the shape \(5, 4\): expected \(5, 3\)"),
        ({"a": np.zeros((4, 3))}, r"b has the shape \(5,\): expected \(4\)"),
        ({"a": np.zeros(())}, "a has the shape"),
        ({"a": np.zeros((5, 3), int)}, "a has the type int64"),
        ({"name": np.array(["x"])}, "name has the shape"),
    ):
        with pytest.raises(InputError, match=told):
            read_npz(_save(path, **changes), WANTED)
    np.savez(path, a=np.array([{}], object))
    with pytest.raises(InputError, match="pickles"):
        read_npz(path, {"a": ArrayType("n", "O")})
    np.savez(path, a=np.zeros((5, 3)))
    with pytest.raises(InputError, match="lacks the array 'b'"):
        read_npz(path, WANTED)


def test_large_arrays_are_not_unpacked(tmp_path: Path) -> None:
    path = _save(tmp_path / "a.npz", a=np.zeros((100_000, 3)), b=np.zeros(100_000, int))
    with pytest.raises(InputError, match="holds 3 MB: at most 2 MB are read"):
        read_npz(path, WANTED, 2_000_000)
    assert len(read_npz(path, {"b": WANTED["b"]}, 2_000_000)["b"]) == 100_000


def test_a_header_that_lies_is_told(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 3)})
    for data, told in ((header.getvalue() + bytes(24), "bytes of data"), (b"\x93NUMPY\x01\x00\xff", "not a readable")):
        path = tmp_path / "a.npz"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("a.npy", data)
        with pytest.raises(InputError, match=told):
            read_npz(path, {"a": ArrayType("n 3", "f")})


def test_damage_anywhere_is_one_line(tmp_path: Path) -> None:
    path = _save(tmp_path / "a.npz", a=np.random.default_rng(0).normal(size=(5, 3)))
    data = path.read_bytes()
    rng = np.random.default_rng(1)
    cuts = [data[:at] for at in (0, 10, len(data) // 2, len(data) - 1)]
    flips = [data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :] for at in rng.integers(0, len(data), 60)]
    for broken in cuts + flips:
        path.write_bytes(broken)
        try:
            read_npz(path, WANTED)  # where the damage does no harm
        except InputError as error:
            assert "\n" not in str(error)
    path.write_bytes(b"\x93NUMPY")
    with pytest.raises(InputError, match=r"not a readable \.npz"):
        read_npz(path, WANTED)
