"""Smoothing of poses over time: left–right swap guard, then a filter, then constant bone lengths."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, get_args

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.average import Average
from depthmocap.smooth.bone_lengths import BoneLengthConstraint, BoneLengthSettings
from depthmocap.smooth.fixed_lag import FixedLag, FixedLagSettings
from depthmocap.smooth.kalman import Kalman, KalmanSettings
from depthmocap.smooth.one_euro import OneEuro
from depthmocap.smooth.point_carrier import PointCarrier
from depthmocap.smooth.pose_filter import PoseFilter
from depthmocap.smooth.swap_guard import SwapGuard, SwapGuardSettings

FilterName = Literal["average", "one-euro", "kalman", "fixed-lag"]
FILTERS: tuple[FilterName, ...] = get_args(FilterName)
Smoothing = Literal["auto", "none", "average", "one-euro", "kalman", "fixed-lag"]
Bones = Literal["free", "steady"]
BONES_CHOICES: tuple[Bones, ...] = get_args(Bones)
#: The filter of "auto" for consecutive frames: the best of the comparison in docs/results/time.md.
AUTO: FilterName = "kalman"


class PoseSmoother(PoseFilter):
    """A filter with the left–right swap guard (``swap_guard``) before it and constant bone lengths (``bone_lengths``)
    after it; without the latter if ``bones`` is None."""

    def __init__(
        self, filter_: PoseFilter, sides: SwapGuardSettings | None = None, bones: BoneLengthSettings | None = None
    ) -> None:
        self._filter, self._guard = filter_, SwapGuard(sides)
        self._bones = None if bones is None else BoneLengthConstraint(bones)
        self._points = PointCarrier()
        self.delay_frames = filter_.delay_frames

    @property
    def settings(self) -> Any:
        """The filter's settings."""
        return self._filter.settings

    @property
    def latency_s(self) -> float:
        """The filter's latency (seconds)."""
        return self._filter.latency_s

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        guarded = self._guard(pose)
        self._points.add(guarded)
        return self._constrain(self._filter(guarded))

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self._guard.reset()
        self._filter.reset()
        self._points.reset()
        if self._bones is not None:
            self._bones.reset()

    def finish(self) -> list[Pose]:
        """See :class:`PoseFilter`."""
        remaining = [self._constrain(pose) for pose in self._filter.finish()]
        self.reset()
        return remaining

    def describe(self) -> dict[str, Any]:
        """See :class:`PoseFilter`."""
        bones = None if self._bones is None else dataclasses.asdict(self._bones.settings)
        return {**self._filter.describe(), "sides": dataclasses.asdict(self._guard.settings), "bones": bones}

    def _constrain(self, pose: Pose) -> Pose:
        return self._points.carried(pose if self._bones is None else self._bones(pose))


def load_filter(
    name: FilterName, lag_frames: int = FixedLagSettings().frames, bridge_s: float = 0.0, bones: Bones = "steady"
) -> PoseSmoother:
    """A filter by name, with the swap guard.

    Args:
        lag_frames: delay of "fixed-lag" in frames.
        bridge_s: longest gap of a joint that "kalman" and "fixed-lag" fill (seconds); 0 leaves gaps.
        bones: "steady" keeps bone lengths constant; they are learnt while running.

    Raises:
        InputError: for another name, or a setting that is out of range or that this filter does not have.
    """
    if bridge_s and name not in ("kalman", "fixed-lag"):
        raise InputError(f"gaps are bridged by the filters kalman and fixed-lag, not by {name}")
    filter_: PoseFilter
    model = KalmanSettings(bridge_s=bridge_s)
    match name:
        case "average":
            filter_ = Average()
        case "one-euro":
            filter_ = OneEuro()
        case "kalman":
            filter_ = Kalman(model)
        case "fixed-lag":
            filter_ = FixedLag(FixedLagSettings(lag_frames, model))
        case _:
            raise InputError(f"--smooth takes auto, none, average, one-euro, kalman or fixed-lag, not {name!r}")
    return PoseSmoother(filter_, bones=BoneLengthSettings() if bones == "steady" else None)
