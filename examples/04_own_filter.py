"""A filter over time of your own: what moves faster than any hand is a gap, before the packaged filter sees it.

python examples/04_own_filter.py RECORDING
"""

import dataclasses
import sys

import numpy as np

import depthmocap
from depthmocap.smooth.filters import PoseSmoother
from depthmocap.smooth.kalman import Kalman


@dataclasses.dataclass(frozen=True)
class SpeedLimitSettings:
    """Metres a second that no joint exceeds: 15 is a boxer's fist."""

    most_mps: float = 15.0


class SpeedLimit(depthmocap.PoseFilter):
    """A joint that would have had to be too fast since it was last seen is missing; another filter does the rest."""

    def __init__(self, inner: depthmocap.PoseFilter, settings: SpeedLimitSettings = SpeedLimitSettings()) -> None:
        self._inner, self._settings = inner, settings
        self.delay_frames = inner.delay_frames
        self.reset()

    @property
    def settings(self) -> SpeedLimitSettings:
        return self._settings

    @property
    def latency_s(self) -> float:
        return self._inner.latency_s  # nothing is waited for here

    def __call__(self, pose: depthmocap.Pose) -> depthmocap.Pose:
        now_s = pose.timestamp_ns * 1e-9
        if now_s < np.max(self._seen_s):
            self.reset()  # another stream begins
        way_m = np.linalg.norm(pose.joints - self._places, axis=1)  # NaN where there is none now, or was none before
        too_fast = way_m > self._settings.most_mps * (now_s - self._seen_s)
        joints = np.where(too_fast[:, None], np.nan, pose.joints)
        seen = np.isfinite(joints).all(1)
        self._places[seen], self._seen_s[seen] = joints[seen], now_s
        confidence = np.where(too_fast, 0.0, pose.confidence)
        return self._inner(dataclasses.replace(pose, joints=joints, confidence=confidence))

    def reset(self) -> None:
        self._places = np.full((len(depthmocap.JOINTS), 3), np.nan)
        self._seen_s = np.full(len(depthmocap.JOINTS), -np.inf)
        self._inner.reset()

    def finish(self) -> list[depthmocap.Pose]:
        last = self._inner.finish()
        self.reset()
        return last


def main(recording: str) -> None:
    """Print the share of joints that are left at two limits, one of them far too low."""
    pipeline = depthmocap.load_pipeline(recording)
    for most_mps in (15.0, 0.5):
        pipeline.reset()
        # A PoseSmoother keeps left and right apart before the filter, and bones at their lengths after it.
        pipeline.smoothing = PoseSmoother(SpeedLimit(Kalman(), SpeedLimitSettings(most_mps)))
        poses = [pipeline(frames).pose for frames in depthmocap.open_source(recording)]
        there = np.mean([np.isfinite(pose.joints).all(1) for pose in poses])
        print(f"limit {most_mps:g} m/s: {there:.1%} of the joints are there")


if __name__ == "__main__":
    main(sys.argv[1])
