"""Joints of somebody who walks, sits and stands by formulas, so that every number of the walk is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import PoseFiles
from depthmocap.exporting.summary import Take
from depthmocap.frames import Pose

FPS = 30.0
START_NS = 1_700_000_000_000_000_000
#: Of each step: its length (m) and time from one foot's landing to the other's (s), and how long a foot swings.
STEP_M, STEP_S, SWING_S, WIDTH_M = 0.6, 0.6, 0.45, 0.2
FIRST_S = 1.0
THIGH_M, SHIN_M = 0.45, 0.43


def landings(steps: int) -> list[tuple[str, float]]:
    """Side and time of every landing."""
    return [("LR"[i % 2], FIRST_S + SWING_S + i * STEP_S) for i in range(steps)]


def walk(steps: int = 7, heading_rad: float = 0.0) -> np.ndarray:
    """Joints (t, 18, 3), Z up, of a walk from the origin along a heading, 0 facing -Y."""
    seconds = FIRST_S + steps * STEP_S + 1.0
    times_s = np.arange(round(seconds * FPS)) / FPS
    along = {side: np.zeros(len(times_s)) for side in "LR"}
    lift = {side: np.zeros(len(times_s)) for side in "LR"}
    at = {"L": 0.0, "R": 0.0}
    for i, (side, landing_s) in enumerate(landings(steps)):
        target = (i + 1) * STEP_M if i + 1 < steps else i * STEP_M
        share = np.clip((times_s - landing_s + SWING_S) / SWING_S, 0, 1)
        along[side] += (target - at[side]) * (share - np.sin(2 * np.pi * share) / (2 * np.pi))
        lift[side] += 0.1 * np.sin(np.pi * share) ** 2
        at[side] = target
    middle = (along["L"] + along["R"]) / 2
    return posed(middle, along, lift, heading_rad)


def posed(
    middle: np.ndarray, along: dict[str, np.ndarray], lift: dict[str, np.ndarray], heading_rad: float
) -> np.ndarray:
    """A straight trunk over ``middle`` with hanging arms, on feet that are somewhere."""
    zero = np.zeros(len(middle))
    joints = np.zeros((len(middle), len(JOINTS), 3))

    def put(name: str, left: float | np.ndarray, forward: np.ndarray, height: float | np.ndarray) -> None:
        joints[:, JOINT_INDEX[name]] = np.stack([zero + left, -forward, zero + height], -1)

    put("Hip", 0.0, middle - 0.07, 0.95)
    for name, height in (("Spine", 1.05), ("Spine1", 1.2), ("Spine2", 1.35), ("Neck", 1.5), ("Head", 1.6)):
        put(name, 0.0, middle, height)
    for side, sign in (("L", 1.0), ("R", -1.0)):
        put(f"{side}Hip", sign * 0.1, middle, 0.93)
        put(f"{side}Foot", sign * WIDTH_M / 2, along[side], 0.08 + lift[side])
        put(f"{side}Knee", sign * 0.1, (middle + along[side]) / 2 + 0.05, 0.5 + lift[side] / 2)
        put(f"{side}Shoulder", sign * 0.18, middle, 1.42)
        put(f"{side}Elbow", sign * 0.25, middle - 0.02, 1.15)
        put(f"{side}Hand", sign * 0.25, middle + 0.1, 0.93)
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return joints @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def write_result(folder: Path, joints: np.ndarray, confidence: np.ndarray | None = None) -> None:
    """Joints (t, 18, 3) as a folder of results."""
    if confidence is None:
        confidence = np.ones(joints.shape[:2])
    with PoseFiles(folder, Take("run", ["somewhere"], "z", FileSettings(formats=()))) as files:
        for i, row in enumerate(zip(joints, confidence, strict=True)):
            files.write(Pose(START_NS + round(i / FPS * 1e9), *row))
