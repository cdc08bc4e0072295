"""Writes recording folders."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import cv2
from jaxtyping import Float, UInt16
from numpy import ndarray

from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.core.locks import LOCK_FILE, lock_folder
from depthmocap.core.output import LineFile, write_file, writing
from depthmocap.errors import InputError
from depthmocap.geometry import Rig, save_rig
from depthmocap.recordings.pose_table import TRUTH_HEADER
from depthmocap.recordings.recording_layout import BACKGROUND_FILE, TRUTH_FILE, camera_folder, check_frame
from depthmocap.recordings.unfinished import UNFINISHED_FILE, mark_unfinished, remove_unfinished_copy

#: Low bits of depth are noise, which never comes twice: the strategy for such pictures is 3 % smaller at level 9.
_PNG_STRATEGY = cv2.IMWRITE_PNG_STRATEGY_FILTERED


class RecordingWriter:
    """Writes a recording folder frame by frame; a context manager.

    ``rig.json`` and the background frames are written first, and every file appears whole, so that a recording that was
    cut short is readable. Until it is closed without an error it holds ``unfinished.json``, which readers report.
    """

    def __init__(
        self,
        path: Path,
        rig: Rig,
        backgrounds: Mapping[str, UInt16[ndarray, "_ _"]] | None = None,
        compression: int = 1,
        copy_of: Path | None = None,
    ) -> None:
        """Start a new folder.

        Args:
            compression: of PNG, from 0 (none) to 9; 1 is fast enough to record live.
            copy_of: the recording of which this is a copy; an unfinished copy of it in the folder is overwritten.

        Raises:
            InputError: when the folder is not empty, is being written by another process or cannot be written, or when
                a background frame does not fit the rig.
        """
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} exists already: choose a new folder for the recording")
        self.path, self.rig, self.compression = path, rig, compression
        self._truth_file: LineFile | None = None
        with contextlib.ExitStack() as stack:
            stack.enter_context(lock_folder(path))
            if any(path_inside.name != LOCK_FILE for path_inside in path.iterdir()) and not (
                copy_of is not None and remove_unfinished_copy(path, copy_of)
            ):
                raise InputError(f"{path} exists already: choose a new folder for the recording")
            mark_unfinished(path, copy_of)
            with writing(path):
                self._begin(path, rig, backgrounds or {})
            self._held = stack.pop_all()

    def _begin(self, path: Path, rig: Rig, backgrounds: Mapping[str, UInt16[ndarray, "_ _"]]) -> None:
        for name in rig.names:
            try:
                camera_folder(path, name).mkdir()
            except FileExistsError:  # two names differ only in case, on a file system that ignores case
                raise InputError(f"{path}: camera {name!r} would share a folder with another: rename it") from None
        save_rig(rig, path / "rig.json")
        for name, raw in backgrounds.items():
            self._write_png(name, BACKGROUND_FILE, raw)

    def write(
        self,
        timestamp_ns: int,
        frames: Mapping[str, UInt16[ndarray, "_ _"]],
        true_joints: Float[ndarray, "18 3"] | None = None,
    ) -> None:
        """Add the raw depth frames of one instant, by camera name, and the true joints (metres, the rig's world).

        Raises:
            InputError: when a frame does not fit the rig or is not 16 bit, or when it cannot be written.
        """
        if timestamp_ns < 0:
            raise InputError(f"timestamp_ns must not be negative, got {timestamp_ns}")
        for name, raw in frames.items():
            self._write_png(name, f"{timestamp_ns}.png", raw)
        if true_joints is not None:
            if self._truth_file is None:
                self._truth_file = LineFile(self.path / TRUTH_FILE)
                self._truth_file.add(",".join(TRUTH_HEADER))
            cells = map(repr, true_joints.astype(float).ravel().tolist())  # repr keeps every digit
            self._truth_file.add(f"{timestamp_ns}," + ",".join(cells))

    def close(self, finished: bool = True) -> None:
        """Close the files, and remove the mark ``unfinished.json`` if ``finished``. A second call does nothing."""
        with self._held:
            if self._truth_file is not None:
                self._truth_file.close()
            if finished:
                (self.path / UNFINISHED_FILE).unlink(missing_ok=True)

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with deferred_interrupts():
            self.close(finished=kind is None)

    def _write_png(self, name: str, file: str, raw: UInt16[ndarray, "h w"]) -> None:
        check_frame(self.path, self.rig, name, raw)
        # Encoded in memory because OpenCV cannot open a path with non-ASCII letters on Windows.
        options = (cv2.IMWRITE_PNG_COMPRESSION, self.compression, cv2.IMWRITE_PNG_STRATEGY, _PNG_STRATEGY)
        _, data = cv2.imencode(".png", raw, options)
        write_file(camera_folder(self.path, name) / file, data.data)
