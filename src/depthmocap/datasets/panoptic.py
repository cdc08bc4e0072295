"""CMU Panoptic: up to ten Kinect 2 around a dome, and joints from hundreds of colour cameras. A folder per sequence::

    <seq>/kinect_shared_depth/KINECTNODE%d/depthdata.dat     uint16 512×424 frames, mm, mirrored
    <seq>/kcalibration_<seq>.json, calibration_<seq>.json    the Kinects' own calibration, and that of the dome
    <seq>/ksynctables_<seq>.json, synctables_<seq>.json      times of their frames, and of those of the dome
    <seq>/hdPose3d_stage1_coco19/body3DScene_%08d.json       joints19: x, y, z (cm), confidence, of every person

The world is the dome's, here in metres; its y axis points down. A Kinect's frame reaches it by way of its colour
camera, which the dome's calibration holds: ``world_from_depth = world_from_colour @ M_color @ inverse(M_depth)``.
Public code does not agree on whether M_color or its inverse leads to the colour camera; ``MColor`` chooses.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.core.reading.json_text import array, read_json
from depthmocap.datasets.annotated import AnnotatedFrame
from depthmocap.datasets.panoptic_files import HEIGHT, WIDTH, MColor, at, kinect_camera, read_depth, sensors_of
from depthmocap.datasets.volume import Volume, scene_background
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.segment.static_scene import PersonSegmenter

PANOPTIC_JOINTS = (
    "Neck", "Nose", "BodyCenter", "LShoulder", "LElbow", "LWrist", "LHip", "LKnee", "LAnkle",
    "RShoulder", "RElbow", "RWrist", "RHip", "RKnee", "RAnkle", "LEye", "LEar", "REye", "REar",
)  # fmt: skip
#: Our nearest joint of some of their joints.
PANOPTIC_CORRESPONDENCE = {
    "Neck": "Neck", "BodyCenter": "Hip",
    **{side + theirs: side + ours for side in "RL" for theirs, ours in (
        ("Shoulder", "Shoulder"), ("Elbow", "Elbow"), ("Wrist", "Hand"), ("Hip", "Hip"), ("Knee", "Knee"),
        ("Ankle", "Foot"),
    )},
}  # fmt: skip
FPS = 29.97
#: Largest time difference of a Kinect's frame and its frame of the dome, milliseconds.
NEAREST_MS = 17.0
#: Joints of less confidence are unknown; the set marks missing joints with a negative confidence.
CONFIDENCE = 0.2
#: Number of frames from which the background is estimated.
_SAMPLES = 24
#: Files of joints, by frame.
_NUMBERED = re.compile(r"body3DScene_[0-9]{1,9}")
#: Least share of the sampled views of each Kinect in which the true joints must lie on the person.
_LEAST_ON_PERSON = 0.5
#: Row of a frame of joints in the table of times, minus the number of the frame.
_HD_OFFSET = 1


class PanopticSet:
    """The frames of one or more sequences that show exactly one person (see ``AnnotatedSet``).

    Kinects are not synchronised: a frame of joints has the views of those within ``NEAREST_MS``. Subject and action of
    a frame are the sequence's name.
    """

    name = "CMU Panoptic"
    joints = PANOPTIC_JOINTS
    correspondence = PANOPTIC_CORRESPONDENCE
    up = "-y"

    def __init__(
        self,
        root: Path,
        kinects: tuple[int, ...] = (),
        every: int = 1,
        confidence: float = CONFIDENCE,
        m_color: MColor = "to-colour",
    ) -> None:
        """
        Args:
            root: a sequence's folder, or one that holds several.
            kinects: numbers (1–10) of the Kinects to read, by default all that are there.
            every: read every ``every``-th frame of joints only.
            confidence: joints below it are unknown.

        Raises:
            InputError: when no sequence is found.
        """
        if every < 1 or min(kinects, default=1) < 1:
            raise InputError(f"--every and the numbers of --kinects must be at least 1, got {every} and {kinects}")
        folders = [
            path.parent for path in sorted([*root.glob("kcalibration_*.json"), *root.glob("*/kcalibration_*.json")])
        ]
        if not folders:
            raise InputError(f"{root}: neither it nor a folder in it holds kcalibration_<sequence>.json")
        self.every, self.fps = every, FPS / every
        self.confidence, self.kinects = confidence, kinects
        self.m_color: MColor = m_color
        self.folders = folders
        self.problems: list[str] = []

    def __iter__(self) -> Iterator[AnnotatedFrame]:
        """Frames of all sequences except those with missing or inconsistent files."""
        self.problems.clear()
        for folder in self.folders:
            try:
                sequence = PanopticSequence(folder, self.kinects, self.confidence, self.m_color)
                yield from sequence.frames(self.every)
                self.problems += sequence.problems
            except InputError as error:
                self.problems.append(f"{folder.name}: left out, {error}")


class PanopticSequence:
    """One sequence, read frame by frame."""

    def __init__(self, folder: Path, kinects: tuple[int, ...], confidence: float, m_color: MColor) -> None:
        """
        Raises:
            InputError: when a file is missing or malformed, or no Kinect has depth.
        """
        self.folder, self.confidence = folder, confidence
        self.problems: list[str] = []
        self.cameras: dict[int, DepthCamera] = {}
        kinect_calibration, dome_calibration = self._json("kcalibration"), self._json("calibration")
        times = self._json("ksynctables")
        self.times_ms: dict[int, ndarray] = {}
        for kinect in kinects or range(1, len(sensors_of(kinect_calibration)) + 1):
            path = self._depth_path(kinect)
            if not path.is_file():
                self.problems.append(f"{folder.name}: Kinect {kinect} left out, {path} not found")
                continue
            self.cameras[kinect] = kinect_camera(folder, kinect_calibration, dome_calibration, kinect, m_color)
            node = f"KINECTNODE{kinect}"
            self.times_ms[kinect] = self._times(times, "ksynctables", "kinect", "depth", node)
        if not self.cameras:
            raise InputError(
                f"{folder / 'kinect_shared_depth'} has no KINECTNODE<number>/depthdata.dat that was asked for"
            )
        self.hd_ms = self._times(self._json("synctables"), "synctables", "hd")
        bodies = folder / "hdPose3d_stage1_coco19"
        self.bodies = sorted(path for path in bodies.glob("body3DScene_*.json") if _NUMBERED.fullmatch(path.stem))
        if not self.bodies:
            raise InputError(f"{bodies} holds no body3DScene_<frame>.json: unpack hdPose3d_stage1_coco19.tar")

    def frames(self, every: int) -> Iterator[AnnotatedFrame]:
        """Every ``every``-th frame of joints, with masked views."""
        left_out: dict[str, int] = {}
        for path in self.bodies[::every]:
            try:
                joints = self._joints(path)
                frame = int(path.stem.split("_")[-1])
                views = self._views(frame)
            except InputError as error:
                left_out[str(error)] = left_out.get(str(error), 0) + 1
                continue
            masked = tuple(View(view.camera, view.depth_m, self.segmenter(view)) for view in views)
            yield AnnotatedFrame(masked, joints, self.folder.name, self.folder.name, frame)
        self.problems += [f"{self.folder.name}: {count} frames left out, {why}" for why, count in left_out.items()]

    @functools.cached_property
    def segmenter(self) -> PersonSegmenter:
        """Background subtraction with a background from frames spread over the sequence (``volume``).

        Raises:
            InputError: when the true joints are not where the pictures show the person.
        """
        samples: dict[int, list[View]] = {kinect: [] for kinect in self.cameras}
        truths: dict[int, list[ndarray]] = {kinect: [] for kinect in self.cameras}
        spread = np.unique(np.linspace(0, len(self.bodies) - 1, _SAMPLES).round().astype(int))
        for path in [self.bodies[i] for i in spread]:
            try:
                joints = self._joints(path)
                views = self._views(int(path.stem.split("_")[-1]))
            except InputError:
                continue  # reported when the frame is read
            for view in views:
                kinect = next(k for k, camera in self.cameras.items() if camera is view.camera)
                samples[kinect].append(view)
                truths[kinect].append(joints)
        space = Volume.around(np.concatenate([joints for of_kinect in truths.values() for joints in of_kinect]), "-y")
        segmenter = PersonSegmenter({
            camera.name: scene_background([view.depth_m for view in samples[kinect]], camera, space)
            for kinect, camera in self.cameras.items() if samples[kinect]
        })  # fmt: skip
        for kinect, camera in self.cameras.items():
            on_person = [
                _on_person(view, joints, segmenter)
                for view, joints in zip(samples[kinect], truths[kinect], strict=True)
            ]
            if on_person and np.mean(on_person) < _LEAST_ON_PERSON:
                raise InputError(
                    f"{self.folder}: the calibration files disagree with the pictures of {camera.name}: "
                    f"{np.mean(on_person):.0%} of the true joints lie on the person; try the other --m-color, or fetch "
                    "the files anew"
                )
        return segmenter

    def _json(self, kind: str) -> Any:
        path = self.folder / f"{kind}_{self.folder.name}.json"
        return read_json(path)

    def _depth_path(self, kinect: int) -> Path:
        return self.folder / "kinect_shared_depth" / f"KINECTNODE{kinect}" / "depthdata.dat"

    def _times(self, table: Any, kind: str, *keys: str) -> Float[ndarray, "n"]:
        path, where = f"{self.folder / kind}_{self.folder.name}.json", ".".join((*keys, "univ_time"))
        times = at(table, *keys, "univ_time", default=None)
        if not isinstance(times, list) or not times:
            raise InputError(f"{path} must hold the times {where}")
        return array(times, (len(times),), f"{path}: {where}")

    def _joints(self, path: Path) -> Float[ndarray, "19 3"]:
        """The only person's joints, metres."""
        document = read_json(path)
        bodies = at(document, "bodies", default=None)
        if not isinstance(bodies, list):
            raise InputError(f"{path} must hold bodies")
        if len(bodies) != 1:
            raise InputError("nobody is in them" if not bodies else "several people are in them")
        size = 4 * len(PANOPTIC_JOINTS)
        table = array(at(bodies[0], "joints19", default=None), (size,), f"{path}: joints19 (x, y, z, confidence)")
        table = table.reshape(-1, 4)
        joints = np.where(table[:, 3:] >= self.confidence, table[:, :3] / 100, np.nan)
        if not np.isfinite(joints).all(1).any():
            raise InputError(f"no joint of confidence {self.confidence:g} or more is in them")
        return joints

    def _views(self, frame: int) -> list[View]:
        """Views of the Kinects at the time of a frame of joints."""
        if not 0 <= frame + _HD_OFFSET < len(self.hd_ms):
            raise InputError(f"synctables_{self.folder.name}.json ends before them")
        time_ms = self.hd_ms[frame + _HD_OFFSET]
        views, why = [], f"no Kinect has a picture within {NEAREST_MS:g} ms"
        for kinect, camera in self.cameras.items():
            off_ms = np.abs(self.times_ms[kinect] - time_ms)
            nearest = int(off_ms.argmin())
            if off_ms[nearest] > NEAREST_MS:
                continue
            try:
                raw = read_depth(self._depth_path(kinect), nearest)
            except InputError as error:
                why = str(error)
                continue
            views.append(View(camera, camera.to_metres(raw)))
        if not views:
            raise InputError(why)
        return views


def _on_person(view: View, joints: Float[ndarray, "j 3"], segmenter: PersonSegmenter) -> float:
    """Share of the known joints whose pixel is on the person; 0 where none is in the picture."""
    row, column = view.camera.nearest_pixels(joints[np.isfinite(joints).all(1)])
    inside = (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
    return float(segmenter(view)[row[inside], column[inside]].mean()) if inside.any() else 0.0
