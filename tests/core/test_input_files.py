"""Regular files only: pipes, devices and folders are refused at once."""

import os
from pathlib import Path

import pytest

from depthmocap.core.reading.input_files import check_file, open_file, read_bytes, read_text
from depthmocap.errors import InputError


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "text.txt"
    path.write_bytes(b"\xef\xbb\xbfK\xc3\xbcche\r\nline\rend")
    assert read_text(path) == "Küche\nline\nend"
    with open_file(path) as file:
        assert file.read(3) == b"\xef\xbb\xbf"


def test_what_is_no_file_is_refused_without_waiting(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not found: make one"):
        check_file(tmp_path / "none", "make one")
    with pytest.raises(InputError, match="is a folder"):
        open_file(tmp_path)
    with pytest.raises(InputError, match="cannot be a file's name"):
        check_file(Path("a\0b"))
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(InputError, match="is a pipe"):  # nobody writes to it
            open_file(tmp_path / "pipe")
        with pytest.raises(InputError, match="is a device"):
            read_bytes(Path(os.devnull), 10)


def test_a_file_beyond_its_limit_and_other_encodings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "text.txt"
    path.write_bytes(b"abc\xff")
    assert read_bytes(path, 4) == b"abc\xff"
    with pytest.raises(InputError, match="larger than"):
        read_bytes(path, 3)
    with pytest.raises(InputError, match=r"not text in UTF-8 \(byte 3\)"):
        read_text(path)
