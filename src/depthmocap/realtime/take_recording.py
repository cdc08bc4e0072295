"""Recordings that begin and end while a capture runs."""

from __future__ import annotations

import threading
from pathlib import Path

from depthmocap.cameras.source import DepthFrame
from depthmocap.core.camera_names import safe_name
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.errors import InputError
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.realtime.mcap_recorder import McapRecorder
from depthmocap.recordings.mcap_writer import McapWriter

#: Seconds to wait for cameras that are writing a frame when a recording ends.
_WAIT_S = 2.0


class TakeRecording:
    """The recorder of a capture, which writes into one MCAP file after the other, or into none.

    Attributes:
        path: of the file that is being written; None between recordings.
        written: the files so far.
    """

    def __init__(self, capture: LiveCapture) -> None:
        self._capture = capture
        self._switching, self._changed = threading.Lock(), threading.Condition()
        self._writer: McapWriter | None = None
        self._recorder: McapRecorder | None = None
        self._in_use = 0
        self.path: Path | None = None
        self.written: list[Path] = []

    def begin(self, path: Path) -> None:
        """Record from now on.

        Raises:
            InputError: when it records already, or the file cannot be written.
        """
        with self._switching:
            if self._writer is not None:
                raise InputError(f"{self.path} is being recorded: stop it first")
            reader = self._capture.reader
            rig = self._capture.rig
            backgrounds = {name: raw for name, raw in self._capture.raw_backgrounds().items() if name in rig.names}
            self._writer = McapWriter(path, rig, backgrounds)
            self.path = path
            self.written.append(path)
            with self._changed:
                self._recorder = McapRecorder(self._writer, reader.camera)
            reader.recorder = self

    def begin_named(self, folder: Path, name: str) -> None:
        """Record into a new file of this name, with or without its ending, in a folder.

        Raises:
            InputError: when it is no name of a file, there is such a file, or it cannot be written.
        """
        stem = name.strip().removesuffix(".mcap")
        if stem != safe_name(stem):
            raise InputError(f"{stem!r} cannot be a file's name: call it {safe_name(stem)!r}")
        path = folder / f"{stem}.mcap"
        if path.exists():
            raise InputError(f"{path} is there already: choose another name")
        self.begin(path)

    def end(self) -> None:
        """Finish the file, if one is being written; the capture goes on.

        Raises:
            InputError: when it cannot be finished.
        """
        with self._switching:
            if self._writer is None:
                return
            with self._changed:
                self._recorder = None
                self._changed.wait_for(lambda: not self._in_use, _WAIT_S)
            writer, self._writer, self.path = self._writer, None, None
            with deferred_interrupts():
                writer.close()

    def write(self, frame: DepthFrame) -> None:
        """Add a frame, from any thread; see :meth:`McapRecorder.write`."""
        with self._changed:
            recorder = self._recorder
            if recorder is None:
                return
            self._in_use += 1
        try:
            recorder.write(frame)
        finally:
            with self._changed:
                self._in_use -= 1
                self._changed.notify_all()

    def __enter__(self) -> TakeRecording:
        return self

    def __exit__(self, *failure: object) -> None:
        self.end()
