"""The recording folder: a rig, one folder of 16-bit depth PNGs per camera, optional background frames and true joints.

::

    rig.json
    <camera>/<timestamp ns>.png     16-bit grey raw depth, 0 = invalid; one clock for all cameras
    <camera>/background.png         the empty scene (optional)
    truth.csv                       true joints: timestamp_ns and the positions of pose.csv (optional)
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt16
from numpy import ndarray

from depthmocap.cameras.health import Fault, HealthCheck
from depthmocap.cameras.source import place_in_rig
from depthmocap.core.interrupts import finishing
from depthmocap.core.locks import LOCK_FILE, own_folder
from depthmocap.core.output import LineFile, write_file, writing
from depthmocap.core.reading.image_files import LARGEST_PICTURE, decode_png, png_header
from depthmocap.core.reading.input_files import read_bytes
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera, Rig, load_rig, save_rig
from depthmocap.recordings.pose_table import STAMP, TRUTH_HEADER, read_table
from depthmocap.recordings.timestamps import check_clocks, check_unit, fill_gaps, frame_period_ns, group_stamps
from depthmocap.recordings.unfinished import UNFINISHED_FILE, mark_unfinished, remove_unfinished_copy, unfinished

BACKGROUND_FILE = "background.png"
TRUTH_FILE = "truth.csv"
SATURATED = 65535
#: Half of a camera's first picture is not further or nearer (metres).
FARTHEST_M, NEAREST_M = 50.0, 0.3
#: What makes frames useless that can be read, in words.
_USELESS: dict[Fault, str] = {
    "frozen": "the same picture again and again",
    "noise": "noise in place of depth",
    "dark": f"no valid depth (all 0 or {SATURATED}), was the camera covered?",
}
_LAYOUT = "a recording folder holds rig.json and, for each camera in it, <camera>/<timestamp in ns>.png"


def read_depth_png(path: Path, camera: DepthCamera) -> UInt16[ndarray, "h w"]:
    """Raw depth of one frame.

    Raises:
        InputError: when the file is unreadable, damaged, not 16-bit grey, or not of the camera's size.
    """
    data = read_bytes(path, LARGEST_PICTURE)
    width, height, bits, kind = png_header(data, str(path))
    if (bits, kind) != (16, "grey"):
        raise InputError(f"{path} is {bits}-bit {kind}: depth must be 16-bit grey, raw depth units, 0 where invalid")
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{path} is {width}×{height} but rig.json says {camera.width}×{camera.height} for camera "
            f"{camera.name!r}: correct its width, height and intrinsics, or the frames"
        )
    return decode_png(data, str(path))


class UnfitFrameError(InputError):
    """A frame cannot be in a recording; others can."""


def check_frame(path: Path, rig: Rig, name: str, raw: UInt16[ndarray, "h w"]) -> None:
    """See that a frame can be written to the recording ``path``.

    Raises:
        UnfitFrameError: when it is of no camera of the rig, or not of its size, or not 16 bit.
    """
    if name not in rig.names:
        raise UnfitFrameError(f"{path}: no camera {name!r} in the rig, which has {', '.join(rig.names)}")
    camera = rig[name]
    if raw.dtype != np.uint16 or raw.shape != (camera.height, camera.width):
        raise UnfitFrameError(
            f"{path}: a frame of {name!r} must be uint16 of {camera.height} rows and {camera.width} columns, "
            f"got {raw.dtype} {raw.shape}"
        )


def _list_frames(folder: Path) -> dict[int, Path]:
    """Frame files by timestamp, in order of time. A folder that is not there has none."""
    frames: dict[int, Path] = {}
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.suffix.lower() != ".png" or path.name == BACKGROUND_FILE or path.name.startswith("."):
            continue
        if not (path.stem.isascii() and path.stem.isdecimal() and int(path.stem) < 2**63):
            raise InputError(f"{path}: a frame's name must be its timestamp in ns, an integer such as 33333333.png")
        if other := frames.get(int(path.stem)):
            raise InputError(f"{path} and {other} have the same timestamp: delete one of them")
        frames[int(path.stem)] = path
    return dict(sorted(frames.items()))


def camera_folder(recording: Path, name: str) -> Path:
    """The folder of a camera's frames. Its name is in UTF-8 on the disk, in whatever locale Python takes names."""
    return recording / os.fsdecode(name.encode())


class Recording(FrameSource):
    """A recording folder as a sequence of frame sets, read from disk as they are asked for.

    Frames of different cameras within half a frame period of each other form one set; instants at which no camera
    delivered are sets without views. A bad frame is a view that is absent, and a line in ``problems``; read in order,
    so are frames of a camera that was stuck (see ``capture.health``), all of them in one line. ``truth.csv`` has the
    frames' timestamps as ``timestamp_ns``; where it has ``time_s`` alone, these are the frames' timestamps in seconds,
    or count from the first frame when that cannot be.

    Attributes:
        rig: the cameras. ``up``: the world's up axis.
        period_ns: the frame period.
        complete: whether who wrote it finished it.
    """

    complete: bool = True

    def __init__(self, path: Path, rig: Rig | None = None) -> None:
        """Open a recording, check its first frames and read its background frames.

        Args:
            rig: where its cameras stand, instead of what the recording says; those that it lacks are left out, and the
                true joints too, which are in another world.

        Raises:
            InputError: when it is not a recording or its configuration cannot be right.
        """
        self.path = path
        self._problems: dict[str, None] = {}  # an ordered set: reading a frame twice reports it once
        self._useless: dict[tuple[str, Fault], dict[int, None]] = {}  # their timestamps, so too
        self.rig, self._stamps = self._load()
        if rig is not None:
            self._place(rig)
        self.up: str = self.rig.up
        self.camera_names = self.rig.names
        stamps = {name: own for name, own in self._stamps.items() if own}
        for name in self.rig.names:
            if name not in stamps:
                self._note(f"{camera_folder(path, name)}: no frames; the recording goes on without camera {name!r}")
        self.period_ns: int = frame_period_ns(stamps)
        check_unit(path, self.period_ns)
        check_clocks(path, stamps, self.period_ns)
        for name, own in stamps.items():
            self._check_first(name, own)
        self._backgrounds = {name: self._read_background(name) for name in self.rig.names}
        self._sets, gaps = fill_gaps(group_stamps(stamps, self.period_ns), self.period_ns)
        for gap in gaps:
            self._note(f"{path}: {gap}")
        self._truth = self._place_truth(self._load_truth() if rig is None else None)

    def _load(self) -> tuple[Rig, dict[str, list[int]]]:
        """The rig, and each camera's timestamps in order; at least one camera has a frame."""
        path = self.path
        if not path.is_dir():
            raise InputError(f"{path} is not a folder: {_LAYOUT}")
        if left := unfinished(path):
            self.complete = False
            self._note(left)
        if not (path / "rig.json").is_file():
            if left:
                raise InputError(left)
            if (path / "groundtruth.mat").is_file():
                raise InputError(f"{path} is a section of UBC3V, not a recording: pass it as a UBC3V section")
            raise InputError(f"{path} has no rig.json: {_LAYOUT}")
        rig = load_rig(path / "rig.json")
        self._files = {name: _list_frames(camera_folder(path, name)) for name in rig.names}
        if not any(self._files.values()):
            if left:
                raise InputError(left)
            raise InputError(f"{path} has no frames of its cameras ({', '.join(rig.names)}): {_LAYOUT}")
        of_cameras = {camera_folder(path, name) for name in rig.names}
        for folder in sorted(path.iterdir()):
            if folder.is_dir() and folder not in of_cameras and next(folder.glob("*.png"), None):
                self._note(f"{folder} is not read: rig.json has no camera of that name")
        return rig, {name: list(files) for name, files in self._files.items()}

    def _place(self, rig: Rig) -> None:
        """Keep the cameras of a rig, where it places them."""
        if missing := [name for name in self.rig.names if name not in rig.names]:
            if len(missing) == len(self.rig.cameras):
                raise InputError(f"{self.path} has none of the rig's cameras ({', '.join(rig.names)}), but {missing}")
            self._note(f"{self.path}: cameras that the rig lacks are left out: {', '.join(missing)}")
        kept = (place_in_rig(camera, rig) for camera in self.rig.cameras if camera.name in rig.names)
        self.rig = Rig(tuple(kept), rig.up)
        self._stamps = {name: self._stamps[name] for name in self.rig.names}

    def _check_first(self, name: str, stamps: list[int]) -> None:
        """A fault in the first frame is one of configuration, and no lost frame."""
        self._check_depth(name, stamps[0])

    def _check_depth(self, name: str, stamp: int) -> None:
        """See that a frame can be read, and that its depth is of persons and rooms in the unit that the rig says."""
        depth_m = self.rig[name].to_metres(self.raw(name, stamp))
        if not depth_m.any():
            return
        median_m = float(np.median(depth_m[depth_m > 0]))
        told = f"{self._where(name, str(stamp))}: half of the depth is beyond {median_m:.2g} m"
        unit = f"see depth_unit_m of camera {name!r} in the rig: {self.rig[name].depth_unit_m:g} m"
        if median_m > FARTHEST_M:
            raise InputError(f"{told}, further than any depth camera sees: {unit}")
        if median_m < NEAREST_M:
            self._note(f"{told.replace('beyond', 'within')}: unless something is before the lens, {unit}")

    def stamps(self, name: str) -> list[int]:
        """The timestamps (ns) of a camera's frames in order, on the clock that all cameras share."""
        return self._stamps[name]

    def device_time(self, name: str, stamp: int) -> tuple[int, str]:
        """A frame's time (ns) as its camera told it, and the name of that clock; here the shared one."""
        return stamp, "recording"

    def raw(self, name: str, stamp: int) -> UInt16[ndarray, "h w"]:
        """Raw depth of a camera's frame.

        Raises:
            InputError: when it cannot be read, is damaged or not of the camera's size.
        """
        return read_depth_png(self._files[name][stamp], self.rig[name])

    def raw_background(self, name: str) -> UInt16[ndarray, "h w"] | None:
        """Raw depth of the empty scene, if the camera has a background frame."""
        path = camera_folder(self.path, name) / BACKGROUND_FILE
        return read_depth_png(path, self.rig[name]) if path.exists() else None

    def _where(self, name: str, what: str) -> str:
        """The place of a frame or a background, for messages."""
        return str(camera_folder(self.path, name) / f"{what}.png")

    @property
    def problems(self) -> list[str]:
        """What was wrong so far, one line each; frames are checked as they are read."""
        lines = list(self._problems)
        for (name, fault), stamps in self._useless.items():
            where = self._where(name, str(min(stamps)))
            lines.append(f"{where}: {_USELESS[fault]} (frames of {name!r} left out from here on: {len(stamps)})")
        return lines

    def background(self, name: str) -> Float[ndarray, "h w"] | None:
        """Depth of the empty scene in metres (0 = invalid), if the camera has a background frame."""
        return self._backgrounds[name]

    def __len__(self) -> int:
        return len(self._sets)

    def __iter__(self) -> Iterator[FrameSet]:
        checks = {name: HealthCheck(self.rig[name]) for name in self.rig.names}
        return (self._read_set(i, checks) for i in range(len(self)))

    def __getitem__(self, index: int) -> FrameSet:
        return self._read_set(index, {})

    def _read_set(self, index: int, checks: Mapping[str, HealthCheck]) -> FrameSet:
        stamp_set = self._sets[index]
        views = [
            self._read_view(name, stamp_set.stamps[name], checks.get(name))
            for name in self.rig.names
            if name in stamp_set.stamps
        ]
        return FrameSet(
            stamp_set.timestamp_ns, tuple(view for view in views if view), self._true_joints(stamp_set.timestamp_ns)
        )

    def _note(self, problem: str) -> None:
        self._problems[problem] = None

    def _read_view(self, name: str, stamp: int, check: HealthCheck | None) -> View | None:
        camera = self.rig[name]
        try:
            raw = self.raw(name, stamp)
        except InputError as error:
            self._note(str(error))
            return None
        fault = check(raw, stamp) if check is not None else ""
        if not ((raw > 0) & (raw < SATURATED)).any():
            fault = "dark"
        if fault in _USELESS:
            self._useless.setdefault((name, fault), {})[stamp] = None
            return None
        return View(camera, camera.to_metres(raw))

    def _read_background(self, name: str) -> Float[ndarray, "h w"] | None:
        raw = self.raw_background(name)
        if raw is None:
            return None
        depth_m = self.rig[name].to_metres(raw)
        if not depth_m.any():
            where = self._where(name, "background")
            raise InputError(f"{where} has no valid depth: record the empty scene again, or delete it")
        return depth_m

    def truth_rows(self) -> list[tuple[int, Float[ndarray, "18 3"]]]:
        """The true joints, with their times (ns) on the frames' clock."""
        return [] if self._truth is None else list(zip(self._truth[0].tolist(), self._truth[1], strict=True))

    def _load_truth(self) -> tuple[Int[ndarray, " rows"], Float[ndarray, "rows 18 3"], bool] | None:
        """Times (ns) and joints as they were recorded, and whether the times are on the frames' clock for sure."""
        path = self.path / TRUTH_FILE
        if not path.exists():
            return None
        table = read_table(path)
        return table.stamps_ns, table.joints, table.on_clock

    def _place_truth(
        self, truth: tuple[Int[ndarray, " rows"], Float[ndarray, "rows 18 3"], bool] | None
    ) -> tuple[Int[ndarray, " rows"], Float[ndarray, "rows 18 3"]] | None:
        """The true joints with times on the frames' clock (ns)."""
        if truth is None:
            return None
        stamps_ns, joints, on_clock = truth
        first_ns, last_ns, slack_ns = self._sets[0].timestamp_ns, self._sets[-1].timestamp_ns, self.period_ns // 2
        told, mend = f"{self.path}: times of the true joints", f"truth.csv should have the frames' as {STAMP}"
        if not on_clock and stamps_ns[0] <= slack_ns < first_ns:
            # From 0 on, and frames from later on: of a clock that began before them, or counted from the first of them.
            if stamps_ns[-1] >= first_ns - slack_ns:
                self._note(f"{told} are taken for the frames' clock, but could count from the first frame: {mend}")
            else:
                stamps_ns = stamps_ns + first_ns
                if stamps_ns[-1] > last_ns + slack_ns:
                    self._note(
                        f"{told} are taken to count from the first frame, and go on for longer than the frames: if "
                        f"some were taken away at the beginning, they are wrong by as much; {mend}"
                    )
        if stamps_ns[-1] < first_ns - slack_ns or stamps_ns[0] > last_ns + slack_ns:
            self._note(f"{told} are none of the frames': {mend}")
        return stamps_ns, joints

    def _true_joints(self, timestamp_ns: int) -> Float[ndarray, "18 3"] | None:
        """The truth row nearest in time, if within half a period."""
        if self._truth is None:
            return None
        stamps_ns, joints = self._truth
        after = int(np.searchsorted(stamps_ns, timestamp_ns))
        distance_ns, near = min(
            (abs(int(stamps_ns[i]) - timestamp_ns), i) for i in (after - 1, after) if 0 <= i < len(stamps_ns)
        )
        return joints[near] if distance_ns <= self.period_ns / 2 else None


class RecordingWriter:
    """Writes a recording folder frame by frame; a context manager.

    ``rig.json`` and the background frames are written first and every file appears whole, so that a recording cut short
    is still readable. Until it is closed without an error it holds ``unfinished.json``, of which readers tell.
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
            compression: PNG's, 0 (none) to 9; 1 is fast enough to record live.
            copy_of: the recording that this is a copy of: an unfinished copy of it in the folder is begun anew.

        Raises:
            InputError: when the folder already holds something, is being written or cannot be, or a background frame
                does not fit the rig.
        """
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} exists already: choose a new folder for the recording")
        self.path, self.rig, self.compression = path, rig, compression
        self._truth_file: LineFile | None = None
        with contextlib.ExitStack() as stack:
            stack.enter_context(own_folder(path))
            if any(each.name != LOCK_FILE for each in path.iterdir()) and not (
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
            except FileExistsError:  # as another camera's, where case makes no difference
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
            InputError: when a frame is of no camera of the rig, or not of its size, or not 16 bit, or it cannot be
                written.
        """
        if timestamp_ns < 0:
            raise InputError(f"timestamp_ns must not be negative, got {timestamp_ns}")
        for name, raw in frames.items():
            self._write_png(name, f"{timestamp_ns}.png", raw)
        if true_joints is not None:
            if self._truth_file is None:
                self._truth_file = LineFile(self.path / TRUTH_FILE)
                self._truth_file.add(",".join(TRUTH_HEADER))
            cells = map(repr, true_joints.astype(float).ravel().tolist())  # repr: reads back exactly
            self._truth_file.add(f"{timestamp_ns}," + ",".join(cells))

    def close(self, finished: bool = True) -> None:
        """Close the files; a recording that is ``finished`` loses its mark. A second call does nothing."""
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
        with finishing():
            self.close(finished=kind is None)

    def _write_png(self, name: str, file: str, raw: UInt16[ndarray, "h w"]) -> None:
        check_frame(self.path, self.rig, name, raw)
        # Encoded in memory because OpenCV cannot open a path with non-ASCII letters on Windows.
        _, data = cv2.imencode(".png", raw, [cv2.IMWRITE_PNG_COMPRESSION, self.compression])
        write_file(camera_folder(self.path, name) / file, data.data)
