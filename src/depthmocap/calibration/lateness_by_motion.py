"""Time offsets of the cameras of one take beyond those that are near, by movement; and clocks that jump.

Timestamps of one take are mostly right or nearly so. What movement tells over minutes is therefore only taken where the
search near them finds nothing, or where it finds an offset that movement contradicts.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from depthmocap.calibration.clock_steps import ClockStep, find_large_step, find_step
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.lateness import LONGEST_S, NEAR_S, Lateness
from depthmocap.calibration.time_fit import fit_time
from depthmocap.calibration.time_search import APART_S, find_time
from depthmocap.text import camera_list


def confirm_lateness(near: Lateness, a: JointTrack, b: JointTrack, rng: np.random.Generator) -> Lateness:
    """The offset that the search near the timestamps found, unless movement tells another."""
    match = find_time(a, b, rng)
    if match.told and match.fit is not None:
        aside_s = abs(match.fit.shift_s - near.seconds)
        return near if near.told and aside_s < APART_S else Lateness(match.fit.shift_s)
    # Of a movement that repeats itself soon, the offset that was found is as good as others one stride away.
    if abs(near.seconds) > NEAR_S and match.repeats and find_time(a, b, rng, LONGEST_S).repeats:
        return dataclasses.replace(near, told=False)
    return near


def find_jumps(
    tracks: Sequence[JointTrack], offset_s: Sequence[float], rng: np.random.Generator
) -> dict[tuple[int, int], ClockStep]:
    """Jumps of the clocks of any two cameras against each other, by pair; ``offset_s`` is to be added to each."""
    jumps = {}
    for a, b in itertools.combinations(range(len(tracks)), 2):
        shift_s = float(offset_s[b] - offset_s[a])
        if min(len(tracks[a].times_s), len(tracks[b].times_s)) < 2:
            continue
        fit = fit_time(tracks[a], tracks[b], shift_s, rng)
        one, other = tracks[a], tracks[b]
        step = find_step(one, other, fit) if fit is not None else find_large_step(one, other, shift_s)
        if step is not None:
            jumps[a, b] = step
    return jumps


def jump_lines(names: Sequence[str], jumps: dict[tuple[int, int], ClockStep], start_s: float) -> list[str]:
    """A line for the user on each camera whose clock jumps; of two cameras on both."""
    counts = {name: sum(name in (names[a], names[b]) for a, b in jumps) for name in names}
    most = max(counts.values(), default=0)
    if not most:
        return []
    blamed = [name for name in names if counts[name] == most]
    (pair, step), *_ = [(pair, step) for pair, step in jumps.items() if {names[i] for i in pair} & set(blamed)]
    if most == 1 or len(blamed) > 1:
        blamed = [names[i] for i in pair]
    either = (
        f"the clock of {camera_list(blamed)}" if len(blamed) == 1 else f"of {camera_list(blamed)}, the clock of one"
    )
    return [
        f"{either} jumps by {1e3 * abs(step.by_s):.0f} ms, about {step.at_s - start_s:.0f} s after the first frame: no "
        "one time offset is right for the take; cut it in two there"
    ]
