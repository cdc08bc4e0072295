"""``foxglove://HOST:PORT``: a server for Foxglove, or any viewer of its protocol, by Foxglove's SDK.

    /<camera>/calibration, /<camera>/transform   the cameras, again every second
    /<camera>/depth    foxglove.RawImage         depth in the camera's units
    /people            foxglove.SceneUpdate      a skeleton for each person: joints from red (a guess) to green
    /joints            foxglove.FrameTransforms  each joint as a frame "person 1/Head" in "world"
    /cloud             foxglove.PointCloud       everybody's points with their body regions and the regions' colours
    /markers           foxglove.Log              markers

"world" is the rig's world, metres; times are those of the exposure. What nobody has subscribed to costs nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, UInt8, UInt16
from numpy import ndarray

from depthmocap.body.regions import DISPLAY_COLOURS
from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose, View
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.recordings.mcap_writer import WORLD, Topics, load_sdk
from depthmocap.streaming.addresses import place
from depthmocap.streaming.stream_protocol import Marker, Sample, Stream, StreamSetup

#: Rig and calibration are sent again after so much time (ns), because viewers may connect at any time.
DESCRIBE_NS = 1_000_000_000
#: Messages that wait for a slow viewer, of all topics together; beyond them the oldest is dropped.
_BACKLOG = 32
#: Width of bones (m).
_BONE_M = 0.02
#: Width of joints (m).
_JOINT_M = 0.04
#: A point of the cloud: its place, region and colour.
_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("region", "u1"),
                   ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1")])  # fmt: skip


class FoxgloveStream(Stream):
    """Serves what a capture sees and finds.

    Attributes:
        topics: of a recording's frames and true joints, while it runs.
    """

    topics: Topics

    def __init__(self, host: str, port: int) -> None:
        """Raises InputError when Foxglove's SDK is not installed."""
        self._sdk = load_sdk()
        self._host, self._port = host, port
        self._server: Any = None
        self._described_ns: int | None = None
        self._shown: set[int] = set()

    @property
    def port(self) -> int:
        """The port of the running server."""
        return self._server.port

    def start(self, setup: StreamSetup) -> None:
        """Listen.

        Raises:
            InputError: when the port is taken, or the host is none of this machine's.
        """
        context, channels = self._sdk.Context(), self._sdk.channels
        self._described_ns, self._shown = None, set()
        self.topics = Topics(self._sdk, context, setup.rig, "raw")
        self._people = channels.SceneUpdateChannel("/people", context=context)
        self._joints = channels.FrameTransformsChannel("/joints", context=context)
        self._cloud = channels.PointCloudChannel("/cloud", context=context)
        self._markers = channels.LogChannel("/markers", context=context)
        try:
            self._server = self._sdk.start_server(
                name="depthmocap", host=self._host, port=self._port, context=context, message_backlog_size=_BACKLOG
            )
        except RuntimeError as error:
            reason = str(error).removeprefix("FoxgloveError: ").removeprefix("Failed to bind port: ")
            raise InputError(f"cannot serve on {place(self._host, self._port)}: {reason}") from None
        setup.tell(f"open ws://{place(self._host, self.port)} in Foxglove")

    def send(self, sample: Sample) -> None:
        """See :class:`Stream`."""
        now_ns, timestamp = sample.unix_ns, self.topics.time(sample.unix_ns)
        if sample.frames.views:
            self._show_views(sample.frames.views, now_ns)
        if self._people.has_sinks():
            self._people.log(self._scene(sample.people, timestamp), log_time=now_ns)
        if self._joints.has_sinks():
            self._joints.log(self._frames(sample.people, timestamp), log_time=now_ns)
        if self._cloud.has_sinks():
            clouds = [person.cloud for person in sample.result.people] or [sample.result.cloud]
            self._cloud.log(self._points(clouds, timestamp), log_time=now_ns)

    def mark(self, marker: Marker) -> None:
        """See :class:`Stream`."""
        messages = self._sdk.messages
        line = messages.Log(
            timestamp=self.topics.time(marker.unix_ns), level=messages.LogLevel.Info, message=marker.text, name="marker"
        )
        self._markers.log(line, log_time=marker.unix_ns)

    def close(self) -> None:
        """See :class:`Stream`."""
        self._server.stop()

    def _show_views(self, views: tuple[View, ...], now_ns: int) -> None:
        for view in views:
            if view.camera.name not in self.topics.rig.names:  # it came later
                self.topics.add(view.camera)
                self._described_ns = None
        if self._described_ns is None or not 0 <= now_ns - self._described_ns < DESCRIBE_NS:
            self.topics.describe(now_ns)
            self._described_ns = now_ns
        for view in views:
            if self.topics.is_watched(view.camera.name):
                image = self.topics.image(view.camera.name, now_ns, _raw(view))
                self.topics.depth(view.camera.name, image, now_ns)

    def _scene(self, people: dict[int, Pose], timestamp: Any) -> Any:
        """Skeletons of everybody; those who have gone are removed."""
        messages = self._sdk.messages
        gone, self._shown = self._shown - set(people), set(people)
        return messages.SceneUpdate(
            deletions=[messages.SceneEntityDeletion(timestamp=timestamp, id=f"person {number}") for number in gone],
            entities=[self._skeleton(number, pose, timestamp) for number, pose in people.items()],
        )

    def _skeleton(self, number: int, pose: Pose, timestamp: Any) -> Any:
        messages = self._sdk.messages
        places = {
            name: place
            for name, place in zip(JOINTS, pose.joints.astype(float).tolist(), strict=True)
            if np.isfinite(place).all()
        }
        colours = {
            name: messages.Color(r=1 - sure, g=sure, b=0.2, a=1.0)
            for name, sure in zip(JOINTS, np.clip(pose.confidence, 0, 1).tolist(), strict=True)
        }
        ends = [name for bone in BONES if places.keys() >= set(bone) for name in bone]
        lines = messages.LinePrimitive(
            type=messages.LinePrimitiveLineType.LineList, thickness=_BONE_M,
            points=[messages.Point3(x=places[name][0], y=places[name][1], z=places[name][2]) for name in ends],
            colors=[colours[name] for name in ends],
        )  # fmt: skip
        size = messages.Vector3(x=_JOINT_M, y=_JOINT_M, z=_JOINT_M)
        spheres = [
            messages.SpherePrimitive(
                pose=messages.Pose(position=messages.Vector3(x=x, y=y, z=z)), size=size, color=colours[name]
            )
            for name, (x, y, z) in places.items()
        ]
        return messages.SceneEntity(
            timestamp=timestamp, frame_id=WORLD, id=f"person {number}", lines=[lines], spheres=spheres
        )

    def _frames(self, people: dict[int, Pose], timestamp: Any) -> Any:
        messages = self._sdk.messages
        return messages.FrameTransforms(
            transforms=[
                messages.FrameTransform(
                    timestamp=timestamp, parent_frame_id=WORLD, child_frame_id=f"person {number}/{name}",
                    translation=messages.Vector3(x=x, y=y, z=z), rotation=messages.Quaternion(x=0, y=0, z=0, w=1),
                )
                for number, pose in people.items()
                for name, (x, y, z) in zip(JOINTS, pose.joints.astype(float).tolist(), strict=True)
                if np.isfinite(pose.joints[JOINT_INDEX[name]]).all()
            ]
        )  # fmt: skip

    def _points(self, clouds: list[LabelledCloud], timestamp: Any) -> Any:
        messages = self._sdk.messages
        kinds = messages.PackedElementFieldNumericType
        assert _POINT.names is not None and _POINT.fields is not None
        return messages.PointCloud(
            timestamp=timestamp, frame_id=WORLD, pose=messages.Pose(), point_stride=_POINT.itemsize,
            fields=[
                messages.PackedElementField(
                    name=name, offset=_POINT.fields[name][1], type=kinds.Float32 if name in "xyz" else kinds.Uint8
                )
                for name in _POINT.names
            ],
            data=packed_points(
                np.concatenate([cloud.points_world for cloud in clouds]),
                np.concatenate([cloud.labels for cloud in clouds]),
            ),
        )  # fmt: skip


def packed_points(points_world: Float[ndarray, "n 3"], labels: UInt8[ndarray, " n"]) -> bytes:
    """Points, their regions and the regions' colours, as they are in a message."""
    packed = np.empty(len(labels), _POINT)
    for i, axis in enumerate("xyz"):
        packed[axis] = points_world[:, i]
    colours = DISPLAY_COLOURS[np.minimum(labels, len(DISPLAY_COLOURS) - 1)]
    for i, channel in enumerate(("red", "green", "blue")):
        packed[channel] = colours[:, i]
    packed["region"], packed["alpha"] = labels, 255
    return packed.tobytes()


def _raw(view: View) -> UInt16[ndarray, "h w"]:
    """Depth in the camera's units, as it came."""
    camera = view.camera
    raw = np.rint(np.nan_to_num(view.depth_m) / (camera.depth_unit_m * camera.depth_factor)).astype(np.uint16)
    return np.ascontiguousarray(raw[:, ::-1]) if camera.mirrored else raw
