"""A view that takes the front of a body for its back sees left and right exchanged. The other views tell, and it is
undone before they vote."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.regions import MIRROR as MIRRORED_REGIONS
from depthmocap.body.skeleton import MIRROR, SIDED
from depthmocap.pose.labelled_view import LabelledView

#: One of two views is mirrored where exchanging its sides leaves less than this share of their distance, and that much
#: (metres) less.
RATIO, GAIN_M = 0.8, 0.06
#: Mean probability of its labels at which a view tells nothing of the sides; above, every view counts by how much.
GUESS = 0.45
_LEAST = 0.01
#: Labels with left and right exchanged; what is no region stays.
_EXCHANGED = np.arange(256, dtype=np.uint8)
_EXCHANGED[: len(MIRRORED_REGIONS)] = MIRRORED_REGIONS


def undo_mirrored(parts: Sequence[LabelledView]) -> list[LabelledView]:
    """The views of one person, left and right exchanged in those that are mirrored against the surer ones.

    Views are compared by where each by itself takes the joints of both sides to be; views without any, and with true
    labels, stay as they are.
    """
    parts = list(parts)
    joints = {i: told for i, part in enumerate(parts) if (told := _told(part)) is not None}
    if len(joints) < 2:
        return parts
    first = min(joints, key=lambda i: float(joints[i][SIDED, 3].mean()))
    same, mirrored = [first], []
    for i in joints:
        if i != first:
            apart, exchanged = _apart(joints[i], joints[first]), _apart(joints[i][MIRROR], joints[first])
            if exchanged < RATIO * apart and apart - exchanged > GAIN_M:
                mirrored.append(i)
            elif apart <= exchanged:
                same.append(i)
    if not mirrored:
        return parts
    for i in min(same, mirrored, key=lambda group: sum(_sureness(parts[i]) for i in group)):
        parts[i] = parts[i]._replace(labels=_EXCHANGED[parts[i].labels], joints=joints[i][MIRROR])
    return parts


def _told(part: LabelledView) -> Float[ndarray, "18 4"] | None:
    """Where a view that knows how sure it is takes the joints to be."""
    known = part.joints is not None and part.weights is not None and np.isfinite(part.joints[SIDED]).all()
    return part.joints if known else None


def _apart(joints: Float[ndarray, "18 4"], others: Float[ndarray, "18 4"]) -> float:
    return float(np.linalg.norm(joints[SIDED, :3] - others[SIDED, :3], axis=1).mean())


def _sureness(part: LabelledView) -> float:
    labelled = (part.labels > 0) & (part.labels < len(MIRRORED_REGIONS))
    if part.weights is None or not labelled.any():
        return _LEAST
    return max(float(part.weights[labelled].mean()) - GUESS, _LEAST)
