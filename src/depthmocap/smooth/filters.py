"""Poses over time: the filter a user asks for by name, between the guard of the sides and the bones' lengths."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, get_args

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.average import Average
from depthmocap.smooth.bone_lengths import BoneSettings, SteadyBones
from depthmocap.smooth.fixed_lag import FixedLag, FixedLagSettings
from depthmocap.smooth.kalman import Kalman, KalmanSettings
from depthmocap.smooth.one_euro import OneEuro
from depthmocap.smooth.pose_filter import PoseFilter
from depthmocap.smooth.swap_guard import SideGuard, SideSettings

FilterName = Literal["average", "one-euro", "kalman", "fixed-lag"]
FILTERS: tuple[FilterName, ...] = get_args(FilterName)
Smoothing = Literal["auto", "none", "average", "one-euro", "kalman", "fixed-lag"]
Bones = Literal["free", "steady"]
BONES_CHOICES: tuple[Bones, ...] = get_args(Bones)
#: What "auto" stands for where frames follow each other; see docs/results/time.md for the measurement.
AUTO: FilterName = "kalman"


class Tracker(PoseFilter):
    """A filter whose poses have kept their sides (see ``pose.sides``), and given bones of constant length after it (see
    ``pose.bones``), unless ``bones`` is None."""

    def __init__(self, inner: PoseFilter, sides: SideSettings | None = None, bones: BoneSettings | None = None) -> None:
        self._inner, self._guard = inner, SideGuard(sides)
        self._bones = None if bones is None else SteadyBones(bones)
        self.delay_frames = inner.delay_frames

    @property
    def settings(self) -> Any:
        """The filter's."""
        return self._inner.settings

    @property
    def latency_s(self) -> float:
        """The filter's."""
        return self._inner.latency_s

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        return self._steady(self._inner(self._guard(pose)))

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self._guard.reset()
        self._inner.reset()
        if self._bones is not None:
            self._bones.reset()

    def finish(self) -> list[Pose]:
        """See :class:`PoseFilter`."""
        last = [self._steady(pose) for pose in self._inner.finish()]
        self.reset()
        return last

    def describe(self) -> dict[str, Any]:
        """See :class:`PoseFilter`."""
        bones = None if self._bones is None else dataclasses.asdict(self._bones.settings)
        return {**self._inner.describe(), "sides": dataclasses.asdict(self._guard.settings), "bones": bones}

    def _steady(self, pose: Pose) -> Pose:
        return pose if self._bones is None else self._bones(pose)


def load_filter(
    name: FilterName, lag_frames: int = FixedLagSettings().frames, bridge_s: float = 0.0, bones: Bones = "steady"
) -> Tracker:
    """A filter by name, with the guard of the sides.

    Args:
        lag_frames: that "fixed-lag" waits for.
        bridge_s: how long "kalman" and "fixed-lag" go on with a joint that is missing; 0 leaves gaps.
        bones: "steady" gives them constant lengths, learnt on the run.

    Raises:
        InputError: for another name, or a setting out of range or not of this filter.
    """
    if bridge_s and name not in ("kalman", "fixed-lag"):
        raise InputError(f"gaps are bridged by the filters kalman and fixed-lag, not by {name}")
    inner: PoseFilter
    model = KalmanSettings(bridge_s=bridge_s)
    match name:
        case "average":
            inner = Average()
        case "one-euro":
            inner = OneEuro()
        case "kalman":
            inner = Kalman(model)
        case "fixed-lag":
            inner = FixedLag(FixedLagSettings(lag_frames, model))
        case _:
            raise InputError(f"--smooth takes auto, none, average, one-euro, kalman or fixed-lag, not {name!r}")
    return Tracker(inner, bones=BoneSettings() if bones == "steady" else None)
