"""Correction of mirrored views: a view that mistakes the front of a body for its back has left and right swapped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.regions import TURNED
from depthmocap.body.skeleton import MIRROR, SIDED
from depthmocap.pose.labelled_view import LabelledView

#: A view is mirrored against another if swapping its sides reduces their distance to less than this share
RATIO = 0.8
#: and by at least this much (metres).
GAIN_M = 0.06
#: Mean label probability at which a view knows nothing of the sides. A view's vote is its mean probability above this,
CHANCE = 0.45
#: but at least this.
_LEAST_CONFIDENCE = 0.01
#: Log odds of a probability above chance.
_LOG_ODDS = 15.0
#: Labels that take front for back; labels that are no region stay.
_TURNED = np.arange(256, dtype=np.uint8)
_TURNED[: len(TURNED)] = TURNED


def undo_mirrored(parts: Sequence[LabelledView]) -> list[LabelledView]:
    """The views of one person, with left and right swapped in those that are mirrored.

    Each view's own estimates of the sided joints are compared with the most confident view's. Of the two groups that
    disagree, the one is mirrored that has the lower sum of the log odds of its fronts (or of confidences, where nothing
    told fronts). Views without such estimates, and views with true labels, stay as they are.
    """
    parts = list(parts)
    joints = {i: estimate for i, part in enumerate(parts) if (estimate := _own_joints(part)) is not None}
    if len(joints) < 2:
        return parts
    reference = min(joints, key=lambda i: float(joints[i][SIDED, 3].mean()))
    same, mirrored = [reference], []
    for i in joints:
        if i != reference:
            distance, swapped = (
                _mean_distance(joints[i], joints[reference]),
                _mean_distance(joints[i][MIRROR], joints[reference]),
            )
            if swapped < RATIO * distance and distance - swapped > GAIN_M:
                mirrored.append(i)
            elif distance <= swapped:
                same.append(i)
    if not mirrored:
        return parts
    for i in min(same, mirrored, key=lambda group: sum(_sureness(parts[i]) for i in group)):
        parts[i] = turned_view(parts[i])
    return parts


def turned_view(part: LabelledView) -> LabelledView:
    """The view with front and back, left and right exchanged."""
    joints = None if part.joints is None else part.joints[MIRROR]
    return part._replace(labels=_TURNED[part.labels], joints=joints, front_log_odds=-part.front_log_odds)


def _own_joints(part: LabelledView) -> Float[ndarray, "18 4"] | None:
    """The view's own joint estimates; None for true labels, or where a sided joint is missing."""
    known = part.joints is not None and part.weights is not None and np.isfinite(part.joints[SIDED]).all()
    return part.joints if known else None


def _mean_distance(joints: Float[ndarray, "18 4"], reference: Float[ndarray, "18 4"]) -> float:
    return float(np.linalg.norm(joints[SIDED, :3] - reference[SIDED, :3], axis=1).mean())


def _sureness(part: LabelledView) -> float:
    """How sure a view is of left and right, as log odds: not surer than its labels, nor than of its front."""
    labelled = (part.labels > 0) & (part.labels < len(TURNED))
    if part.weights is None or not labelled.any():
        of_labels = _LEAST_CONFIDENCE
    else:
        of_labels = max(float(part.weights[labelled].mean()) - CHANCE, _LEAST_CONFIDENCE)
    return float(np.nanmin([_LOG_ODDS * of_labels, part.front_log_odds]))
