"""No command looks up a name, talks to another machine or leaves files where none are expected."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from watched import contacts, strace, traced_contacts, watched_environment

import depthmocap

#: What libraries keep for a user, in the home folder.
_CACHES = {".cache/anny", ".cache/matplotlib", ".cache/numba", ".cache/fontconfig", ".config/matplotlib"}

_COMMANDS = """
import sys
from depthmocap.cli import main

assert main(["run", "short", "--out", "run"]) == 0
assert main(["live", "short", "--out", "live"]) == 0
assert main(["record", "short", "--out", "live.mcap"]) == 0
assert main(["cameras"]) == 0
if sys.argv[1:] == ["train"]:
    from depthmocap.train import train_classifier as train

    train.export_onnx = lambda network, path, metadata: path  # which takes longer than all the rest
    train.quantise = lambda source, windows, target: None
    train._CALIBRATION = 1
    few = "--images 2 --batch 2 --valid-images 2 --workers 0 --subset easy"
    assert main(["train", "classifier", "--out", "trained", *few.split()]) == 0
    main(["live", "synthetic", "--seconds", "2", "--out", "simulated"])  # a slow machine may see no frame
"""


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """The first sets of the packaged recording."""
    whole, path = Path(depthmocap.__file__).parent / "demo_recording", tmp_path / "short"
    for camera in sorted(each for each in whole.iterdir() if each.is_dir()):
        (path / camera.name).mkdir(parents=True)
        names = sorted(each.name for each in camera.glob("*.png"))
        for name in [*names[:4], *(each for each in names[4:] if not each[0].isdigit())]:
            shutil.copy(camera / name, path / camera.name / name)
    shutil.copy(whole / "rig.json", path)
    return path


@pytest.mark.slow
def test_nothing_calls_home(short: Path, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    import matplotlib

    train = []
    watch, home, log = tmp_path / "watch", tmp_path / "home", tmp_path / "strace.log"
    for folder in (watch, home / ".cache"):
        folder.mkdir(parents=True)
    # What takes long to make is taken from the caches that there are.
    (home / ".cache" / "matplotlib").symlink_to(matplotlib.get_cachedir())
    try:
        from anny.paths import get_anny_cache_path
    except ImportError:
        pass
    else:
        request.getfixturevalue("body_model")  # fills the cache
        (home / ".cache" / "anny").symlink_to(get_anny_cache_path())
        train = ["train"]
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "ORT_"))}
    done = subprocess.run(
        [*strace(log), sys.executable, "-c", _COMMANDS, *train],
        cwd=short.parent, env=kept | watched_environment(watch) | {"HOME": str(home)}, check=False,
        capture_output=True, encoding="utf-8",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert contacts(watch) == set()
    if log.exists():
        assert traced_contacts(log) == set()
    assert {str(each.relative_to(home)) for each in home.glob("*/*")} <= _CACHES
    assert {each.name for each in home.iterdir()} <= {".cache", ".config"}
    made = {"run", "live", "live.mcap", *(("trained", "simulated") if train else ())}
    assert {each.name for each in tmp_path.iterdir()} <= {"short", "watch", "home", "strace.log", *made}


def test_telemetry_is_off_whatever_is_imported_first() -> None:
    code = "import os, depthmocap.core.onnx_session, onnxruntime; assert os.environ['ORT_DISABLE_TELEMETRY'] == '1'"
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_the_watch_sees(tmp_path: Path) -> None:
    code = (
        "import socket\n"
        "for host in ('localhost', '127.0.0.1', 'nobody.invalid'):\n"
        "    try: socket.getaddrinfo(host, 80)\n"
        "    except OSError: pass\n"
        "with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s: s.connect(('192.0.2.1', 9))\n"
    )
    log = tmp_path / "strace.log"
    environment = os.environ | watched_environment(tmp_path)
    subprocess.run([*strace(log), sys.executable, "-c", code], env=environment, check=True)
    assert contacts(tmp_path) == {"socket.getaddrinfo nobody.invalid", "socket.connect 192.0.2.1"}
    if log.exists():
        assert "192.0.2.1" in traced_contacts(log)
