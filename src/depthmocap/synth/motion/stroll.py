"""A body walks from stop to stop, and stands for a while at some of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from depthmocap.synth.motion.perform import Motion, Score, Step, leg_length, perform, stand
from depthmocap.synth.people.garments import DressedBody

#: A step in leg lengths, and how long it takes at most (s): slow walkers take shorter steps.
_STEP, _LONGEST_S = 0.72, 0.7
#: Corners of the way are rounded over about this (metres), and the way is followed in pieces of this.
_ROUND_M, _PIECE_M = 0.25, 0.02
#: How far the arms swing (degrees) forward and back.
_SWING_DEG = 18.0


@dataclasses.dataclass(frozen=True)
class Stop:
    """A place on the floor (metres) that a walker comes by, and how long it stands there (s)."""

    x: float
    y: float
    stand_s: float = 0.0


def stroll(
    dressed: DressedBody, stops: Sequence[Stop], start_s: float, speed_mps: float, times_s: Float[ndarray, " n"]
) -> Motion:
    """The motion at any times: standing at the first stop until ``start_s``, then from stop to stop, then standing.

    Raises:
        ValueError: for fewer than two stops, or a speed that is not positive.
    """
    if len(stops) < 2 or not speed_mps > 0:
        raise ValueError(f"a stroll needs two stops and a positive speed, got {len(stops)} and {speed_mps}")
    leg = leg_length(dressed)
    way, yaw_deg, arrivals = _way(stops)
    steps: list[Step] = []
    swings: dict[str, list[tuple[float, float]]] = {"L": [(start_s, 0.0)], "R": [(start_s, 0.0)]}
    now_s, first, side = start_s, 0, "L"
    for stop, last in zip(stops[1:], arrivals[1:], strict=True):
        length = (last - first) * _PIECE_M
        count = max(round(length / min(_STEP * leg, speed_mps * _LONGEST_S)), 1)
        each_s = length / speed_mps / count
        # The last step only brings the other foot beside the first.
        for at in [*(first + (np.arange(count) + 1) / count * (last - first)), last]:
            place = round(float(at))
            yaw = float(yaw_deg[place])
            x, y = way[place] / leg
            steps.append(Step(side, now_s, now_s + each_s, stand(side, x, y, yaw), yaw, (0.0, 0.0, 0.1), 16.0, 0.5))
            other = "R" if side == "L" else "L"
            now_s += each_s
            for arm, angle in ((other, _SWING_DEG), (side, -_SWING_DEG)):
                swings[arm].append((now_s, 0.0 if at == last else angle))
            side = other
        now_s += stop.stand_s
        if stop.stand_s:
            for keys in swings.values():
                keys.append((now_s, 0.0))
        first = last
    start = (float(way[0, 0] / leg), float(way[0, 1] / leg), float(yaw_deg[0]))
    return perform(dressed, times_s, _score(swings), steps, start)


def _score(swings: dict[str, list[tuple[float, float]]]) -> Score:
    still = {"drop": 0.0, "back": 0.0, "lean": 0.0, "bend": 3.0, "sway": 0.0, "twist": 0.0, "nod": 2.0, "look": 0.0}
    for side in swings:
        still |= {f"out.{side}": 9.0, f"inward.{side}": 25.0, f"elbow.{side}": 16.0}
    return {
        **{name: [(0.0, angle)] for name, angle in still.items()},
        **{f"forward.{side}": [(at, 4.0 + angle) for at, angle in keys] for side, keys in swings.items()},
    }


def _way(stops: Sequence[Stop]) -> tuple[Float[ndarray, "n 2"], Float[ndarray, " n"], list[int]]:
    """Places every ``_PIECE_M`` of the rounded way, headings there (degrees, continuous), and where the stops are."""
    corners = np.array([(stop.x, stop.y) for stop in stops])
    pieces = np.maximum(np.round(np.linalg.norm(np.diff(corners, axis=0), axis=1) / _PIECE_M).astype(int), 1)
    arrivals = np.concatenate([[0], np.cumsum(pieces)])
    at = np.arange(arrivals[-1] + 1)
    straight = np.stack([np.interp(at, arrivals, axis) for axis in corners.T], 1)
    # What goes beyond the ends keeps them in their places.
    pad = np.arange(1, 4 * round(_ROUND_M / _PIECE_M) + 1)[:, None]
    before = straight[0] - pad[::-1] * (straight[1] - straight[0])
    behind = straight[-1] + pad * (straight[-1] - straight[-2])
    way = gaussian_filter1d(np.concatenate([before, straight, behind]), _ROUND_M / _PIECE_M, axis=0)
    way = way[len(pad) : -len(pad)]
    towards = np.gradient(way, axis=0)
    yaw = np.unwrap(np.arctan2(towards[:, 0], -towards[:, 1]))
    return way, np.rad2deg(yaw), arrivals.tolist()
