"""Bodies that are told turned round, front for back, and from which side they were seen when that happened.

A network that guesses that people face the camera does well on people who do. So the share is also told by heading.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX

#: Sectors of headings: the first faces the camera, the third shows the subject's right side, the fifth their back.
SECTORS = 8
#: A body is turned round surely when the confidence of both shoulders is above this.
SURE_CONFIDENCE = 0.9
_SHOULDERS = JOINT_INDEX["LShoulder"], JOINT_INDEX["RShoulder"]


def _to_left(joints: Float[ndarray, "n 18 3"]) -> Float[ndarray, "n 3"]:
    """Vector from the right shoulder to the left one."""
    return joints[:, _SHOULDERS[0]] - joints[:, _SHOULDERS[1]]


def turned_round(estimates: Float[ndarray, "n 18 3"], truths: Float[ndarray, "n 18 3"]) -> Bool[ndarray, "n"]:
    """Bodies whose estimated line of shoulders points the wrong way; False without an estimate."""
    return np.asarray((_to_left(estimates) * _to_left(truths)).sum(1) < 0)


def heading_sectors(truths: Float[ndarray, "n 18 3"], eyes: Float[ndarray, "n 3"]) -> Int[ndarray, "n"]:
    """Sector of each body's heading about its trunk: 0 faces the camera. Sectors go on towards the subject's own left,
    so that sector 2 shows their right side."""
    trunk = truths[:, JOINT_INDEX["Neck"]] - truths[:, JOINT_INDEX["Hip"]]
    left = _to_left(truths)
    ahead = np.cross(left, trunk)
    across = np.cross(trunk, ahead)  # to the left, at a right angle to the trunk
    to_eye = eyes - truths[:, JOINT_INDEX["Hip"]]
    unit = [axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9) for axis in (ahead, across)]
    # The eye on the subject's right means that they have turned to their left.
    angle = np.arctan2(-(to_eye * unit[1]).sum(1), (to_eye * unit[0]).sum(1))
    return np.asarray(np.rint(angle / (2 * np.pi / SECTORS)).astype(np.int64) % SECTORS)


def facing_numbers(
    estimates: Float[ndarray, "n 18 3"],
    truths: Float[ndarray, "n 18 3"],
    confidences: Float[ndarray, "n 18"],
    eyes: Float[ndarray, "n 3"] | None,
) -> dict[str, Any]:
    """Shares (0–1) of bodies turned round, and turned round surely; with one camera per body also by heading, None in
    empty sectors.

    Args:
        estimates: joints in the world, metres, NaN without a detected person.
        eyes: position of the camera of each body, metres.
    """
    turned = turned_round(estimates, truths)
    sure = turned & (confidences[:, _SHOULDERS].min(1) > SURE_CONFIDENCE)
    numbers: dict[str, Any] = {"turned_round": float(turned.mean()), "turned_round_surely": float(sure.mean())}
    if eyes is not None:
        sectors = heading_sectors(truths, eyes)
        by_heading = [turned[sectors == sector] for sector in range(SECTORS)]
        numbers["turned_round_by_heading"] = [float(members.mean()) if len(members) else None for members in by_heading]
        numbers["bodies_by_heading"] = [len(members) for members in by_heading]
    return numbers
