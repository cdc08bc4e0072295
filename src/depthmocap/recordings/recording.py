"""Reads a recording as a sequence of frame sets."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt16
from numpy import ndarray

from depthmocap.cameras.health import Fault, HealthCheck
from depthmocap.cameras.source import place_in_rig
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera, Rig, load_rig
from depthmocap.recordings.depth_codec import SwappedSizeError
from depthmocap.recordings.pose_table import read_table
from depthmocap.recordings.recording_layout import (
    BACKGROUND_FILE,
    LAYOUT,
    TRUTH_FILE,
    camera_folder,
    list_frames,
    read_depth_png,
)
from depthmocap.recordings.timestamps import add_empty_sets, check_clocks, check_unit, frame_period_ns, group_stamps
from depthmocap.recordings.true_joints import TrueJoints
from depthmocap.recordings.unfinished import unfinished

#: The largest raw value, which sensors give where depth is saturated.
SATURATED = 65535
#: If the median depth of a camera's first picture is larger (metres), the depth unit is wrong.
FARTHEST_M = 50.0
#: If it is smaller (metres), the depth unit may be wrong.
NEAREST_M = 0.3
#: Faults that make readable frames useless, in words.
_USELESS: dict[Fault, str] = {
    "frozen": "the same picture again and again",
    "noise": "noise in place of depth",
    "dark": f"no valid depth (all 0 or {SATURATED}), was the camera covered?",
}


class TurnedPicturesError(InputError):
    """A camera's pictures are on their side against its intrinsics.

    Attributes:
        rig: with the camera as it is if its pictures were turned anticlockwise.
        camera: its name.
    """

    def __init__(self, path: Path, rig: Rig, name: str) -> None:
        camera = rig[name]
        left, right = camera.turned(1), camera.turned(3)
        super().__init__(
            f"{path}: the rig has {camera.width}×{camera.height} for camera {name!r}, but its pictures are turned by "
            f"90°: width {left.width}, height {left.height}, fx {left.fx:g}, fy {left.fy:g}, cx {left.cx:g}, cy "
            f"{left.cy:g} would be right if anticlockwise, cx {right.cx:g}, cy {right.cy:g} if clockwise (calibrate "
            "--mend tells which)"
        )
        cameras = (left if of_rig.name == name else of_rig for of_rig in rig.cameras)
        self.camera, self.rig = name, dataclasses.replace(rig, cameras=tuple(cameras))


class Recording(FrameSource):
    """A recording folder as a sequence of frame sets, which are read from disk on request.

    Frames of different cameras within half a frame period of each other, with the time offsets in the rig added, form
    one set. An instant at which no camera delivered is a set without views. A bad frame is left out of its set and is
    a line in ``problems``. If sets are read in order, frames of a faulty camera (``cameras.health``) are left out as
    well, and share one line.

    ``truth.csv`` has the frames' timestamps as ``timestamp_ns``. If it has only ``time_s``, this column holds the
    frames' timestamps in seconds, or the seconds since the first frame if that is impossible.

    Attributes:
        path: the folder or file.
        rig: the cameras.
        up: the world's up axis.
        period_ns: the frame period.
        complete: whether the recording was finished.
    """

    complete: bool = True

    def __init__(self, path: Path, rig: Rig | None = None) -> None:
        """Open a recording, check its first frames and read its background frames.

        Args:
            rig: the poses of the cameras, in place of the recording's. Cameras that it lacks are left out, and so are
                the true joints, which are in another world.

        Raises:
            InputError: when the path is no recording, or its configuration is impossible.
        """
        self.path = path
        self._problems: dict[str, None] = {}  # an ordered set: reading a frame twice reports it once
        self._useless: dict[tuple[str, Fault], dict[int, None]] = {}  # their timestamps, so too
        self.rig, self._stamps = self._load()
        if rig is not None:
            self._place(rig)
        self.up, self.area_m = self.rig.up, self.rig.area_m
        self.camera_names = self.rig.names
        stamps = {name: camera_stamps for name, camera_stamps in self._stamps.items() if camera_stamps}
        for name in self.rig.names:
            if name not in stamps:
                self._note(f"{camera_folder(path, name)}: no frames; the recording goes on without camera {name!r}")
        self.period_ns: int = frame_period_ns(stamps)
        check_unit(path, self.period_ns)
        offsets_ns = {camera.name: camera.time_offset_ns for camera in self.rig.cameras}
        check_clocks(path, stamps, self.period_ns, offsets_ns)
        for name, camera_stamps in stamps.items():
            try:
                self._check_first(name, camera_stamps)
            except SwappedSizeError:
                raise TurnedPicturesError(path, self.rig, name) from None
        self._backgrounds = {name: self._read_background(name) for name in self.rig.names}
        self._sets, gaps = add_empty_sets(group_stamps(stamps, self.period_ns, offsets_ns), self.period_ns)
        for gap in gaps:
            self._note(f"{path}: {gap}")
        self._truth = self._align_truth(self._load_truth() if rig is None else None)

    def _load(self) -> tuple[Rig, dict[str, list[int]]]:
        """Load the rig, and each camera's timestamps in order; at least one camera has a frame."""
        path = self.path
        if not path.is_dir():
            raise InputError(f"{path} is not a folder: {LAYOUT}")
        if unfinished_problem := unfinished(path):
            self.complete = False
            self._note(unfinished_problem)
        if not (path / "rig.json").is_file():
            if unfinished_problem:
                raise InputError(unfinished_problem)
            if (path / "groundtruth.mat").is_file():
                raise InputError(f"{path} is a section of UBC3V, not a recording: pass it as a UBC3V section")
            raise InputError(f"{path} has no rig.json: {LAYOUT}")
        rig = load_rig(path / "rig.json")
        self._files = {name: list_frames(camera_folder(path, name)) for name in rig.names}
        if not any(self._files.values()):
            if unfinished_problem:
                raise InputError(unfinished_problem)
            raise InputError(f"{path} has no frames of its cameras ({', '.join(rig.names)}): {LAYOUT}")
        of_cameras = {camera_folder(path, name) for name in rig.names}
        for folder in sorted(path.iterdir()):
            if folder.is_dir() and folder not in of_cameras and next(folder.glob("*.png"), None):
                self._note(f"{folder} is not read: rig.json has no camera of that name")
        return rig, {name: list(files) for name, files in self._files.items()}

    def _place(self, rig: Rig) -> None:
        """Keep the cameras of this rig, with its poses."""
        if missing := [name for name in self.rig.names if name not in rig.names]:
            if len(missing) == len(self.rig.cameras):
                raise InputError(f"{self.path} has none of the rig's cameras ({', '.join(rig.names)}), but {missing}")
            self._note(f"{self.path}: cameras that the rig lacks are left out: {', '.join(missing)}")
        kept = (place_in_rig(_in_size_of(rig, camera), rig) for camera in self.rig.cameras if camera.name in rig.names)
        self.rig = Rig(tuple(kept), rig.up, rig.area_m)
        self._stamps = {name: self._stamps[name] for name in self.rig.names}

    def _check_first(self, name: str, stamps: list[int]) -> None:
        """Check the first frame: a fault there is a wrong configuration, not a lost frame."""
        self._check_depth(name, stamps[0])

    def _check_depth(self, name: str, stamp: int) -> None:
        """Check that a frame can be read, and that its depth is plausible for rooms in the rig's depth unit."""
        depth_m = self.rig[name].to_metres(self.raw(name, stamp))
        if not depth_m.any():
            return
        median_m = float(np.median(depth_m[depth_m > 0]))
        subject = f"{self._where(name, str(stamp))}: half of the depth is beyond {median_m:.2g} m"
        unit = f"see depth_unit_m of camera {name!r} in the rig: {self.rig[name].depth_unit_m:g} m"
        if median_m > FARTHEST_M:
            raise InputError(f"{subject}, further than any depth camera sees: {unit}")
        if median_m < NEAREST_M:
            self._note(f"{subject.replace('beyond', 'within')}: unless something is before the lens, {unit}")

    def stamps(self, name: str) -> list[int]:
        """The timestamps (ns) of a camera's frames in order, as recorded: without the camera's time offset."""
        return self._stamps[name]

    @property
    def set_stamps_ns(self) -> Int[ndarray, " sets"]:
        """The timestamps (ns) of all sets, in order."""
        return np.array([stamp_set.timestamp_ns for stamp_set in self._sets], np.int64)

    def device_time(self, name: str, stamp: int) -> tuple[int, str]:
        """A frame's time (ns) by its camera's clock, and the name of that clock; in a folder the shared one."""
        return stamp, "recording"

    def raw(self, name: str, stamp: int) -> UInt16[ndarray, "h w"]:
        """Raw depth of a camera's frame.

        Raises:
            InputError: when it cannot be read, is damaged or does not have the camera's size.
        """
        return read_depth_png(camera_folder(self.path, name) / self._files[name][stamp], self.rig[name])

    def raw_background(self, name: str) -> UInt16[ndarray, "h w"] | None:
        """Raw depth of the empty scene; None if the camera has no background frame."""
        path = camera_folder(self.path, name) / BACKGROUND_FILE
        return read_depth_png(path, self.rig[name]) if path.exists() else None

    def _where(self, name: str, what: str) -> str:
        """The path of a frame or a background, for messages."""
        return str(camera_folder(self.path, name) / f"{what}.png")

    @property
    def problems(self) -> list[str]:
        """The problems so far, one line each; frames are checked when they are read."""
        lines = list(self._problems)
        for (name, fault), stamps in self._useless.items():
            where = self._where(name, str(min(stamps)))
            lines.append(f"{where}: {_USELESS[fault]} (frames of {name!r} left out from here on: {len(stamps)})")
        return lines

    def background(self, name: str) -> Float[ndarray, "h w"] | None:
        """Depth of the empty scene in metres (0 = invalid); None if the camera has no background frame."""
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
        """The true joints (metres) with their times (ns) on the frames' clock."""
        truth = self._truth
        return [] if truth is None else list(zip(truth.stamps_ns.tolist(), truth.joints, strict=True))

    def _load_truth(self) -> TrueJoints | None:
        """The true joints as they were recorded."""
        path = self.path / TRUTH_FILE
        if not path.exists():
            return None
        table = read_table(path)
        return TrueJoints(table.stamps_ns, table.joints, table.on_clock)

    def _align_truth(self, truth: TrueJoints | None) -> TrueJoints | None:
        """The true joints with times on the frames' clock (ns)."""
        if truth is None:
            return None
        aligned, problems = truth.align(
            self.path, self._sets[0].timestamp_ns, self._sets[-1].timestamp_ns, self.period_ns
        )
        for problem in problems:
            self._note(problem)
        return aligned

    def _true_joints(self, timestamp_ns: int) -> Float[ndarray, "18 3"] | None:
        """The true joints nearest in time, if within half a frame period."""
        return None if self._truth is None else self._truth.nearest(timestamp_ns, self.period_ns / 2)


def _in_size_of(rig: Rig, camera: DepthCamera) -> DepthCamera:
    """The camera with its width and height exchanged if the rig has them so: whether pictures are on their side, their
    size tells."""
    placed = rig[camera.name]
    if (placed.height, placed.width) != (camera.width, camera.height):
        return camera
    return dataclasses.replace(camera, width=placed.width, height=placed.height)
