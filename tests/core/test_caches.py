"""Caches of libraries that cannot be written: a temporary one takes their place, and one line tells it."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import depthmocap
from depthmocap.core.caches import ensure_home
from depthmocap.errors import InputError

_KERNEL = """
import os, sys
from pathlib import Path
import numpy as np
from depthmocap.kernels.skin import skin

out = np.zeros((1, 3), np.float32)
one = np.ones((1, 3), np.float32)
skin(one, np.zeros((1, 1), np.int32), np.ones((1, 1), np.float32), np.eye(3)[None], np.zeros((1, 3)), out)
assert (out == 1).all()
cache = Path(os.environ["NUMBA_CACHE_DIR"])
assert any(cache.rglob("*.nbc"))
print(cache)
"""


@pytest.fixture
def nowhere(tmp_path: Path) -> Path:
    """A folder that even a superuser cannot make."""
    (tmp_path / "file").touch()
    return tmp_path / "file" / "folder"


def _run(code: str, folder: Path, home: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run code with a package in which nothing can be kept: all of ours, by links."""
    package = Path(depthmocap.__file__).parent
    kernels = folder / "depthmocap" / "kernels"
    kernels.mkdir(parents=True)
    for each in package.iterdir():
        if each.name != "kernels":
            (kernels.parent / each.name).symlink_to(each)
    for each in (package / "kernels").glob("*.py"):
        (kernels / each.name).symlink_to(each)
    (kernels / "__pycache__").touch()
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "NUMBA_", "COVERAGE_"))}
    environment = kept | {"PYTHONPATH": str(folder), "HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"} | variables
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, encoding="utf-8", check=False
    )


def test_kernels_without_a_cache(tmp_path: Path, nowhere: Path) -> None:
    done = _run(_KERNEL, tmp_path, nowhere)
    assert done.returncode == 0, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "set NUMBA_CACHE_DIR to a folder that lasts" in done.stderr
    assert not Path(done.stdout.strip()).exists()  # it ended with the process


@pytest.mark.skipif(sys.platform != "linux", reason="needs limits of the size of files")
def test_a_cache_without_room(tmp_path: Path) -> None:
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    kept = _KERNEL.replace("assert any", "assert not any")
    done = _run(limited + kept, tmp_path, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert done.returncode == 0, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert f"Numba cannot keep what it compiles in {tmp_path / 'cache'}" in done.stderr


def test_no_temporary_folder_either(tmp_path: Path, nowhere: Path) -> None:
    code = "import sys, tempfile; tempfile.tempdir = sys.argv[0] + '/none'; from depthmocap.kernels import skin"
    done = _run(code, tmp_path, nowhere)
    assert done.returncode == 1
    assert "nor a temporary folder: set NUMBA_CACHE_DIR to a folder that can be written" in done.stderr


def test_bodies_without_a_cache(body_model, nowhere: Path, tmp_path: Path, monkeypatch, caplog) -> None:
    from anny import paths

    lasts = paths.get_anny_cache_path()
    (tmp_path / "anny_cache_dir").symlink_to(lasts)  # so that it need not be filled, which takes a minute
    monkeypatch.setattr("depthmocap.core.caches._folder", lambda: tmp_path)
    monkeypatch.setenv("ANNY_CACHE_DIR", str(nowhere))
    paths.set_anny_cache_path(nowhere)
    try:
        again = type(body_model).load.__wrapped__(type(body_model))
    finally:
        paths.set_anny_cache_path(lasts)
    np.testing.assert_array_equal(again.faces, body_model.faces)
    assert os.environ["ANNY_CACHE_DIR"] == str(tmp_path / "anny_cache_dir")
    assert [each.message for each in caplog.records if each.levelno >= logging.WARNING] == [
        f"Anny cannot write its cache {nowhere} (Not a directory): what takes a minute to make is kept until the end "
        "only; set ANNY_CACHE_DIR to a folder that lasts"
    ]


def test_a_user_without_a_home(tmp_path: Path, monkeypatch, caplog) -> None:
    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr("depthmocap.core.caches._folder", lambda: tmp_path)
    monkeypatch.setenv("HOME", "")
    ensure_home()
    assert os.environ["HOME"] == ""
    monkeypatch.setattr(Path, "home", home)
    ensure_home()
    assert os.environ["HOME"] == str(tmp_path / "home")
    assert "set HOME to a folder that lasts" in caplog.text
    monkeypatch.setattr("depthmocap.core.caches._folder", lambda: tmp_path / "none")
    with pytest.raises(InputError, match="set HOME to a folder that can be written"):
        ensure_home()
