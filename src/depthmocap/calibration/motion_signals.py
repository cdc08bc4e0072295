"""What one camera alone tells of how a person moves that does not depend on where the camera stands: distances between
joints, their speeds, and how far the body gets in a time; and how alike these signals of two cameras are at every
time offset.

Of two cameras with the signals x and y, r is the correlation of a signal over the time in which both see the person at
an offset. If both are normal, and follow each other for n independent moments, the logarithm of the likelihood ratio
of "the same movement" against "unrelated" is -n/2 log(1 - r²). The sum over all signals is the likeness, which weighs
by itself signals that noise drowns, and short overlaps. Signals that repeat with each stride give it peaks one stride
apart; those of the path do not.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.pairs import usable_joints

#: Samples of a signal in a second.
RATE_HZ = 20.0
#: Distances between these joints; of a pair with "?" both sides.
_DISTANCES = (
    ("RHand", "LHand"), ("RElbow", "LElbow"), ("RFoot", "LFoot"), ("RKnee", "LKnee"),
    ("?Hand", "?Shoulder"), ("?Hand", "Hip"), ("?Hand", "Head"), ("?Elbow", "Hip"), ("?Hand", "?Foot"),
    ("?Foot", "Neck"), ("?Foot", "?Hip"), ("?Knee", "Neck"), ("Head", "Hip"),
)  # fmt: skip
#: Joints whose speeds are signals,
_SPEEDS = ("Hip", "Neck", "Head", "?Hand", "?Elbow", "?Foot", "?Knee")
#: over this time (seconds).
_SPEED_S = 0.2
#: Times (seconds) over which the distance that the trunk gets is a signal: they tell a path's bends and its pauses.
_PATH_S = (0.5, 1.0, 2.0, 4.0)
_TRUNK = ("Hip", "Spine", "Spine1", "Spine2", "Neck")
#: Moments of a signal nearer than this (seconds) are not independent.
_INDEPENDENT_S = 0.5
#: Most of the likeness that a signal can have in a moment: no two views are equal.
_MOST_CORRELATED = 0.95


def motion_signals(track: JointTrack) -> tuple[float, Float[ndarray, "s t"], Float[ndarray, " s"]]:
    """The signals of a camera.

    Returns:
        When they start (seconds by the track's clock), the signals at ``RATE_HZ`` (NaN where unknown), and how long
        a moment of each is (seconds).
    """
    times_s = track.times_s
    count = int((times_s[-1] - times_s[0]) * RATE_HZ) + 1
    grid_s = times_s[0] + np.arange(count) / RATE_HZ
    joints, sigma_m = track.interpolate(grid_s, float(np.median(np.diff(times_s))))
    joints = np.where(usable_joints(joints, sigma_m)[..., None], joints, np.nan)

    def at(name: str) -> Float[ndarray, "t 3"]:
        return joints[:, JOINT_INDEX[name]]

    signals = [_length(at(a) - at(b)) for a, b in _both_sides(_DISTANCES)]
    signals += [_travelled(at(name), _SPEED_S) for (name,) in _both_sides((name,) for name in _SPEEDS)]
    known = np.isfinite(joints[:, [JOINT_INDEX[name] for name in _TRUNK]])
    trunk = np.where(known, joints[:, [JOINT_INDEX[name] for name in _TRUNK]], 0).sum(1)
    with np.errstate(invalid="ignore"):
        trunk = np.where(known.sum(1) > 2, trunk / known.sum(1), np.nan)
    path = [_travelled(trunk, seconds) for seconds in _PATH_S]
    lengths_s = [_INDEPENDENT_S] * len(signals) + [max(seconds, _INDEPENDENT_S) for seconds in _PATH_S]
    return float(times_s[0]), np.stack([*signals, *path]), np.array(lengths_s)


def likeness(
    a: Float[ndarray, "s n"], b: Float[ndarray, "s m"], lengths_s: Float[ndarray, " s"], least_s: float
) -> Float[ndarray, " lags"]:
    """How alike the signals are if sample j of b is at the moment of sample j + lag of a.

    Args:
        least_s: a signal counts at a lag if both cameras know it for this long (seconds).

    Returns:
        Of the lags from 1 - m to n - 1; -inf where no signal counts.
    """
    size = 1 << (a.shape[1] + b.shape[1] - 2).bit_length()
    total = np.full(a.shape[1] + b.shape[1] - 1, -np.inf)
    for x, y, length_s in zip(a, b, lengths_s, strict=True):
        overlap, correlation = _correlation(x, y, size)
        counts = overlap >= max(least_s * RATE_HZ, 2)
        r = np.clip(np.where(counts, correlation, 0), 0, _MOST_CORRELATED)
        gain = -overlap / (2 * RATE_HZ * length_s) * np.log1p(-r * r)
        total = np.where(counts, np.where(np.isfinite(total), total, 0) + gain, total)
    return total


def _correlation(
    x: Float[ndarray, " n"], y: Float[ndarray, " m"], size: int
) -> tuple[Float[ndarray, " lags"], Float[ndarray, " lags"]]:
    """At every lag, the number of moments that both signals know, and Pearson's correlation over these."""
    known_x, known_y = np.isfinite(x), np.isfinite(y)
    x, y = _centred(x, known_x), _centred(y, known_y)
    spectra_x = [np.fft.rfft(part, size) for part in (known_x.astype(float), x, x * x)]
    spectra_y = [np.conj(np.fft.rfft(part, size)) for part in (known_y.astype(float), y, y * y)]

    def over_lags(i: int, j: int) -> Float[ndarray, " lags"]:
        circular = np.fft.irfft(spectra_x[i] * spectra_y[j], size)
        return np.concatenate([circular[size - len(y) + 1 :], circular[: len(x)]])

    count = np.rint(over_lags(0, 0))
    shared = np.maximum(count, 1)
    sum_x, sum_y = over_lags(1, 0), over_lags(0, 1)
    variance_x = over_lags(2, 0) - sum_x**2 / shared
    variance_y = over_lags(0, 2) - sum_y**2 / shared
    # Rounding of the transforms leaves a little where nothing varies.
    scale = np.maximum(variance_x, 1e-6 * (x @ x)) * np.maximum(variance_y, 1e-6 * (y @ y))
    covariance = over_lags(1, 1) - sum_x * sum_y / shared
    return count, np.where(scale > 0, covariance / np.sqrt(np.where(scale > 0, scale, 1)), 0)


def _centred(signal: Float[ndarray, " n"], known: Bool[ndarray, " n"]) -> Float[ndarray, " n"]:
    """The signal less its mean, 0 where it is unknown."""
    return np.where(known, signal - (signal[known].mean() if known.any() else 0), 0)


def _both_sides(groups: Iterable[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The names, with "?" for R and for L."""
    sided = [tuple(name.replace("?", side) for name in group) for group in groups for side in ("R", "L")]
    return list(dict.fromkeys(sided))


def _length(vectors: Float[ndarray, "t 3"]) -> Float[ndarray, " t"]:
    return np.linalg.norm(vectors, axis=1)


def _travelled(points: Float[ndarray, "t 3"], seconds: float) -> Float[ndarray, " t"]:
    """Distance between where a point is half this time before and half this time after each moment."""
    half = max(round(seconds * RATE_HZ / 2), 1)
    distance = np.full(len(points), np.nan)
    if len(points) > 2 * half:
        distance[half:-half] = _length(points[2 * half :] - points[: -2 * half])
    return distance
