"""Wrong depth units and mirrored pictures, told by how cameras disagree about the same person.

A wrong unit scales all that a camera measures about its centre; a mirrored picture exchanges left and right, which no
rotation undoes. Any two cameras are compared by the similarity transform, with and without a reflection, that brings
the joints of one onto those of the other. Wrong is the camera that disagrees with those that agree with each other.
The size of the person tells a unit that is wrong for all alike only where nobody can be so large or so small.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX, MIRROR
from depthmocap.calibration.joint_tracks import JointTrack, common_times, resample
from depthmocap.calibration.pairs import AGREES_M, LEAST_JOINTS, estimate_pair, geman_mcclure, usable_joints
from depthmocap.geometry import DepthCamera, largest_group, transform_points

#: Length of the chain neck – hip – knee – ankle of an adult (metres): skeletons are scaled to it for comparison,
CHAIN_M = 1.36
#: and this much shorter than the body.
STATURE_PER_CHAIN = 1.2
#: Nobody who walks is smaller or larger than this (metres).
STATURES_M = (0.68, 2.4)
#: And nobody who is grown up.
_ADULTS_M = (1.4, 2.05)
#: Depth units of devices differ from the usual millimetre by such factors.
COMMON_FACTORS = (0.1, 0.25, 0.5, 2.0, 4.0, 10.0)
#: A factor this near to a common one is that one.
_NEAR = 1.12
#: Two cameras measure in the same unit if their ratio is within this.
SAME_UNIT = 1.12
#: Fewest moments that two cameras must share for a judgement.
_LEAST_MOMENTS = 12
#: Share of these moments that must agree.
_LEAST_SHARE = 0.5
#: A reflection is told if without it (or with it) the joints fit less well than this share.
_WORSE = 0.8
#: Most moments at which two cameras are compared.
_MOMENTS = 40
#: Initial fits: most moments of right cameras agree, so that few find them.
_FITS = 40
#: Iterations of the similarity transform.
_ITERATIONS = 15

_LEGS = (("RHip", "RKnee", "RFoot"), ("LHip", "LKnee", "LFoot"))


@dataclasses.dataclass(frozen=True, eq=False)
class PictureFault:
    """A wrong depth unit, a mirrored picture, or one that is turned while its intrinsics are not.

    Attributes:
        kind: "unit", "mirror" or "turned".
        cameras: who is wrong; both of two where it cannot be told which.
        text: the same in words, with what would mend it.
        factor: on the depth of the cameras that are wrong; for both of two, on that of the first one only.
        certain: whether all of ``cameras`` are wrong, and by that factor, so that it can be mended.
        common: whether ``cameras`` agree with each other.
    """

    kind: str
    cameras: tuple[str, ...]
    text: str
    factor: float = 1.0
    certain: bool = True
    common: bool = False


@dataclasses.dataclass(frozen=True)
class PairScale:
    """How two cameras' joints fit: by what camera a's lengths are longer than b's, and whether one is mirrored against
    the other; None where it cannot be told."""

    scale: float | None
    mirrored: bool | None


def chain_m(track: JointTrack) -> float:
    """Median length of the chain neck – hip – knee – ankle (metres); NaN without the joints."""
    joints = track.joints

    def length(a: str, b: str) -> Float[ndarray, " t"]:
        return np.linalg.norm(joints[:, JOINT_INDEX[a]] - joints[:, JOINT_INDEX[b]], axis=-1)

    legs = [length(hip, knee) + length(knee, foot) for hip, knee, foot in _LEGS]
    lengths = length("Neck", "Hip") + np.mean(legs, 0)
    known = np.isfinite(lengths)
    return float(np.median(lengths[known])) if known.any() else float("nan")


def mirrored_joints(camera: DepthCamera, joints: Float[ndarray, "*n 18 3"]) -> Float[ndarray, "*n 18 3"]:
    """Joints in the camera's frame as they are if its picture comes mirrored: the picture's columns are exchanged, and
    with them the person's sides."""
    # Column u shows what belongs to width − 1 − u.
    offset = (camera.width - 1 - 2 * camera.cx) / camera.fx
    right = joints[..., 2] * offset - joints[..., 0]
    return np.stack([right, joints[..., 1], joints[..., 2]], -1)[..., MIRROR, :]


def scaled(track: JointTrack, factor: float) -> JointTrack:
    """The track with all lengths multiplied."""
    return JointTrack(track.times_s, track.joints * factor, track.sigma_m * factor)


def of_adult(track: JointTrack) -> JointTrack:
    """The track at an adult's size, whatever its unit: expected errors and limits are of that."""
    return scaled(track, CHAIN_M / chain_m(track))


def mirrored(camera: DepthCamera, track: JointTrack) -> JointTrack:
    """The track of a camera whose picture comes mirrored, as it is."""
    return JointTrack(track.times_s, mirrored_joints(camera, track.joints), track.sigma_m[:, MIRROR])


def find_picture_faults(
    cameras: Sequence[DepthCamera], tracks: Sequence[JointTrack], rng: np.random.Generator
) -> list[PictureFault]:
    """Wrong depth units and mirrored pictures, by camera.

    Args:
        tracks: each camera's joints in its own frame.
    """
    pairs = {
        (a, b): compare_pair(cameras[b], tracks[a], tracks[b], rng)
        for a, b in itertools.combinations(range(len(cameras)), 2)
    }
    return [*_unit_faults(cameras, tracks, pairs), *_mirror_faults(cameras, pairs)]


def compare_pair(camera_b: DepthCamera, a: JointTrack, b: JointTrack, rng: np.random.Generator) -> PairScale:
    """How the joints of two cameras fit; ``camera_b`` is that of ``b``."""
    chain_a, chain_b = chain_m(a), chain_m(b)
    if not (chain_a > 0 and chain_b > 0) or min(len(a.times_s), len(b.times_s)) < 2:
        return PairScale(None, None)
    a, b = of_adult(a), of_adult(b)
    fits = [fit_similarity(a, track, rng) for track in (b, mirrored(camera_b, b))]
    best = int(np.argmax([fit.score for fit in fits]))
    fit, other = fits[best], fits[1 - best]
    if not fit.reliable:
        return PairScale(None, None)
    certain = other.score < _WORSE * fit.score
    return PairScale(fit.scale * chain_a / chain_b, bool(best) if certain else None)


@dataclasses.dataclass(frozen=True)
class SimilarityFit:
    """How two cameras' joints fit by a similarity transform: by its scale, how well (0 to 1), and at how many of the
    moments that they share."""

    scale: float = 1.0
    score: float = 0.0
    shared: int = 0
    agreed: int = 0

    @property
    def reliable(self) -> bool:
        """Whether enough moments agree for a judgement."""
        return self.agreed >= max(_LEAST_MOMENTS, _LEAST_SHARE * self.shared)


def fit_similarity(a: JointTrack, b: JointTrack, rng: np.random.Generator) -> SimilarityFit:
    """The similarity transform from b to a, both at an adult's size."""
    times_s = common_times([a, b])
    times_s = times_s[:: max(round(len(times_s) / _MOMENTS), 1)]
    two = resample([a, b], times_s, np.zeros(2))
    pair = estimate_pair((two.joints[0], two.joints[1]), (two.sigma_m[0], two.sigma_m[1]), rng, _FITS)
    if pair is None:
        return SimilarityFit()
    known = usable_joints(two.joints, two.sigma_m)
    common = known[0] & known[1]
    common &= common.sum(1, keepdims=True) >= LEAST_JOINTS
    one, other = two.joints[0][common], two.joints[1][common]
    expected = np.sqrt(two.sigma_m[0][common] ** 2 + two.sigma_m[1][common] ** 2)
    other = transform_points(pair.a_from_b, other)
    scale = 1.0
    for _ in range(_ITERATIONS):
        weights = geman_mcclure(np.linalg.norm(one - other, axis=1) / expected) / expected**2
        step, other = _similar(one, other, weights)
        scale *= step
    distances = np.full(common.shape, np.nan)
    distances[common] = np.linalg.norm(one - other, axis=1)
    frames = np.flatnonzero(common.any(1))
    medians = np.nanmedian(distances[frames], axis=1)
    score = geman_mcclure(distances[common] / expected).mean()
    return SimilarityFit(scale, float(score), len(frames), int((medians < AGREES_M).sum()))


def _similar(
    a: Float[ndarray, "n 3"], b: Float[ndarray, "n 3"], weights: Float[ndarray, " n"]
) -> tuple[float, Float[ndarray, "n 3"]]:
    """Points b brought onto a by the similarity transform of least squares, and its scale (Umeyama 1991)."""
    normalised = weights / weights.sum()
    middle_a, middle_b = normalised @ a, normalised @ b
    a, b = a - middle_a, b - middle_b
    u, singular, vt = np.linalg.svd((a * normalised[:, None]).T @ b)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = float((singular * signs).sum() / (normalised @ (b**2).sum(1)))
    return scale, scale * b @ ((u * signs) @ vt).T + middle_a


def _unit_faults(
    cameras: Sequence[DepthCamera], tracks: Sequence[JointTrack], pairs: dict[tuple[int, int], PairScale]
) -> list[PictureFault]:
    names = [camera.name for camera in cameras]
    statures = [STATURE_PER_CHAIN * chain_m(track) for track in tracks]
    logs = {pair: float(np.log(fit.scale)) for pair, fit in pairs.items() if fit.scale is not None}
    same = {pair for pair, log in logs.items() if abs(log) < np.log(SAME_UNIT)}
    group = largest_group(range(len(cameras)), same)
    faults: list[PictureFault] = []
    rest = [i for i in range(len(cameras)) if i not in group and np.isfinite(statures[i])]
    if len(group) < 2:
        group = []
        seen = [i for i, stature_m in enumerate(statures) if np.isfinite(stature_m)]
        for a, b in sorted(logs):
            if len(seen) == 2:
                faults.append(_either(names, statures, (a, b), float(np.exp(logs[a, b]))))
        if faults or len(cameras) > 1:
            return faults
        group, rest = [0] if np.isfinite(statures[0]) else [], []
    stature_m = float(np.median([statures[i] for i in group])) if group else float("nan")
    factors = _common_factors(stature_m)
    common = factors[0] if len(factors) == 1 else 1.0
    if factors:
        if common != 1:
            mend = _unit_mend(cameras, group, common)
        else:
            sizes = " or ".join(f"{factor:g} ({stature_m * factor:.2f} m)" for factor in factors if factor != 1)
            mend = f"their depth unit is wrong, by a factor that cannot be told{f', such as {sizes}' if sizes else ''}"
        faults.append(
            PictureFault(
                "unit", tuple(names[i] for i in group),
                f"{_who(names, group)} {'measure' if len(group) > 1 else 'measures'} a person of {stature_m:.2f} m: "
                f"{mend}",
                common, common != 1, True,
            )
        )  # fmt: skip
    for i in rest:
        ratios = [log if a == i else -log for (a, b), log in logs.items() if i in (a, b) and {a, b} - {i} <= {*group}]
        if not ratios:
            continue
        factor = common * round_factor(float(np.exp(-np.median(ratios))))
        faults.append(
            PictureFault(
                "unit", (names[i],),
                f"camera {names[i]!r} measures {np.exp(np.median(ratios)):.2f} of the lengths that "
                f"{_who(names, group)} measure: {_unit_mend(cameras, [i], factor)}",
                factor,
            )
        )  # fmt: skip
    return faults


def _either(names: Sequence[str], statures: Sequence[float], pair: tuple[int, int], ratio: float) -> PictureFault:
    """Of two cameras in different units: the one by which nobody can be so large or so small, or both."""
    a, b = pair
    possible = [i for i in pair if STATURES_M[0] < statures[i] < STATURES_M[1]]
    text = (
        f"camera {names[a]!r} measures {ratio:.2f} of the lengths that camera {names[b]!r} measures (a person of "
        f"{statures[a]:.2f} m and {statures[b]:.2f} m): the depth unit of one is wrong"
    )
    if len(possible) == 1:
        (right,) = possible
        wrong = a if right == b else b
        factor = round_factor(1 / ratio if wrong == a else ratio)
        return PictureFault("unit", (names[wrong],), f"{text}: that of {names[wrong]!r}, {_times(factor)}", factor)
    factor = round_factor(1 / ratio)
    text += f": multiply the depth of {names[a]!r} by {factor:g}, or that of {names[b]!r} by {1 / factor:.3g}"
    return PictureFault("unit", (names[a], names[b]), text, factor, certain=False)


def _mirror_faults(cameras: Sequence[DepthCamera], pairs: dict[tuple[int, int], PairScale]) -> list[PictureFault]:
    names = [camera.name for camera in cameras]
    mirrored = {pair: fit.mirrored for pair, fit in pairs.items() if fit.mirrored is not None}
    wrong = {pair for pair, is_mirrored in mirrored.items() if is_mirrored}
    if not wrong:
        return []
    group = largest_group(range(len(cameras)), set(mirrored) - wrong)
    blamed = sorted({i for pair in wrong for i in pair} - set(group)) if len(group) > 1 else []
    how = '"mirrored": true in rig.json exchanges left and right'
    faults = [
        PictureFault(
            "mirror", (names[i],),
            f"the picture of camera {names[i]!r} is mirrored against {_who(names, group)}: {how}",
        )
        for i in blamed
        if all((min(i, j), max(i, j)) not in mirrored or (min(i, j), max(i, j)) in wrong for j in group)
    ]  # fmt: skip
    if not faults and len(cameras) == 2:
        text = f"the picture of either camera {names[0]!r} or camera {names[1]!r} is mirrored: {how} of the one that is"
        faults.append(PictureFault("mirror", (names[0], names[1]), text, certain=False))
    return faults


def _common_factors(stature_m: float) -> list[float]:
    """What depth may have to be multiplied by, where nobody can be so large or so small: one where it makes an adult
    and no other of the usual ones does, several or 1 where it cannot be told. None where somebody can be."""
    if not np.isfinite(stature_m) or STATURES_M[0] < stature_m < STATURES_M[1]:
        return []
    adults = [factor for factor in COMMON_FACTORS if _ADULTS_M[0] < stature_m * factor < _ADULTS_M[1]]
    if len(adults) == 1:
        return adults
    return [1.0, *(factor for factor in COMMON_FACTORS if STATURES_M[0] < stature_m * factor < STATURES_M[1])]


def round_factor(factor: float) -> float:
    """A factor as it was probably meant: the usual one near to it, or to two digits."""
    for usual in COMMON_FACTORS:
        if 1 / _NEAR < factor / usual < _NEAR:
            return usual
    return float(f"{factor:.3g}")


def _times(factor: float) -> str:
    return f"multiply it by {factor:g} (depth_factor in rig.json)"


def _unit_mend(cameras: Sequence[DepthCamera], which: Sequence[int], factor: float) -> str:
    units = sorted({cameras[i].depth_unit_m * cameras[i].depth_factor for i in which})
    if len(units) > 1:
        return f"their depth units are wrong, {_times(factor)}"
    return f"a depth unit of {factor * units[0]:g} m instead of {units[0]:g} m would be right ({_times(factor)})"


def _who(names: Sequence[str], which: Sequence[int]) -> str:
    if len(which) == len(names) and len(names) > 1:
        return "all cameras"
    if len(which) == 1:
        return f"camera {names[which[0]]!r}"
    return "cameras " + " and ".join(repr(names[i]) for i in which)
