"""The moving picture of the README: the packaged recording by body parts with the skeleton, as the view goes round.

python docs/scripts/motion.py docs/images/motion.webp
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray

import depthmocap
from depthmocap.body.regions import DISPLAY_COLOURS
from depthmocap.body.skeleton import BONES
from depthmocap.recordings.open_recording import packaged_recording
from depthmocap.report.drawing import animation

WIDTH, HEIGHT = 420, 420
GROUND, FLOOR, BONE, JOINT = (18, 20, 24), (52, 58, 66), (255, 255, 255), (255, 84, 70)
#: Pictures of each set of frames, so that the view turns smoothly.
PER_SET = 2
SETS = 60
MIDDLE, METRES_HIGH = np.array([0.0, 0.0, 1.05]), 2.5
#: How far the view looks down.
DOWN = np.deg2rad(12)


def seen_from(points: ndarray, azimuth: float) -> ndarray:
    """Columns, rows (pixels) and distance (metres) of points, by parallel rays."""
    x, y, z = (points - MIDDLE).T
    across, away = x * np.cos(azimuth) + y * np.sin(azimuth), y * np.cos(azimuth) - x * np.sin(azimuth)
    up, far = z * np.cos(DOWN) + away * np.sin(DOWN), away * np.cos(DOWN) - z * np.sin(DOWN)
    scale = HEIGHT / METRES_HIGH
    return np.stack([WIDTH / 2 + scale * across, HEIGHT / 2 - scale * up, far], -1)


def draw(points: ndarray, labels: ndarray, joints: ndarray, azimuth: float) -> ndarray:
    """One picture."""
    picture = np.full((HEIGHT, WIDTH, 3), GROUND, np.uint8)
    ring = np.linspace(0, 2 * np.pi, 73)
    for radius in (0.5, 1.0):
        circle = np.stack([radius * np.cos(ring), radius * np.sin(ring), np.zeros(len(ring))], -1)
        lines = seen_from(circle, azimuth)[:, :2].round().astype(np.int32)
        cv2.polylines(picture, [lines], True, FLOOR, 1, cv2.LINE_AA)
    places = seen_from(points, azimuth)
    order = np.argsort(-places[:, 2])  # what is near is drawn last
    columns, rows = places[order, :2].round().astype(int).T - 1
    shade = 1 - 0.45 * np.clip((places[order, 2, None] + 0.5) / 1.0, 0, 1)
    colours = ((45 + DISPLAY_COLOURS[labels[order]] * (210 / 255)) * shade).astype(np.uint8)
    for down in range(3):
        for right in range(3):
            inside = (columns + right >= 0) & (columns + right < WIDTH) & (rows + down >= 0) & (rows + down < HEIGHT)
            picture[rows[inside] + down, columns[inside] + right] = colours[inside]
    ends = seen_from(joints, azimuth)[:, :2]
    at = {name: tuple(np.round(ends[i] * 16).astype(int).tolist()) for i, name in enumerate(depthmocap.JOINTS)}
    for parent, child in BONES:
        cv2.line(picture, at[parent], at[child], BONE, 2, cv2.LINE_AA, shift=4)
    for place in at.values():
        cv2.circle(picture, place, 3 * 16, JOINT, -1, cv2.LINE_AA, shift=4)
    return picture


def main(path: Path) -> None:
    """Capture the recording and draw it at its own speed."""
    recording = packaged_recording()
    source = depthmocap.open_source(recording)
    pipeline = depthmocap.load_pipeline(source)
    pictures = []
    for number, frames in enumerate(source):
        result = pipeline(frames)
        if number >= SETS:
            break
        if not np.isfinite(result.pose.joints).all():
            continue
        for part in range(PER_SET):
            azimuth = 2 * np.pi * (number + part / PER_SET) / SETS
            pictures.append(draw(result.cloud.points_world, result.cloud.labels, result.pose.joints, azimuth))
    animation(pictures, PER_SET * 7.8, path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
