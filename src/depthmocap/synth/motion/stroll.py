"""Walks from stop to stop, with pauses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from depthmocap.synth.motion.perform import Motion, Score, Step, leg_length, perform, stand
from depthmocap.synth.people.garments import DressedBody

#: Length of a step (leg lengths).
_STEP_LENGTH = 0.72
#: Longest duration of a step (s): slow walkers take shorter steps.
_LONGEST_STEP_S = 0.7
#: Standard deviation of the smoothing that rounds the corners of the path (metres).
_ROUNDING_M = 0.25
#: Spacing of the path's points (metres).
_SPACING_M = 0.02
#: Amplitude of the arms' swing (degrees).
_SWING_DEG = 18.0


@dataclasses.dataclass(frozen=True)
class Stop:
    """A point of the path (metres) and the duration of the pause there (s)."""

    x: float
    y: float
    stand_s: float = 0.0


def stroll(
    dressed: DressedBody, stops: Sequence[Stop], start_s: float, speed_mps: float, times_s: Float[ndarray, " n"]
) -> Motion:
    """The motion at any times (s): the body stands at the first stop until ``start_s``, walks from stop to stop, and
    stands at the last one.

    Raises:
        ValueError: for fewer than two stops, or a speed that is not positive.
    """
    if len(stops) < 2 or not speed_mps > 0:
        raise ValueError(f"a stroll needs two stops and a positive speed, got {len(stops)} and {speed_mps}")
    leg = leg_length(dressed.body)
    path, yaw_deg, arrivals = _path(stops)
    steps: list[Step] = []
    swings: dict[str, list[tuple[float, float]]] = {"L": [(start_s, 0.0)], "R": [(start_s, 0.0)]}
    now_s, first, side = start_s, 0, "L"
    for stop, last in zip(stops[1:], arrivals[1:], strict=True):
        length = (last - first) * _SPACING_M
        count = max(round(length / min(_STEP_LENGTH * leg, speed_mps * _LONGEST_STEP_S)), 1)
        step_s = length / speed_mps / count
        # The last step closes the feet.
        for at in [*(first + (np.arange(count) + 1) / count * (last - first)), last]:
            index = round(float(at))
            yaw = float(yaw_deg[index])
            x, y = path[index] / leg
            steps.append(Step(side, now_s, now_s + step_s, stand(side, x, y, yaw), yaw, (0.0, 0.0, 0.1), 16.0, 0.5))
            other_side = "R" if side == "L" else "L"
            now_s += step_s
            for arm, angle in ((other_side, _SWING_DEG), (side, -_SWING_DEG)):
                swings[arm].append((now_s, 0.0 if at == last else angle))
            side = other_side
        now_s += stop.stand_s
        if stop.stand_s:
            for keys in swings.values():
                keys.append((now_s, 0.0))
        first = last
    start = (float(path[0, 0] / leg), float(path[0, 1] / leg), float(yaw_deg[0]))
    return perform(dressed, times_s, _score(swings), steps, start)


def _score(swings: dict[str, list[tuple[float, float]]]) -> Score:
    still = {"drop": 0.0, "back": 0.0, "lean": 0.0, "bend": 3.0, "sway": 0.0, "twist": 0.0, "nod": 2.0, "look": 0.0}
    for side in swings:
        still |= {f"out.{side}": 9.0, f"inward.{side}": 25.0, f"elbow.{side}": 16.0}
    return {
        **{name: [(0.0, angle)] for name, angle in still.items()},
        **{f"forward.{side}": [(at, 4.0 + angle) for at, angle in keys] for side, keys in swings.items()},
    }


def _path(stops: Sequence[Stop]) -> tuple[Float[ndarray, "n 2"], Float[ndarray, " n"], list[int]]:
    """Points of the rounded path at a spacing of ``_SPACING_M``, their headings (degrees, continuous), and the indices
    of the stops."""
    corners = np.array([(stop.x, stop.y) for stop in stops])
    counts = np.maximum(np.round(np.linalg.norm(np.diff(corners, axis=0), axis=1) / _SPACING_M).astype(int), 1)
    arrivals = np.concatenate([[0], np.cumsum(counts)])
    indices = np.arange(arrivals[-1] + 1)
    straight = np.stack([np.interp(indices, arrivals, axis) for axis in corners.T], 1)
    # Extrapolated points keep the smoothing from moving the ends.
    pad = np.arange(1, 4 * round(_ROUNDING_M / _SPACING_M) + 1)[:, None]
    before = straight[0] - pad[::-1] * (straight[1] - straight[0])
    behind = straight[-1] + pad * (straight[-1] - straight[-2])
    path = gaussian_filter1d(np.concatenate([before, straight, behind]), _ROUNDING_M / _SPACING_M, axis=0)
    path = path[len(pad) : -len(pad)]
    directions = np.gradient(path, axis=0)
    yaw = np.unwrap(np.arctan2(directions[:, 0], -directions[:, 1]))
    return path, np.rad2deg(yaw), arrivals.tolist()
