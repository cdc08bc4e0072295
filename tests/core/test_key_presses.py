"""Keys that are pressed in a terminal, of which a real pseudo terminal takes the place."""

import os
import subprocess
import sys
import time

import pytest

from depthmocap.core.key_presses import key_presses

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are of POSIX")

#: Takes the pseudo terminal for its own, and tells what is pressed in it.
PROGRAM = """
import fcntl, sys, termios, threading
from depthmocap.core.key_presses import key_presses
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
before, done, keys = termios.tcgetattr(0), threading.Event(), []
def pressed(key):
    keys.append(key)
    if key == "q":
        done.set()
with key_presses(pressed) as able:
    during = termios.tcgetattr(0)
    print("ready", able, bool(during[3] & termios.ECHO), bool(during[3] & termios.ISIG), flush=True)
    done.wait(10)
print("".join(keys), termios.tcgetattr(0) == before, flush=True)
"""


def test_keys_of_a_terminal_come_one_by_one_and_its_state_is_restored() -> None:
    master, slave = os.openpty()
    try:
        with subprocess.Popen(
            [sys.executable, "-c", PROGRAM], stdin=slave, stdout=subprocess.PIPE, start_new_session=True, text=True
        ) as program:
            assert program.stdout is not None
            assert program.stdout.readline() == "ready True False True\n"
            os.write(master, b"pq")  # without Enter
            assert program.stdout.readline() == "pq True\n"
        assert program.returncode == 0
    finally:
        os.close(master)
        os.close(slave)


def test_piped_input_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = os.pipe()
    os.write(write, b"p\n")
    os.close(write)
    keys: list[str] = []
    with os.fdopen(read) as pipe:
        monkeypatch.setattr(sys, "stdin", pipe)
        with key_presses(keys.append) as able:
            time.sleep(0.01)
        assert not able and not keys
        assert pipe.read() == "p\n"


@pytest.mark.parametrize("stdin", ["none", "closed", "of another session"])
def test_where_there_is_no_terminal_there_are_no_keys(monkeypatch: pytest.MonkeyPatch, stdin: str) -> None:
    master, slave = os.openpty()
    terminal = os.fdopen(slave)
    if stdin == "closed":
        terminal.close()
    monkeypatch.setattr(sys, "stdin", None if stdin == "none" else terminal)
    with key_presses(print) as able:
        assert not able
    terminal.close()
    os.close(master)
