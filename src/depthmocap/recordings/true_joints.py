"""True joints of a recording, and their alignment with its frames in time."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.recordings.pose_table import STAMP


@dataclasses.dataclass(frozen=True, eq=False)
class TrueJoints:
    """True joints over time.

    Attributes:
        stamps_ns: their times (ns), in order.
        joints: metres in the rig's world.
        on_clock: whether the times are certainly on the frames' clock.
    """

    stamps_ns: Int[ndarray, " rows"]
    joints: Float[ndarray, "rows 18 3"]
    on_clock: bool

    def nearest(self, timestamp_ns: int, tolerance_ns: float) -> Float[ndarray, "18 3"] | None:
        """The joints nearest in time; None if they are further away than the tolerance."""
        after = int(np.searchsorted(self.stamps_ns, timestamp_ns))
        distance_ns, index = min(
            (abs(int(self.stamps_ns[i]) - timestamp_ns), i) for i in (after - 1, after) if 0 <= i < len(self.stamps_ns)
        )
        return self.joints[index] if distance_ns <= tolerance_ns else None

    def align(self, recording: Path, first_ns: int, last_ns: int, period_ns: int) -> tuple[TrueJoints, list[str]]:
        """The true joints with times on the frames' clock, and what is doubtful about these times, one line each.

        Args:
            recording: its path, for the messages.
            first_ns, last_ns: times of the first and the last frame set.
            period_ns: the frame period.
        """
        stamps_ns, slack_ns, problems = self.stamps_ns, period_ns // 2, list[str]()
        subject, remedy = f"{recording}: times of the true joints", f"truth.csv should have the frames' as {STAMP}"
        if not self.on_clock and stamps_ns[0] <= slack_ns < first_ns:
            # The times begin near 0 and the frames later: either the clock began before the frames, or the times count
            # from the first frame.
            if stamps_ns[-1] >= first_ns - slack_ns:
                problems.append(
                    f"{subject} are taken for the frames' clock, but could count from the first frame: {remedy}"
                )
            else:
                stamps_ns = stamps_ns + first_ns
                if stamps_ns[-1] > last_ns + slack_ns:
                    problems.append(
                        f"{subject} are taken to count from the first frame, and go on for longer than the frames: if "
                        f"some were taken away at the beginning, they are wrong by as much; {remedy}"
                    )
        if stamps_ns[-1] < first_ns - slack_ns or stamps_ns[0] > last_ns + slack_ns:
            problems.append(f"{subject} are none of the frames': {remedy}")
        return TrueJoints(stamps_ns, self.joints, True), problems
