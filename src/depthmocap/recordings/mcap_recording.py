"""Reads a recording in an MCAP file like a recording folder: ours, and others with the same Foxglove message types.

A camera is a CameraCalibration. Its frames are the 16-bit images with the same ``frame_id``, and its pose follows from
the FrameTransforms. Files without our metadata are assumed to be in millimetres with Z up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, UInt16
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.camera_names import safe_names
from depthmocap.core.reading.json_text import array, number_from_text, parse_json, whole_number
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.geometry.depth_camera import check_camera, check_up
from depthmocap.geometry.floor_area import parse_area
from depthmocap.recordings.depth_codec import SwappedSizeError, decode_depth
from depthmocap.recordings.mcap_file import Channel, McapFile, Message, iterate_topics
from depthmocap.recordings.mcap_messages import (
    CALIBRATION,
    COMPRESSED_IMAGE,
    RAW_IMAGE,
    TRANSFORM,
    Calibration,
    Image,
    Transform,
    image_time_ns,
    read_calibration,
    read_image,
    read_transform,
)
from depthmocap.recordings.mcap_writer import METADATA, SHARED_CLOCK, TRUTH_TOPIC, VERSION
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.true_joints import TrueJoints

_Read = TypeVar("_Read")

#: How much the length of a quaternion may differ from 1.
_QUATERNION_TOLERANCE = 0.01
#: The first bytes of an image message, enough to hold its time.
_HEAD_BYTES = 32


@dataclasses.dataclass(frozen=True, eq=False)
class _Images:
    """The images of one camera: their messages and their device times (ns) by timestamp, and the device's clock."""

    channel: Channel
    messages: dict[int, Message]
    times_ns: dict[int, int]
    clock: str


class McapRecording(Recording):
    """A recording in an MCAP file, as a sequence of frame sets.

    Sets are formed by the frames' own times if all cameras share a clock, and otherwise by the times at which frames
    arrived at the host (the log times). A file that was cut off is read up to the cut, and ``problems`` reports it.

    Attributes:
        complete: whether the file was finished.
    """

    def _load(self) -> tuple[Rig, dict[str, list[int]]]:
        self._file = McapFile(self.path)
        self.complete = self._file.complete
        for problem in self._file.problems:
            self._note(problem)
        if not self.complete:
            self._note(f"{self.path} was cut off; what is in it is read (depthmocap recover makes a whole file of it)")
        metadata = self._file.metadata.get(METADATA, {})
        if metadata and metadata.get("version") != VERSION:
            raise InputError(
                f"{self.path} is a recording of version {metadata.get('version')}; "
                f"this depthmocap reads version {VERSION}"
            )
        calibrations: dict[str, Calibration] = {}
        transforms: dict[str, tuple[Transform, Channel]] = {}
        depth: list[tuple[Channel, list[Message]]] = []
        backgrounds: list[tuple[Channel, list[Message]]] = []
        self._truth_messages: list[Message] = []
        for channel, messages in iterate_topics(self._file):
            if not messages:
                continue
            if channel.schema_name == CALIBRATION:
                for calibration in self._all(messages, read_calibration):  # the last readable one counts
                    calibrations[calibration.frame_id] = calibration
            elif channel.schema_name == TRANSFORM:
                for transform in self._all(messages, read_transform):  # one channel may hold many cameras' transforms
                    transforms[transform.child] = (transform, channel)
            elif channel.schema_name in (RAW_IMAGE, COMPRESSED_IMAGE):
                (backgrounds if channel.metadata.get("kind") == "background" else depth).append((channel, messages))
            elif channel.topic == TRUTH_TOPIC and channel.encoding == "json":
                self._truth_messages = messages
        if not calibrations:
            needed = f"{CALIBRATION}: without it depth is no use; record with depthmocap"
            raise InputError(f"{self.path} has no {needed}{self._why()}")
        names = safe_names(calibrations)  # other writers use names such as /left/depth
        for frame, name in names.items():
            if name != frame:
                self._note(f"{self.path}: camera {frame!r} is called {name!r} here, as files and folders can be")
        images = self._by_camera(depth, calibrations)
        self._images = {names[frame]: camera_images for frame, camera_images in images.items()}
        self._empty: dict[str, tuple[Channel, Message]] = {}
        for channel, messages in backgrounds:
            try:
                frame = self._first(channel, messages).frame_id
                self._empty[names.get(frame, frame)] = (channel, messages[0])
            except InputError as error:
                self._note(f"a background is left out: {error}")
        cameras = tuple(
            self._camera(name, calibrations[frame], self._pose(frame, transforms), self._images.get(name))
            for frame, name in names.items()
        )
        if not any(images.messages for images in self._images.values()):
            called = ", ".join(names.values())
            raise InputError(f"{self.path} has no depth frame of its cameras ({called}){self._why()}")
        stamps = {name: list(self._images[name].messages) if name in self._images else [] for name in names.values()}
        area_m = parse_area(parse_json(metadata.get("area_m", "[]"), f"{self.path}: area_m"), str(self.path))
        return Rig(cameras, check_up(metadata.get("up", "z"), str(self.path)), area_m), stamps

    def _check_first(self, name: str, stamps: list[int]) -> None:
        """Check the first readable frame. All frames have one writer, so a damaged first frame is only a lost one."""
        errors: list[InputError] = []
        for stamp in stamps[:3]:
            try:
                self.raw(name, stamp)
            except SwappedSizeError:
                raise
            except InputError as error:
                errors.append(error)
                continue
            self._check_depth(name, stamp)
            return
        raise errors[0]

    def _all(self, messages: list[Message], read: Callable[[bytes], _Read]) -> Iterator[_Read]:
        """The contents of the undamaged messages."""
        for message in messages:
            try:
                content = read(self._file.payload(message))
            except InputError as error:
                where = f"{self.path}: "
                self._note(f"{where}{str(error).removeprefix(where)}")
                continue
            yield content

    def _why(self) -> str:
        """The first problem so far, for an error message; empty if there was none."""
        return next((f"; {problem.removeprefix(f'{self.path}: ')}" for problem in self._problems), "")

    def close(self) -> None:
        """Close the file; frames cannot be read any more."""
        self._file.close()

    def device_time(self, name: str, stamp: int) -> tuple[int, str]:
        images = self._images[name]
        return images.times_ns[stamp], images.clock

    def raw(self, name: str, stamp: int) -> UInt16[ndarray, "h w"]:
        images = self._images[name]
        return self._decode(name, str(stamp), images.channel, images.messages[stamp])

    def raw_background(self, name: str) -> UInt16[ndarray, "h w"] | None:
        if name not in self._empty:
            return None
        return self._decode(name, "background", *self._empty[name])

    def _where(self, name: str, what: str) -> str:
        return f"{self.path}: frame {what} of {name!r}"

    def _decode(self, name: str, what: str, channel: Channel, message: Message) -> UInt16[ndarray, "h w"]:
        camera = self.rig[name]
        try:
            image = read_image(self._file.payload(message), channel.schema_name)
            coding = "raw" if channel.schema_name == RAW_IMAGE else image.format
            return decode_depth(image.data, coding, (camera.width, camera.height))
        except SwappedSizeError:
            raise
        except InputError as error:
            raise InputError(f"{self._where(name, what)}: {error}") from None

    def _first(self, channel: Channel, messages: list[Message]) -> Image:
        """The first undamaged picture."""
        for message in messages[:-1]:
            try:
                return read_image(self._file.payload(message), channel.schema_name)
            except InputError:
                continue
        return read_image(self._file.payload(messages[-1]), channel.schema_name)

    def _by_camera(
        self, depth: list[tuple[Channel, list[Message]]], calibrations: dict[str, Calibration]
    ) -> dict[str, _Images]:
        """The depth images of each calibrated camera, by the timestamps from which sets are formed."""
        clocks = {channel.metadata.get("clock", SHARED_CLOCK) for channel, _ in depth}
        by_camera: dict[str, _Images] = {}
        for channel, messages in depth:
            try:
                image = self._first(channel, messages)
            except InputError as error:
                self._note(f"{self.path}: {channel.topic} is not read: {error}")
                continue
            if channel.schema_name == RAW_IMAGE and image.format not in ("16UC1", "mono16"):
                continue
            if channel.schema_name == COMPRESSED_IMAGE and not channel.metadata.get("kind") and image.format != "png":
                continue
            if image.frame_id not in calibrations or image.frame_id in by_camera:
                reason = "has no calibration" if image.frame_id not in calibrations else "has another depth topic"
                self._note(f"{self.path}: {channel.topic} is not read: its frame {image.frame_id!r} {reason}")
                continue
            messages, times = self._timed(image.frame_id, messages)
            stamps = times if len(clocks) == 1 else [message.log_time_ns for message in messages]
            order = sorted(range(len(stamps)), key=stamps.__getitem__)
            by_stamp: dict[int, Message] = {}
            times_ns: dict[int, int] = {}
            for i in order:
                if stamps[i] in by_stamp:
                    self._note(f"{self._where(image.frame_id, str(stamps[i]))}: written twice; the first is read")
                    continue
                by_stamp[stamps[i]], times_ns[stamps[i]] = messages[i], times[i]
            clock = channel.metadata.get("clock", SHARED_CLOCK)
            by_camera[image.frame_id] = _Images(channel, by_stamp, times_ns, clock)
        return by_camera

    def _timed(self, name: str, messages: list[Message]) -> tuple[list[Message], list[int]]:
        """The images that have a possible time, and these times (ns)."""
        times = []
        for message in messages:
            try:
                times.append(image_time_ns(self._file.head(message, _HEAD_BYTES)))
            except InputError:
                times.append(-1)
        timed = [i for i, time in enumerate(times) if max(time, messages[i].log_time_ns) < 2**63 and time >= 0]
        if lost := len(messages) - len(timed):
            self._note(f"{self.path}: {lost} frames of {name!r} have no time that can be, and are left out")
        return [messages[i] for i in timed], [times[i] for i in timed]

    def _camera(
        self, name: str, calibration: Calibration, pose: Float[ndarray, "4 4"], images: _Images | None
    ) -> DepthCamera:
        if calibration.model not in ("", "plumb_bob") or calibration.distortion.size not in (0, 5):
            raise InputError(
                f"{self.path}: camera {name!r} has the lens model {calibration.model!r} with "
                f"{calibration.distortion.size} numbers: expected plumb_bob with 5"
            )
        where, matrix = f"{self.path}: camera {name!r}", calibration.matrix
        metadata = images.channel.metadata if images else {}
        k1, k2, p1, p2, k3 = calibration.distortion.tolist() or [0.0] * 5
        camera = DepthCamera(
            name, calibration.width, calibration.height, float(matrix[0, 0]), float(matrix[1, 1]),
            float(matrix[0, 2]), float(matrix[1, 2]), pose, (k1, k2, p1, p2, k3),
            number_from_text(metadata.get("depth_unit_m", "0.001"), f"{where}: depth_unit_m"),
            number_from_text(metadata.get("time_offset_s", "0"), f"{where}: time_offset_s"),
            number_from_text(metadata.get("depth_factor", "1"), f"{where}: depth_factor"),
            metadata.get("mirrored") == "true",
        )  # fmt: skip
        check_camera(camera, where)
        return camera

    def _pose(self, name: str, transforms: dict[str, tuple[Transform, Channel]]) -> Float[ndarray, "4 4"]:
        """``world_from_camera``: from our exact metadata, or else from the chain of transforms to the root."""
        pose, frame, visited = None, name, set[str]()
        while frame in transforms and frame not in visited:
            visited.add(frame)
            transform, channel = transforms[frame]
            step, where = np.eye(4), f"{self.path}: the transform of {frame!r}"
            if exact := channel.metadata.get("world_from_camera"):
                step = array(parse_json(exact, f"{where}: world_from_camera"), (4, 4), f"{where}: world_from_camera")
            else:
                if np.any(transform.rotation):  # all zeros mean no rotation
                    if not abs(np.linalg.norm(transform.rotation) - 1) < _QUATERNION_TOLERANCE:
                        numbers = ", ".join(f"{number:g}" for number in transform.rotation)
                        raise InputError(f"{where} has the quaternion ({numbers}): its length must be 1")
                    step[:3, :3] = Rotation.from_quat(transform.rotation).as_matrix()
                step[:3, 3] = transform.translation
            pose, frame = step if pose is None else step @ pose, transform.parent
        return np.eye(4) if pose is None else pose

    def _load_truth(self) -> TrueJoints | None:
        """The true joints as they were recorded, without damaged messages."""
        rows: list[tuple[int, Float[ndarray, "18 3"]]] = []
        for message in self._truth_messages:
            where = f"{self.path}: the true joints at {message.log_time_ns}"
            try:
                rows.append(_true_joints(parse_json(self._file.payload(message), where), where))
            except InputError as error:
                self._note(f"{error}: they are left out")
        if not rows:
            return None
        rows.sort(key=lambda row: row[0])
        # Files made of a truth.csv that counted from the first frame do so too.
        stamps_ns = np.array([stamp for stamp, _ in rows], np.int64)
        return TrueJoints(stamps_ns, np.stack([joints for _, joints in rows]), on_clock=False)


def _true_joints(document: Any, where: str) -> tuple[int, Float[ndarray, "18 3"]]:
    """Time (ns) and joints of a message."""
    joints = document.get("joints") if isinstance(document, dict) else None
    if not isinstance(joints, dict):
        raise InputError(f"{where} lack all joints")
    if absent := [joint for joint in JOINTS if joint not in joints]:
        raise InputError(f"{where} lack {absent[0]}")
    time_ns = whole_number(document.get("timestamp_ns"), f"{where}: timestamp_ns")
    return time_ns, array([joints[joint] for joint in JOINTS], (len(JOINTS), 3), where, unknown=True)
