"""A client of Foxglove's protocol receives skeleton, joints, cloud, depth and transforms in Foxglove's schemas."""

from __future__ import annotations

import dataclasses
import socket
import struct
import time
from collections.abc import Iterator

import numpy as np
import pytest
from fakes import Board
from receivers import FoxgloveClient, wait_until
from samples import EMPTY_RIG, sample_of, standing_pose

from depthmocap.body.regions import DISPLAY_COLOURS
from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, View
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.recordings.mcap_messages import read_fields, read_image, read_transform
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.foxglove_stream import FoxgloveStream
from depthmocap.streaming.stream_protocol import Marker, StreamSetup

pytest.importorskip("foxglove")
pytest.importorskip("websockets")


@pytest.fixture
def stream() -> Iterator[FoxgloveStream]:
    opened = FoxgloveStream("127.0.0.1", 0)
    opened.start(StreamSetup(EMPTY_RIG))
    yield opened
    opened.close()


def blobs(data: int | bytes, number: int) -> list[bytes]:
    """The values of a field of a message."""
    assert isinstance(data, bytes)
    return [each for each in read_fields(data).get(number, []) if isinstance(each, bytes)]


def vector(data: bytes) -> list[float]:
    fields = read_fields(data)
    zero = bytes(8)
    return [struct.unpack("<d", bytes(fields.get(i, [zero])[0]))[0] for i in (1, 2, 3)]  # pyright: ignore[reportArgumentType]


def joints_of(data: bytes) -> dict[str, list[float]]:
    """Frames of a FrameTransforms message and where they are."""
    transforms = [read_transform(each) for each in blobs(data, 1)]
    assert {each.parent for each in transforms} <= {"world"}
    return {each.child: each.translation.tolist() for each in transforms}


def client_of(stream: FoxgloveStream) -> FoxgloveClient:
    """One that gets everything from now on."""
    client = FoxgloveClient(stream.port)
    channels = (stream._people, stream._joints, stream._cloud, stream._markers)
    wait_until(lambda: all(channel.has_sinks() for channel in channels))
    return client


def test_a_skeleton_and_its_joints(stream: FoxgloveStream) -> None:
    client = client_of(stream)
    one, two = standing_pose(40_000_000), standing_pose(40_000_000, x=1.0)
    two.joints[JOINT_INDEX["LHand"]] = np.nan
    stream.send(sample_of(one, two))
    stream.mark(Marker("trial 3", 1_700_000_000_050_000_000, 0))
    stream.send(sample_of(one))
    wait_until(lambda: len(client.of("/joints")) == 2 and len(client.of("/people")) == 2 and client.of("/markers"))
    client.close()
    stamp_ns, joints = client.of("/joints")[0]
    assert stamp_ns == 1_700_000_000_040_000_000
    found = joints_of(joints)
    assert set(found) == {f"person {n}/{name}" for n in (1, 2) for name in JOINTS} - {"person 2/LHand"}
    for name in JOINTS:
        np.testing.assert_allclose(found[f"person 1/{name}"], one.joints[JOINT_INDEX[name]])
    scene = client.of("/people")[0][1]
    first, second = blobs(scene, 2)
    assert blobs(first, 3) == [b"person 1"] and blobs(first, 2) == [b"world"]
    assert (len(blobs(first, 9)), len(blobs(second, 9))) == (18, 17)
    places = [vector(blobs(blobs(sphere, 1)[0], 1)[0]) for sphere in blobs(first, 9)]
    np.testing.assert_allclose(places, one.joints)
    (line,) = blobs(first, 11)
    assert len(blobs(line, 5)) == len(blobs(line, 7)) == 2 * len(BONES)
    (gone,) = blobs(client.of("/people")[1][1], 1)
    assert blobs(gone, 3) == [b"person 2"]
    assert b"trial 3" in client.of("/markers")[0][1]
    assert client.schemas["/people"] == "foxglove.SceneUpdate" and client.schemas["/cloud"] == "foxglove.PointCloud"


def test_depth_transforms_and_the_cloud(stream: FoxgloveStream) -> None:
    client, scene = client_of(stream), Board(2)
    raw = {name: scene.depth(name, 0.2) for name in scene.rig.names}
    raw["cam1"][3, 4] = 0
    frames = FrameSet(0, tuple(View(scene.rig[name], scene.rig[name].to_metres(raw[name])) for name in scene.rig.names))
    points = np.array([[0.1, 0.2, 0.3], [1.5, -2.0, 1.0]], np.float32)
    cloud = LabelledCloud(points, np.array([29, 1], np.uint8), np.ones(2, np.float32))
    sample = sample_of(standing_pose())
    person = dataclasses.replace(sample.result.people[0], cloud=cloud)
    sample = dataclasses.replace(sample, frames=frames, result=dataclasses.replace(sample.result, people=(person,)))
    for _ in range(2):  # nobody could subscribe to the pictures before there were cameras
        stream.send(sample)
        wait_until(lambda: "/cam1/depth" in client.schemas and stream.topics.is_watched("cam1"))
    wait_until(lambda: client.of("/cam0/depth") and client.of("/cam1/depth"))
    for name in scene.rig.names:
        image = read_image(client.of(f"/{name}/depth")[0][1], "foxglove.RawImage")
        np.testing.assert_array_equal(np.frombuffer(image.data, "<u2").reshape(raw[name].shape), raw[name])
    stream.send(dataclasses.replace(sample, unix_ns=sample.unix_ns + 2 * 10**9))  # described again
    wait_until(lambda: client.of("/cam1/transform") and client.of("/cam1/calibration"))
    client.close()
    transform = read_transform(client.of("/cam1/transform")[0][1])
    np.testing.assert_allclose(transform.translation, scene.rig["cam1"].world_from_camera[:3, 3])
    (data,) = blobs(client.of("/cloud")[0][1], 6)
    rows = np.frombuffer(data, np.dtype([("place", "<f4", 3), ("region", "u1"), ("colour", "u1", 4)]))
    np.testing.assert_array_equal(rows["place"], points)
    assert rows["region"].tolist() == [29, 1]
    np.testing.assert_array_equal(rows["colour"], np.hstack([DISPLAY_COLOURS[[29, 1]], [[255], [255]]]))


def test_one_that_never_reads_and_one_that_sends_garbage(stream: FoxgloveStream) -> None:
    deaf = client_of(stream)
    with socket.create_connection(("127.0.0.1", stream.port)) as raw:
        raw.sendall(b"\x00\xff" * 3000)
        deaf.listening.clear()
        cloud = LabelledCloud(np.zeros((50_000, 3), np.float32), np.ones(50_000, np.uint8), np.ones(50_000, np.float32))
        sample = sample_of(standing_pose())
        sample = dataclasses.replace(sample, result=dataclasses.replace(sample.result, people=(), cloud=cloud))
        start_s = time.monotonic()
        for _ in range(60):  # 48 MB
            stream.send(sample)
        assert time.monotonic() - start_s < 10
    deaf.listening.set()
    deaf.close()


def test_a_port_that_is_taken(stream: FoxgloveStream) -> None:
    with pytest.raises(InputError, match=f"^cannot serve on 127.0.0.1:{stream.port}: .*in use"):
        open_stream(f"foxglove://127.0.0.1:{stream.port}").start(StreamSetup(EMPTY_RIG))
