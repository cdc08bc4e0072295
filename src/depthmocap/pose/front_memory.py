"""What was seen of a person's front before: a body cannot turn round from one frame to the next.

Which way a person faces is told by each frame for itself (``classify.front``), and is at times told wrongly for a while
of people who are cut off. What the frames of the last seconds told, on average, counts as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.mirrored import turned_view, undo_mirrored

#: Time constant of the average of the log odds, seconds.
_MEMORY_S = 3.0
#: What that average counts, in frames: its errors are alike, so that it is not the sum of all.
_WEIGHT = 2.0
#: Longest time since the last frame that told, after which a person may have turned round, seconds.
_LONGEST_S = 1.0
#: Time that the first frame counts, seconds.
_FIRST_S = 0.1
_LEFT = [JOINT_INDEX["LShoulder"], JOINT_INDEX["LHip"]]
_RIGHT = [JOINT_INDEX["RShoulder"], JOINT_INDEX["RHip"]]


class FrontMemory:
    """The front of one person over time."""

    def __init__(self) -> None:
        self._front: Float[ndarray, "3"] | None = None
        self._log_odds, self._now_ns = 0.0, 0

    def knows(self, timestamp_ns: int) -> bool:
        """Whether the last front was seen so shortly before that it still counts."""
        return 0 <= timestamp_ns - self._now_ns <= _LONGEST_S * 1e9

    def __call__(self, parts: Sequence[LabelledView], timestamp_ns: int) -> list[LabelledView]:
        """The views of a frame set, turned round where together with what was seen before they face the other way.

        Their ``front_log_odds`` together are those of the front that they have then. Views that tell no front stay as
        they are.
        """
        parts = undo_mirrored(parts)
        facing = [i for i, part in enumerate(parts) if np.isfinite(part.front_log_odds)]
        if not facing or (front := _front(parts)) is None:
            return parts
        elapsed_s = (timestamp_ns - self._now_ns) / 1e9
        if self._front is None or not self.knows(timestamp_ns):
            self._front, self._log_odds, elapsed_s = front, 0.0, _FIRST_S
        evidence = float(sum(parts[i].front_log_odds for i in facing))
        # Who turned by less than 60° since faces the same way; who is seen at right angles to it, either way.
        before = self._log_odds * float(np.clip(2 * front @ self._front, -1, 1))
        if evidence + _WEIGHT * before < 0:
            parts = [turned_view(part) for part in parts]
            front, evidence, before = -front, -evidence, -before
        share = 1 - np.exp(-elapsed_s / _MEMORY_S)
        self._log_odds = before + share * (evidence - before)
        self._front, self._now_ns = front, timestamp_ns
        for i in facing:
            parts[i] = parts[i]._replace(front_log_odds=parts[i].front_log_odds + _WEIGHT * before / len(facing))
        return parts


def _front(parts: Sequence[LabelledView]) -> Float[ndarray, "3"] | None:
    """The front of the trunk in the world by the views' own joints, a unit vector; None where it is not known."""
    estimates = [part.joints[:, :3] for part in parts if part.joints is not None]
    if not estimates:
        return None
    places = np.stack(estimates)  # of all views at once: this is done with every set
    across = places[:, _LEFT].mean(1) - places[:, _RIGHT].mean(1)
    fronts = np.cross(across, places[:, JOINT_INDEX["Neck"]] - places[:, JOINT_INDEX["Hip"]])
    lengths = np.linalg.norm(fronts, axis=1)
    known = np.isfinite(lengths) & (lengths > 0)
    total = (fronts[known] / lengths[known, None]).sum(0)
    length = float(np.linalg.norm(total))
    return total / length if length > 0 else None
