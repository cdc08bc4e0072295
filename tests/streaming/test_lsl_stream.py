"""A pylsl inlet on this machine receives joints with their labels, units and times, and markers."""

from __future__ import annotations

import dataclasses
import os
import time
from typing import Any

import numpy as np
from receivers import lsl, lsl_inlet
from samples import EMPTY_RIG, sample_of, standing_pose

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.recordings.pose_table import HEADER
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.stream_protocol import Marker, Stream, StreamSetup

__all__ = ["lsl"]


def opened(lsl: Any, people: int) -> tuple[Stream, Any, Any]:
    """A stream, and inlets of its joints and markers."""
    name = f"place {os.getpid()} {people}"
    stream, told = open_stream(f"lsl://{name}"), list[str]()
    stream.start(StreamSetup(EMPTY_RIG, people, told.append))
    assert told == [f"Lab Streaming Layer has the streams {name} and {name}-markers, on all interfaces"]
    return stream, lsl_inlet(lsl, name), lsl_inlet(lsl, f"{name}-markers")


def test_joints_with_labels_units_and_times(lsl: Any) -> None:
    stream, joints, markers = opened(lsl, 1)
    info = joints.info(10)
    assert (info.type(), info.channel_count(), info.nominal_srate()) == ("MoCap", 72, 0)
    assert tuple(info.get_channel_labels()) == HEADER[1:-1]
    assert info.get_channel_types()[:4] == ["PositionX", "PositionY", "PositionZ", "Confidence"]
    assert info.get_channel_units()[:4] == ["meters", "meters", "meters", "normalized"]
    assert info.desc().child("acquisition").child_value("manufacturer") == "depthmocap"
    assert info.desc().child("setup").child_value("up") == "z"
    pose, now_ns = standing_pose(time.monotonic_ns()), time.monotonic_ns()
    pose.joints[3], pose.confidence[3] = np.nan, 0
    stream.send(sample_of(pose))
    stream.mark(Marker("trial 3 – ä", 0, now_ns))
    values, stamp_s = joints.pull_sample(10)
    wanted = np.column_stack([pose.joints, pose.confidence])
    np.testing.assert_allclose(np.reshape(values, (18, 4)), wanted, atol=1e-6)
    assert abs(stamp_s - lsl.local_clock() + (time.monotonic_ns() - pose.timestamp_ns) * 1e-9) < 0.001
    text, marked_s = markers.pull_sample(10)
    assert text == ["trial 3 – ä"] and abs(marked_s - stamp_s) < 1
    stream.send(sample_of())
    assert np.isnan(joints.pull_sample(10)[0]).all()
    stream.close()


def test_several_people_keep_their_places(lsl: Any) -> None:
    stream, joints, _ = opened(lsl, 2)
    labels = joints.info(10).get_channel_labels()
    assert len(labels) == 146 and labels[0] == "P1_number" and labels[73:75] == ["P2_number", "P2_Head_x"]
    first, second, third = (standing_pose(x=float(x)) for x in range(3))
    hip = 1 + 4 * JOINT_INDEX["Hip"]
    for people, numbers in (
        ({4: first, 7: second}, [4, 7]),
        ({7: second}, [0, 7]),
        ({9: third, 7: second}, [9, 7]),
        ({9: third, 7: second, 11: first}, [9, 7]),
        ({11: first}, [11, 0]),
    ):
        stream.send(dataclasses.replace(sample_of(first), people=people))
        values = np.reshape(joints.pull_sample(10)[0], (2, 73))
        assert values[:, 0].tolist() == numbers
        for row, number in zip(values, numbers, strict=True):
            if number:
                np.testing.assert_allclose(row[hip : hip + 3], people[number].joints[JOINTS.index("Hip")], atol=1e-6)
            else:
                assert np.isnan(row[1:]).all()
    stream.close()
