"""Writes recordings as MCAP with Foxglove's message types, through Foxglove's SDK.

    /<camera>/calibration   foxglove.CameraCalibration     intrinsics and distortion
    /<camera>/transform     foxglove.FrameTransform        its pose in "world"
    /<camera>/depth         foxglove.CompressedImage, or foxglove.RawImage with the coding "raw"
    /<camera>/background    the same: the empty scene, if known
    /truth                  JSON: the true joints, if known

Metadata hold what these types cannot: the file's metadata the world's up axis; a depth channel's the camera's clock,
the coding and the length of a depth unit; a transform channel's the exact matrix.

Every frame is a chunk of its own and is handed to the system at once, in one piece. So the frame is in the file,
whatever happens to this process afterwards.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.errors import InputError, missing_extra
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.recordings.depth_codec import CODINGS, Coding, encode_depth
from depthmocap.recordings.recording_layout import UnfitFrameError, check_frame

#: Name of our metadata record in the file.
METADATA = "depthmocap"
#: Version of the file's contents.
VERSION = "1"
#: Clock name of cameras whose timestamps can be compared directly.
SHARED_CLOCK = "recording"
#: Topic of the true joints.
TRUTH_TOPIC = "/truth"
#: Name of the world's frame.
WORLD = "world"
#: End of the possible times (ns): Foxglove's times have 32 bits of seconds.
_LATEST_NS = 2**32 * 10**9
#: JSON schema of the true joints.
TRUTH_SCHEMA = {
    "type": "object",
    "title": "depthmocap.TrueJoints",
    "properties": {
        "timestamp_ns": {"type": "integer"},
        "joints": {
            "type": "object",
            "additionalProperties": {"type": "array", "items": {"type": ["number", "null"]}},
            "description": f"metres in the rig's world, of {', '.join(JOINTS)}; null where unknown",
        },
    },
}


def load_sdk() -> Any:
    """Foxglove's SDK. Raises InputError when it is not installed."""
    try:
        import foxglove.channels
        import foxglove.mcap
        import foxglove.messages
    except ModuleNotFoundError:
        raise missing_extra("foxglove-sdk", "record") from None
    return foxglove


def check_name(what: str, path: Path) -> None:
    """Raise InputError unless the path ends in .mcap, by which every command recognises an MCAP recording."""
    if path.suffix.lower() != ".mcap":
        raise InputError(f"{what} must end in .mcap, got {path}")


class _SystemFile:
    """The unbuffered file that the SDK writes to. It writes nothing after an error, so it ends with a whole record.

    It keeps the error in ``error`` instead of raising it, because the SDK would only log it.
    """

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self.size = 0
        self._file = io.FileIO(path, "xb")

    def write(self, data: bytes | bytearray) -> int:
        if self.error is None:
            rest = memoryview(data)
            try:
                while rest:
                    rest = rest[self._file.write(rest) :]
                self.size += len(data)
            except OSError as error:
                self.error = error
                # Removes the written part of an incomplete record.
                os.ftruncate(self._file.fileno(), self.size)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Return the position; the SDK never moves it."""
        return self.size

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""

    def close(self) -> None:
        self._file.close()


class McapSink:
    """A new MCAP file that is safe up to the last ``flush``."""

    def __init__(self, path: Path) -> None:
        """Raises InputError when the file exists, cannot be made, or the SDK is missing."""
        self.path, self.sdk, self._closed = path, load_sdk(), False
        try:
            self._file = _SystemFile(path)
        except FileExistsError:
            raise InputError(f"{path} exists already: choose a new file for the recording") from None
        except OSError as error:
            raise InputError(f"{path} cannot be written: {error.strerror}") from None
        self.context = self.sdk.Context()
        options = self.sdk.mcap.MCAPWriteOptions(
            compression=None, chunk_size=None, disable_seeking=True, profile=METADATA
        )
        self._writer = self.sdk.open_mcap(self._file, context=self.context, writer_options=options)
        self.check()

    def metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._writer.write_metadata(name, dict(entries))
        self.check()

    def channel(self, topic: str, encoding: str, metadata: Mapping[str, str], schema: Any | None) -> Any:
        """A channel of any kind. The SDK's own class allows no schema for JSON only, and then invents one."""
        return self.context._create_channel(topic, message_encoding=encoding, schema=schema, metadata=dict(metadata))

    def flush(self) -> None:
        """Hand all data over to the system.

        Raises:
            InputError: when they could not be written; the data of earlier flushes are in the file.
        """
        self._writer.flush()
        self.check()

    @property
    def fault(self) -> OSError | None:
        """The error after which nothing is written any more; None if there was none."""
        return self._file.error

    def check(self) -> None:
        """Raise InputError if something could not be written."""
        if self._file.error is not None:
            raise InputError(
                f"{self.path} cannot be written any further ({self._file.error.strerror}): "
                "the frames before are in it; make room and record to a new file"
            )

    def close(self) -> None:
        """Write the summary and close the file. A second call does nothing."""
        if not self._closed:
            self._closed = True
            self._writer.close()
            self._file.close()


class Topics:
    """Logs a rig, its frames and the true joints as Foxglove messages, for recordings and live viewers."""

    def __init__(self, sdk: Any, context: Any, rig: Rig, coding: Coding) -> None:
        self.rig = rig
        self._coding: Coding = coding
        self._sdk, self._context = sdk, context
        self._depth: dict[str, Any] = {}
        self._channels_by_camera = {camera.name: self._make_channels(camera) for camera in rig.cameras}
        self._truth = None

    def _make_channels(self, camera: DepthCamera) -> tuple[Any, Any]:
        """Channels of a camera's calibration and of its pose."""
        channels, metadata = self._sdk.channels, {"world_from_camera": json.dumps(camera.world_from_camera.tolist())}
        return (
            channels.CameraCalibrationChannel(f"/{camera.name}/calibration", context=self._context),
            channels.FrameTransformChannel(f"/{camera.name}/transform", context=self._context, metadata=metadata),
        )

    def add(self, camera: DepthCamera) -> None:
        """Add a camera; ``describe`` logs it from now on."""
        self.rig = dataclasses.replace(self.rig, cameras=(*self.rig.cameras, camera))
        self._channels_by_camera[camera.name] = self._make_channels(camera)

    def _images(self, camera: DepthCamera, kind: str, clock: str) -> Any:
        channels = self._sdk.channels
        channel = channels.RawImageChannel if self._coding == "raw" else channels.CompressedImageChannel
        metadata = {"kind": kind, "clock": clock, "coding": self._coding, "depth_unit_m": repr(camera.depth_unit_m)}
        if camera.time_offset_s:
            metadata["time_offset_s"] = repr(camera.time_offset_s)
        if camera.depth_factor != 1:
            metadata["depth_factor"] = repr(camera.depth_factor)
        if camera.mirrored:
            metadata["mirrored"] = "true"
        return channel(f"/{camera.name}/{kind}", metadata=metadata, context=self._context)

    def time(self, timestamp_ns: int) -> Any:
        """A time in Foxglove's form.

        Raises:
            UnfitFrameError: when it is out of the possible range.
        """
        if not 0 <= timestamp_ns < _LATEST_NS:
            raise UnfitFrameError(
                f"timestamp_ns must be from 0 to {_LATEST_NS - 1} (the year 2106), got {timestamp_ns}"
            )
        return self._sdk.messages.Timestamp(*divmod(timestamp_ns, 10**9))

    def describe(self, timestamp_ns: int) -> None:
        """Log the calibration and the pose of every camera."""
        messages, timestamp = self._sdk.messages, self.time(timestamp_ns)
        for camera in self.rig.cameras:
            calibrations, transforms = self._channels_by_camera[camera.name]
            calibrations.log(_calibration(messages, camera, timestamp), log_time=timestamp_ns)
            x, y, z, w = Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat().tolist()
            tx, ty, tz = camera.world_from_camera[:3, 3].tolist()
            transform = messages.FrameTransform(
                timestamp=timestamp, parent_frame_id=WORLD, child_frame_id=camera.name,
                translation=messages.Vector3(x=tx, y=ty, z=tz), rotation=messages.Quaternion(x=x, y=y, z=z, w=w),
            )  # fmt: skip
            transforms.log(transform, log_time=timestamp_ns)

    def background(self, name: str, raw: UInt16[ndarray, "h w"], timestamp_ns: int) -> None:
        """Log the empty scene."""
        channel = self._images(self.rig[name], "background", SHARED_CLOCK)
        channel.log(self.image(name, timestamp_ns, raw), log_time=timestamp_ns)

    def image(self, name: str, timestamp_ns: int, raw: UInt16[ndarray, "h w"]) -> Any:
        """The message of a depth picture."""
        timestamp, data = self.time(timestamp_ns), encode_depth(raw, self._coding)
        if self._coding != "raw":
            return self._sdk.messages.CompressedImage(
                timestamp=timestamp, frame_id=name, data=data, format=self._coding
            )
        height, width = raw.shape
        return self._sdk.messages.RawImage(
            timestamp=timestamp, frame_id=name, width=width, height=height, encoding="16UC1", step=2 * width, data=data
        )

    def is_watched(self, name: str) -> bool:
        """Whether anybody would get a picture of the camera."""
        return self._depth_channel(name, SHARED_CLOCK).has_sinks()

    def depth(self, name: str, image: Any, log_time_ns: int, clock: str = SHARED_CLOCK) -> None:
        """Log a picture that ``image`` made. The channel keeps the clock of its first frame."""
        self._depth_channel(name, clock).log(image, log_time=log_time_ns)

    def _depth_channel(self, name: str, clock: str) -> Any:
        if name not in self._depth:
            self._depth[name] = self._images(self.rig[name], "depth", clock)
        return self._depth[name]

    def truth(self, timestamp_ns: int, joints: Float[ndarray, "18 3"]) -> None:
        """Log the true joints (metres, the rig's world)."""
        if self._truth is None:
            self._truth = self._sdk.Channel(
                TRUTH_TOPIC, schema=TRUTH_SCHEMA, message_encoding="json", context=self._context
            )
        rows = [[v if np.isfinite(v) else None for v in row] for row in joints.astype(float).tolist()]
        message = {"timestamp_ns": timestamp_ns, "joints": dict(zip(JOINTS, rows, strict=True))}
        self._truth.log(json.dumps(message, allow_nan=False).encode(), log_time=timestamp_ns)


def _calibration(messages: Any, camera: DepthCamera, timestamp: Any) -> Any:
    fx, fy, cx, cy = (float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy))
    return messages.CameraCalibration(
        timestamp=timestamp, frame_id=camera.name, width=camera.width, height=camera.height,
        distortion_model="plumb_bob", D=[float(k) for k in camera.distortion],
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )  # fmt: skip


class McapWriter:
    """Writes a recording frame by frame; a context manager. Several threads may write at the same time.

    Attributes:
        frames: number of frames written so far, by camera.
    """

    def __init__(
        self,
        path: Path,
        rig: Rig,
        backgrounds: Mapping[str, UInt16[ndarray, "_ _"]] | None = None,
        coding: Coding = "delta-zstd",
        start_ns: int | None = None,
    ) -> None:
        """Start a new file. ``start_ns``: the time of the rig and the backgrounds, by default the time of day.

        Raises:
            InputError: when the file exists or cannot be written, a background does not fit, or the SDK is missing.
        """
        if coding not in CODINGS:
            raise InputError(f"the coding must be one of {', '.join(CODINGS)}, not {coding!r}")
        self.path, self.rig = path, rig
        self.frames: dict[str, int] = dict.fromkeys(rig.names, 0)
        for name, raw in (backgrounds or {}).items():
            check_frame(path, rig, name, raw)
        self._sink = McapSink(path)
        self._lock, self._closed = threading.Lock(), False
        start_ns = time.time_ns() if start_ns is None else start_ns
        self._latest_ns = start_ns
        try:
            self._topics = Topics(self._sink.sdk, self._sink.context, rig, coding)
            area = {"area_m": json.dumps(rig.area_m)} if rig.area_m else {}
            self._sink.metadata(METADATA, {"version": VERSION, "up": rig.up, **area})
            self._topics.describe(start_ns)
            self._sink.flush()  # all frames need the calibrations, so they have a small chunk of their own
            for name, raw in (backgrounds or {}).items():
                self._topics.background(name, raw, start_ns)
            self._sink.flush()
        except InputError:
            self._sink.close()
            raise

    def add_camera(self, camera: DepthCamera) -> None:
        """Record one more camera from now on.

        Raises:
            InputError: when a camera of its name is in the file, or the file cannot be written any further.
        """
        if camera.name in self.rig.names:
            raise InputError(f"{self.path} has a camera {camera.name!r} already")
        with self._lock:
            self._sink.check()
            self._topics.add(camera)
            self._topics.describe(time.time_ns())
            self._sink.flush()
            self.rig, self.frames[camera.name] = self._topics.rig, 0

    def write(
        self,
        name: str,
        timestamp_ns: int,
        raw: UInt16[ndarray, "_ _"],
        log_time_ns: int | None = None,
        clock: str = SHARED_CLOCK,
    ) -> None:
        """Add a frame.

        Args:
            name: the camera.
            timestamp_ns: the frame's time, by ``clock``.
            raw: depth in the camera's units.
            log_time_ns: the host's time of day at the frame's arrival, which relates cameras with different clocks; by
                default the frame's own time.
            clock: name of the clock; cameras with equal names share one clock.

        Raises:
            UnfitFrameError: when the frame does not fit the rig, or the file cannot hold its time.
            InputError: when the file cannot be written any further.
        """
        check_frame(self.path, self.rig, name, raw)
        image = self._topics.image(name, timestamp_ns, raw)  # the costly part needs no lock
        log_time_ns = timestamp_ns if log_time_ns is None else log_time_ns
        with self._lock:
            self._sink.check()
            self._topics.depth(name, image, log_time_ns, clock)
            self._latest_ns = max(self._latest_ns, log_time_ns)
            self._sink.flush()
            self.frames[name] += 1

    def write_truth(self, timestamp_ns: int, joints: Float[ndarray, "18 3"]) -> None:
        """Add the true joints of an instant (metres, the rig's world)."""
        with self._lock:
            self._topics.truth(timestamp_ns, joints)
            self._sink.flush()

    @property
    def fault(self) -> OSError | None:
        """The error after which nothing is written any more; None if there was none."""
        return self._sink.fault

    def check(self) -> None:
        """Raise InputError if something could not be written."""
        self._sink.check()

    def close(self) -> None:
        """Finish the file. Its end repeats the calibrations, without which no frame is of use."""
        with self._lock:
            if not self._closed:
                self._closed = True
                with contextlib.suppress(InputError):  # writing the frames has reported it already
                    self._sink.check()
                    self._topics.describe(self._latest_ns)
                    self._sink.flush()
            self._sink.close()

    def __enter__(self) -> McapWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with deferred_interrupts():
            self.close()
