"""When a toe leaves the floor: from the leg's joints, and from when the tip of the big toe gets fast, where it is told.

Toes are not among the joints, and a foot that rolls off its toes leaves later in the ankle's course than one that is
lifted flat. What tells them apart is how the leg is bent, and how its speeds follow each other in time: a regression
on how the leg moves as the swing begins.
``benchmarks/make_toe_off.py`` fits it on motion capture of walking and on walks made by rule.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.analysis.steady_joints import SteadyJoints
from depthmocap.core.reading.array_files import ArrayType, read_npz

_FILE = Path(__file__).with_name("toe_off.npz")
#: A toe has gone when it is so fast (m/s): heel and toe move faster then, for the heel goes first.
_GONE_MPS = 1.0
#: What the toe tells weighs so much beside what the leg does.
_TOE_SHARE = 0.7
#: The toe's speed is highest so long before or after the ankle's (s).
_PEAKS_APART_S = 0.25
#: Shares of the swing's peak speed whose times are told,
_SHARES = (0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9)
#: the one that they are told from,
_HALF = 0.5
#: and the one after the peak that the last is told to.
_LANDING = 0.22
#: A speed (m/s) whose time is told too.
_FAST_MPS = 1.0
#: Peaks of other courses are looked for from so long before half of the peak speed on (s).
_BEFORE_S = 0.4
#: Numbers that tell a swing; the last ones of which two weigh all others: how the knee is bent and the shank inclined.
FEATURES = 19
_KNEE, _SHANK = 15, 16
#: More deviations from the mean than this are no swing that was learnt from.
_MOST_DEVIATIONS = 3.0
#: The toe leaves at most so long before or after half of the peak speed (s).
_FURTHEST_S = 0.3


def last_crossing(values: Float[ndarray, " t"], start: int, step: int, level: float) -> float | None:
    """Where values first fall below a level, from a frame on (a fraction of frames); None where they do not."""
    i = start
    while 0 <= i + step < len(values):
        here, there = values[i], values[i + step]
        if there < level <= here:
            return i + step * float((here - level) / (here - there))
        i += step
    return None


def swing_features(
    steady: SteadyJoints, side: str, speed: Float[ndarray, " t"], peak: int
) -> tuple[float, Float[ndarray, " f"]] | None:
    """When the ankle has half of a swing's peak speed (a fraction of frames), and what tells the toe's way from there:
    times of other courses from then on (s), angles (radians) and speeds (m/s). None where a joint is not known.

    Args:
        side: R or L.
        speed: of the ankle over the floor (m/s), NaN where it is not known.
        peak: the swing's frame of the highest speed.
    """
    crossings = [last_crossing(speed, peak, -1, share * speed[peak]) for share in (_HALF, *_SHARES)]
    landing = last_crossing(speed, peak, 1, _LANDING * speed[peak])
    if landing is None or any(at is None for at in crossings):
        return None
    half, *others = (float(at) for at in crossings if at is not None)
    first, last = (
        max(int(half - _BEFORE_S / steady.frame_s), 1, int(min(others)) - 1),
        min(int(landing) + 2, len(speed)),
    )
    around = slice(first - 1, last)
    hip, knee, ankle = (steady.of(f"{side}{name}")[around] for name in ("Hip", "Knee", "Foot"))
    middle = (steady.of("RHip")[around] + steady.of("LHip")[around]) / 2
    if last - first < 4 or np.isnan(hip + knee + ankle + middle).any():
        return None
    way = np.where([True, False, True], ankle[-1] - ankle[max(int(others[0]) - first, 0)], 0.0)
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    shank = knee - ankle
    inclined = np.arctan2(shank @ way, shank[:, 1])
    bent = _angle(hip - knee, shank)
    rises = np.gradient(ankle[:, 1], steady.frame_s)
    until = peak - first + 2

    def peak_of(course: Float[ndarray, " n"]) -> float:
        return _vertex(course, 1 + int(course[1:until].argmax()))

    behind = _vertex(way @ (middle - ankle).T, 1 + int((way @ (middle - ankle).T)[1:until].argmax()))
    courses = (
        behind, peak_of(rises), peak_of(np.gradient(inclined)), peak_of(np.gradient(bent)),
        peak_of(np.gradient(speed[around])),
    )  # fmt: skip
    fast = last_crossing(speed, peak, -1, _FAST_MPS)
    times = [*others, float(peak), landing, *(first - 1 + at for at in courses), half if fast is None else fast]
    here = half - first + 1

    def now(course: Float[ndarray, " n"]) -> float:
        return float(np.interp(here, np.arange(len(course)), course))

    times_s = (np.array(times) - half) * steady.frame_s
    return half, np.array([*times_s, now(bent), now(inclined), speed[peak], now(rises)])


def toe_off_frame(steady: SteadyJoints, side: str, speed: Float[ndarray, " t"], peak: int) -> float | None:
    """When the toe leaves before a swing (a fraction of frames): by the leg, and by the toe itself where it is told;
    where not all of the leg's joints are known, when the ankle has half of its peak speed. None where that is not known
    either. Arguments as :func:`swing_features`."""
    by_leg = _by_leg(steady, side, speed, peak)
    by_toe = _by_toe(steady, side, peak)
    if by_leg is None or by_toe is None or abs(by_toe - by_leg) * steady.frame_s > _FURTHEST_S:
        return by_leg
    return by_leg + _TOE_SHARE * (by_toe - by_leg)


def _by_leg(steady: SteadyJoints, side: str, speed: Float[ndarray, " t"], peak: int) -> float | None:
    values = swing_features(steady, side, speed, peak)
    if values is None:
        return last_crossing(speed, peak, -1, _HALF * speed[peak])
    half, features = values
    mean, scale, coefficients = _model()
    later_s = float(design(features[None], mean, scale)[0] @ coefficients)
    return half + float(np.clip(later_s, -_FURTHEST_S, _FURTHEST_S)) / steady.frame_s


def _by_toe(steady: SteadyJoints, side: str, peak: int) -> float | None:
    """When the tip of a toe gets fast before a swing's peak of the ankle's speed; None where it is not told."""
    if steady.toes is None:
        return None
    apart = round(_PEAKS_APART_S / steady.frame_s)
    first = max(peak - round((_BEFORE_S + _FURTHEST_S) / steady.frame_s), 0)
    toe = steady.toes[first : peak + apart + 1, "RL".index(side)]
    if len(toe) < 2:
        return None
    speed = np.linalg.norm(np.gradient(toe, steady.frame_s, axis=0), axis=1)
    # What is before a gap is not the swing's.
    unknown = np.flatnonzero(np.isnan(speed))
    start = int(unknown[-1]) + 1 if len(unknown) else 0
    near = max(peak - apart - first, start)
    if near >= len(speed):
        return None
    gone = last_crossing(speed[start:], near + int(speed[near:].argmax()) - start, -1, _GONE_MPS)
    return None if gone is None else first + start + gone


def design(
    features: Float[ndarray, "n f"], mean: Float[ndarray, " f"], scale: Float[ndarray, " f"]
) -> Float[ndarray, "n g"]:
    """What the regression is linear in: 1, the features, and these times the bend of the knee and times the shank's."""
    z = np.clip((features - mean) / scale, -_MOST_DEVIATIONS, _MOST_DEVIATIONS)
    return np.concatenate([np.ones((len(z), 1)), z, z * z[:, [_KNEE]], z * z[:, [_SHANK]]], 1)


@functools.cache
def _model() -> tuple[Float[ndarray, " f"], Float[ndarray, " f"], Float[ndarray, " g"]]:
    types = {name: ArrayType(f"{FEATURES}", "f") for name in ("mean", "scale")}
    arrays = read_npz(_FILE, types | {"coefficients": ArrayType(f"{1 + 3 * FEATURES}", "f")})
    return arrays["mean"], arrays["scale"], arrays["coefficients"]


def _vertex(values: Float[ndarray, " n"], i: int) -> float:
    """Where the parabola through a highest value and its neighbours is highest."""
    if not 0 < i < len(values) - 1:
        return float(i)
    before, here, after = values[i - 1 : i + 2]
    curve = before - 2 * here + after
    return i + 0.5 * float((before - after) / curve) if curve < 0 else float(i)


def _angle(a: Float[ndarray, "n 3"], b: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
