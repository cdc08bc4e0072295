"""Hands results over to streams, each in a thread of its own, so that none of them can hold up the capture."""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Callable, Iterable

import numpy as np

from depthmocap.frames import FrameSet, Pose
from depthmocap.offline.pipeline import Result
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.stream_protocol import Marker, Sample, Stream, StreamSetup

#: Seconds until a stream that could not start is tried again.
RETRY_S = 2.0
#: Seconds that the end of a capture waits for all streams to close.
CLOSE_S = 2.0
#: Markers that may wait for a slow stream; beyond them the oldest is dropped.
MAX_MARKERS = 100


class _Outlet:
    """One stream and its thread. The newest sample waits for it, and replaces one that it has not taken."""

    def __init__(self, stream: Stream, setup: StreamSetup, note: Callable[[str], None], started: bool) -> None:
        self._stream, self._setup, self._note, self._started = stream, setup, note, started
        self._told: set[type] = set()
        self._changed = threading.Condition()
        self._sample: Sample | None = None
        self._markers: collections.deque[Marker] = collections.deque(maxlen=MAX_MARKERS)
        self._stopping = False
        # A daemon, because a receiver that never returns must not keep the process alive.
        self.thread = threading.Thread(target=self._run, name=f"stream {stream.name}", daemon=True)
        self.thread.start()

    def put(self, sample: Sample) -> None:
        with self._changed:
            late = self._sample is not None and self._started
            self._sample = sample
            self._changed.notify_all()
        if late:
            self._note(f"{self._stream.name} takes longer than sets come: it gets the newest, not every one")

    def mark(self, marker: Marker) -> None:
        with self._changed:
            self._markers.append(marker)
            self._changed.notify_all()

    def stop(self) -> None:
        with self._changed:
            self._stopping = True
            self._changed.notify_all()

    def _run(self) -> None:
        while not self._started:
            self._started = self._attempt(lambda: self._stream.start(self._setup))
            with self._changed:
                if not self._started and self._changed.wait_for(lambda: self._stopping, RETRY_S):
                    return
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping or self._sample is not None or self._markers)
                sample, self._sample = self._sample, None
                markers = list(self._markers)
                self._markers.clear()
            for marker in markers:
                self._attempt(lambda marker=marker: self._stream.mark(marker))
            if sample is not None:
                self._attempt(lambda sample=sample: self._stream.send(sample))
            elif not markers:
                self._attempt(self._stream.close)
                return

    def _attempt(self, call: Callable[[], None]) -> bool:
        """Whether the call was successful; each kind of error is told once, whatever it says the next time."""
        try:
            call()
        except Exception as error:  # a stream may be of the user's own, and raise anything
            if type(error) not in self._told:
                self._told.add(type(error))
                self._note(f"{self._stream.name}: {error or type(error).__name__}; the capture goes on")
            return False
        return True


class Outlets:
    """The streams of a capture. Any thread may put samples and markers."""

    def __init__(self, streams: Iterable[Stream | str], note: Callable[[str], None]) -> None:
        """
        Args:
            streams: streams, or addresses as ``--stream`` takes them.
            note: is called with a line about each problem, from any thread.

        Raises:
            InputError: when an address is wrong, or what it needs is not installed.
        """
        self._streams = [open_stream(stream) if isinstance(stream, str) else stream for stream in streams]
        self._note = note
        self._outlets: list[_Outlet] = []
        self._last_number = 1

    def __bool__(self) -> bool:
        return bool(self._streams)

    def start(self, setup: StreamSetup, at_once: bool = False) -> None:
        """Start all streams, each in its thread, where one that cannot start is told and tried again.

        Args:
            at_once: start them in this thread, one after the other, and raise what one raises.
        """
        for stream in self._streams:
            try:
                if at_once:
                    stream.start(setup)
            except BaseException:
                self.close()
                raise
            self._outlets.append(_Outlet(stream, setup, self._note, at_once))

    def send(self, result: Result, frames: FrameSet, unix_ns: int, monotonic_ns: int) -> None:
        """Hand a result over; see :class:`Sample` for the times."""
        if self._outlets:
            sample = Sample(result, self._people(result), frames, unix_ns, monotonic_ns)
            for outlet in self._outlets:
                outlet.put(sample)

    def mark(self, marker: Marker) -> None:
        """Hand a marker over."""
        for outlet in self._outlets:
            outlet.mark(marker)

    def close(self) -> None:
        """Close all streams, after what waits for them; one that hangs is left alone after a while."""
        for outlet in self._outlets:
            outlet.stop()
        end_s = time.monotonic() + CLOSE_S
        for outlet in self._outlets:
            outlet.thread.join(max(end_s - time.monotonic(), 0))
        self._outlets.clear()

    def _people(self, result: Result) -> dict[int, Pose]:
        if result.people:
            self._last_number = result.people[0].number
            return {person.number: person.pose for person in result.people}
        # A filter may go on with somebody who is hidden for a moment.
        return {self._last_number: result.pose} if np.isfinite(result.pose.joints).any() else {}
