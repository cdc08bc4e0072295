"""Results of a take with two people, gaps, unsure joints and lost frames, as ``run`` writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, PARENTS
from depthmocap.exporting.bone_rotations import REST
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import PeopleFiles, PoseFiles
from depthmocap.exporting.summary import Take
from depthmocap.frames import Pose
from depthmocap.geometry import z_up_from

START_NS = 1_700_000_000_123_456_789
FRAME_NS = 33_333_333
FRAMES = 40
#: Frames that are lost, and those before, in and after which the second person is there.
LOST = range(30, 32)
SECOND = range(5, 25)
#: Frames without the first person's right wrist, for a short time and a long one.
SHORT, LONG = range(10, 13), range(15, 26)


def walking(frames: int, turn_rad: float = 1.0) -> np.ndarray:
    """Joints (t, 18, 3), Z up, of a skeleton of constant bones that turns, and bends and swings its limbs as people
    can."""
    from scipy.spatial.transform import Rotation

    time = np.linspace(0, 2 * np.pi, frames)
    world: dict[str, Rotation] = {}
    joints = np.zeros((frames, len(JOINTS), 3))
    for number, (joint, parent) in enumerate(PARENTS.items()):
        swing = Rotation.from_euler("xyz", 0.5 * np.sin(time[:, None] + [number, 2 * number, 3 * number]))
        if joint[1:] in ("Elbow", "Knee"):  # hinges: to the front and to the back
            bend = 0.6 + 0.5 * np.sin(time + number)
            swing = Rotation.from_euler("x" if joint[1:] == "Knee" else "y", bend[:, None])
            swing = swing.inv() if joint == "LElbow" else swing
        if parent is None:
            world[joint] = Rotation.from_euler("Y", turn_rad * time[:, None])
            joints[:, JOINT_INDEX[joint]] = np.stack([np.sin(time), 0.95 + 0.05 * np.cos(time), time / 4], -1)
            continue
        direction, length = REST[joint]
        offset = np.array(direction) / np.linalg.norm(direction) * length
        joints[:, JOINT_INDEX[joint]] = joints[:, JOINT_INDEX[parent]] + world[parent].apply(offset)
        world[joint] = world[parent] * swing
    return joints @ z_up_from("y").T


def write_take(folder: Path, up: str = "z") -> np.ndarray:
    """Write a take into a folder; returns the true joints of both people (2, t, 18, 3) in the rig's world."""
    first = walking(FRAMES)
    second = 0.9 * walking(FRAMES, -1.0) + [1.5, 0.5, 0.0]
    truth = np.stack([first, second]) @ z_up_from(up)
    wrist = JOINT_INDEX["RHand"]
    take = Take("run", ["somewhere"], up, FileSettings())
    with PoseFiles(folder, take) as files, PeopleFiles(folder, take) as everybody:
        for i in range(FRAMES):
            if i in LOST:
                continue
            joints, confidence = truth[:, i].copy(), np.full((2, len(JOINTS)), 0.9)
            if i in SHORT or i in LONG:
                joints[0, wrist], confidence[0, wrist] = np.nan, 0.0
            confidence[0, JOINT_INDEX["LHand"]] = 0.1 if i in SHORT else 0.9
            poses = [Pose(START_NS + i * FRAME_NS, *person) for person in zip(joints, confidence, strict=True)]
            files.write(poses[0])
            everybody.write({1: poses[:1], **({2: poses[1:]} if i in SECOND else {})})
    return truth
