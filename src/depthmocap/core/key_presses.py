"""Single keys that are pressed in the terminal while a command runs. Piped input is left alone."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator

#: How often it is looked whether to end, and on Windows for keys (seconds).
_POLL_S = 0.1


@contextlib.contextmanager
def key_presses(on_key: Callable[[str], None]) -> Iterator[bool]:
    """Call a function, in a thread of its own, with every key that is pressed, without waiting for Enter. Gives whether
    keys can be pressed: only in a terminal, whose state is restored at the end, by a command in its foreground."""
    if not _in_terminal():
        yield False
        return
    ended = threading.Event()
    with _single_keys():
        thread = threading.Thread(target=_read, args=(on_key, ended), name="keys", daemon=True)
        thread.start()
        try:
            yield True
        finally:
            ended.set()
            thread.join(2.0)


def _in_terminal() -> bool:
    try:
        if not sys.stdin.isatty():
            return False
        # A command in the background would be stopped when it changes the terminal or reads from it.
        return sys.platform == "win32" or os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (AttributeError, OSError, ValueError):  # no stdin, or a closed one
        return False


@contextlib.contextmanager
def _single_keys() -> Iterator[None]:
    """The terminal gives keys at once and does not show them; Ctrl-C and Ctrl-Z stay what they are."""
    if sys.platform == "win32":
        yield
        return
    import termios

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    changed = termios.tcgetattr(terminal)
    changed[3] &= ~(termios.ICANON | termios.ECHO)
    termios.tcsetattr(terminal, termios.TCSANOW, changed)
    try:
        yield
    finally:
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(terminal, termios.TCSANOW, before)


def _read(on_key: Callable[[str], None], ended: threading.Event) -> None:
    while not ended.is_set():
        for key in _pressed():
            on_key(key)


def _pressed() -> str:
    """The keys that were pressed, after a moment if none were."""
    if sys.platform == "win32":
        import msvcrt

        if msvcrt.kbhit():
            return msvcrt.getwch()
        time.sleep(_POLL_S)
        return ""
    terminal = sys.stdin.fileno()
    try:
        if not select.select([terminal], [], [], _POLL_S)[0]:
            return ""
        keys = os.read(terminal, 64).decode(errors="ignore")
    except OSError:
        keys = ""
    if not keys:  # the terminal is gone
        time.sleep(_POLL_S)
    return keys
