"""SIGTERM and SIGHUP end a command as Ctrl-C does, with everything written, and never in the middle of writing."""

from __future__ import annotations

import os
import signal

import pytest

from depthmocap.core.interrupts import deferred_interrupts, handled_signals, preserved_handlers
from depthmocap.synth.writing.workers import ordered

pytestmark = pytest.mark.usefixtures("usual_signals")
posix = pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX")


@posix
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_signal_interrupts_once_and_is_the_status(name: str) -> None:
    number = getattr(signal, name)
    with handled_signals() as ending:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        signal.raise_signal(number)  # the shell's, of the same closed terminal
        assert ending.status == 128 + number
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(number) == signal.SIG_DFL
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@posix
def test_results_are_written_to_their_end() -> None:
    with handled_signals() as ending:
        written = []
        with pytest.raises(KeyboardInterrupt), deferred_interrupts():
            signal.raise_signal(signal.SIGTERM)
            with deferred_interrupts():
                written.append(1)
            written.append(2)
        assert written == [1, 2]
        with pytest.raises(KeyboardInterrupt), deferred_interrupts():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)  # who insists
            written.append(3)
        assert (written, ending.status) == ([1, 2], 143)
        with pytest.raises(RuntimeError), deferred_interrupts():
            raise RuntimeError
    with deferred_interrupts():
        pass


@posix
def test_what_is_ignored_or_handled_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # nohup
    try:
        with handled_signals() as ending:
            signal.raise_signal(signal.SIGHUP)
            with preserved_handlers():
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
            assert ending.status == 143
    finally:
        signal.signal(signal.SIGHUP, before)


def _hit_parent(task: int) -> int:
    """As a supervisor does that stops all processes of a service."""
    if task == 2:
        os.kill(os.getpid(), signal.SIGHUP)
        os.kill(os.getpid(), signal.SIGTERM)
    return task


@posix
def test_workers_leave_it_to_the_parent() -> None:
    assert list(ordered(_hit_parent, range(4), 1)) == list(range(4))
