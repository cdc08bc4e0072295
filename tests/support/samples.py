"""Samples as a capture hands them to streams, of people who stand at known places."""

from __future__ import annotations

import numpy as np

from depthmocap.body.skeleton import JOINTS
from depthmocap.frames import FrameSet, Pose
from depthmocap.geometry import Rig
from depthmocap.offline.pipeline import PersonResult, Result
from depthmocap.pose.cloud import merge_views
from depthmocap.streaming.stream_protocol import Sample

#: A person's joints in the world, metres, Z up, facing -Y: (x, y, z).
STANDING = {
    "Head": (0.0, -0.111, 1.681), "Neck": (0.0, -0.074, 1.577), "Spine2": (0.0, -0.044, 1.39),
    "Spine1": (0.0, -0.057, 1.25), "Spine": (0.0, -0.04, 1.092), "Hip": (0.0, 0.0, 1.0),
    "RHip": (-0.109, -0.071, 1.003), "RKnee": (-0.11, -0.09, 0.58), "RFoot": (-0.11, -0.07, 0.18),
    "LHip": (0.109, -0.071, 1.003), "LKnee": (0.11, -0.09, 0.58), "LFoot": (0.11, -0.07, 0.18),
    "RShoulder": (-0.184, -0.088, 1.48), "RElbow": (-0.2, -0.07, 1.21), "RHand": (-0.22, -0.18, 0.98),
    "LShoulder": (0.184, -0.088, 1.48), "LElbow": (0.45, -0.07, 1.46), "LHand": (0.7, -0.12, 1.44),
}  # fmt: skip


def standing_pose(timestamp_ns: int = 0, x: float = 0.0) -> Pose:
    """Somebody who stands at ``x``, the left arm out, sure to 0.9 of all joints."""
    joints = np.array([STANDING[name] for name in JOINTS]) + np.array([x, 0.0, 0.0])
    return Pose(timestamp_ns, joints, np.full(len(JOINTS), 0.9))


def sample_of(*poses: Pose, frames: FrameSet | None = None) -> Sample:
    """A sample of people 1, 2, …; of nobody without poses."""
    cloud = merge_views([])
    people = tuple(PersonResult(i + 1, pose, (), (), cloud) for i, pose in enumerate(poses))
    first = poses[0] if poses else Pose(0, np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS)))
    result = Result(first, (), (), cloud, {}, people)
    stamp_ns = first.timestamp_ns
    return Sample(
        result,
        {person.number: person.pose for person in people},
        frames or FrameSet(stamp_ns, ()),
        1_700_000_000_000_000_000 + stamp_ns,
        stamp_ns,
    )


EMPTY_RIG = Rig(())
