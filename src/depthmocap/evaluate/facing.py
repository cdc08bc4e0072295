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
#: Who is turned round at more than this confidence in both shoulders is told so surely.
SURE = 0.9
_SHOULDERS = JOINT_INDEX["LShoulder"], JOINT_INDEX["RShoulder"]


def _to_left(joints: Float[ndarray, "n 18 3"]) -> Float[ndarray, "n 3"]:
    """From the right shoulder to the left."""
    return joints[:, _SHOULDERS[0]] - joints[:, _SHOULDERS[1]]


def turned_round(estimates: Float[ndarray, "n 18 3"], truths: Float[ndarray, "n 18 3"]) -> Bool[ndarray, "n"]:
    """Whose line of shoulders points the other way than it does; not those without an estimate."""
    return np.asarray((_to_left(estimates) * _to_left(truths)).sum(1) < 0)


def heading_sectors(truths: Float[ndarray, "n 18 3"], eyes: Float[ndarray, "n 3"]) -> Int[ndarray, "n"]:
    """Which of the eighths a body faces, seen along its trunk: 0 the eye that looks at it, then on to the subject's own
    left, so that the second quarter turn shows their right side."""
    trunk = truths[:, JOINT_INDEX["Neck"]] - truths[:, JOINT_INDEX["Hip"]]
    left = _to_left(truths)
    ahead = np.cross(left, trunk)
    across = np.cross(trunk, ahead)  # to the left, at a right angle to the trunk
    to_eye = eyes - truths[:, JOINT_INDEX["Hip"]]
    unit = [each / np.maximum(np.linalg.norm(each, axis=1, keepdims=True), 1e-9) for each in (ahead, across)]
    # The eye on the subject's right means that they have turned to their left.
    angle = np.arctan2(-(to_eye * unit[1]).sum(1), (to_eye * unit[0]).sum(1))
    return np.asarray(np.rint(angle / (2 * np.pi / SECTORS)).astype(np.int64) % SECTORS)


def facing_numbers(
    estimates: Float[ndarray, "n 18 3"],
    truths: Float[ndarray, "n 18 3"],
    confidences: Float[ndarray, "n 18"],
    eyes: Float[ndarray, "n 3"] | None,
) -> dict[str, Any]:
    """The share (0–1) of bodies turned round, of those turned round surely, and by heading where one eye looked at
    each: None in sectors without anybody.

    Args:
        estimates: joints in the world, metres, NaN where nobody was found.
        eyes: where the cameras were, one a body.
    """
    turned = turned_round(estimates, truths)
    sure = turned & (confidences[:, _SHOULDERS].min(1) > SURE)
    numbers: dict[str, Any] = {"turned_round": float(turned.mean()), "turned_round_surely": float(sure.mean())}
    if eyes is not None:
        sectors = heading_sectors(truths, eyes)
        by_heading = [turned[sectors == sector] for sector in range(SECTORS)]
        numbers["turned_round_by_heading"] = [float(each.mean()) if len(each) else None for each in by_heading]
        numbers["bodies_by_heading"] = [len(each) for each in by_heading]
    return numbers
