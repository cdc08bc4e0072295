"""What rotations of bones are likely where positions leave them open: by the learnt network, and by hinges."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.learnt_rotations import LOOKED_BACK_S, RotationNetwork
from depthmocap.exporting.seen_points import point_places, turned_by_points
from depthmocap.exporting.timeline import SHORTEST_FRAME_S
from depthmocap.geometry.transforms import cross, rotation_between
from depthmocap.kernels.nearest_rotation import nearest_rotations

#: Of the limbs that bend about a hinge: the joints that their bones start at, and the last one's end.
_UPPER, _LOWER, _END = (
    np.array([JOINT_INDEX[side + name] for side in "RL" for name in names])
    for names in (("Shoulder", "Hip"), ("Elbow", "Knee"), ("Hand", "Foot"))
)
#: Their directions and their hinges' axes in the T pose.
_ALONG = np.array([(-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
_HINGE = np.array([(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)])
_REST = np.stack([_ALONG, _HINGE, cross(_ALONG, _HINGE)], -1)
#: A shorter bone has no direction (m).
_SHORTEST_M = 1e-6
#: A hinge bent less than the first tells nothing of its axis, more than the second all (radians).
_BENT_RAD = np.deg2rad([8.0, 30.0])
#: The same where it seems to bend backwards: so far it may be the joints' error.
_BACKWARDS_RAD = np.deg2rad([35.0, 60.0])


def likely_rotations(
    joints: Float[ndarray, "t 18 3"],
    times_s: Float[ndarray, " t"],
    offsets: Float[ndarray, "18 3"],
    smooth_s: float = 0.0,
    beside: Float[ndarray, "t 18 3"] | None = None,
) -> Float[ndarray, "t 18 3 3"]:
    """Rotations in the world, away from the T pose.

    Args:
        joints: of the skeleton, none missing, Y up.
        times_s: of the frames, in order.
        offsets: of the rest skeleton.
        smooth_s: standard deviation of a smoothing over time in both directions (s).
        beside: points of the skin from their joints (see :func:`turned_by_points`).
    """
    window = np.stack([joints, *(_at(joints, times_s, times_s - back_s) for back_s in LOOKED_BACK_S[1:])])
    period_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else np.inf
    smooth_frames = smooth_s / max(period_s, SHORTEST_FRAME_S)
    return likely_now(window, offsets, smooth_frames, beside)


def likely_now(
    window: Float[ndarray, "w t 18 3"],
    offsets: Float[ndarray, "18 3"],
    smooth_frames: float = 0.0,
    beside: Float[ndarray, "t 18 3"] | None = None,
) -> Float[ndarray, "t 18 3 3"]:
    """As :func:`likely_rotations`, of joints now and at ``LOOKED_BACK_S``."""
    rotations = RotationNetwork.load()(window, float(np.linalg.norm(offsets, axis=-1).sum()))
    if beside is not None:
        rotations = turned_by_points(rotations, beside, point_places(offsets))
    if smooth_frames > 0:
        from scipy.ndimage import gaussian_filter1d  # slow to import

        rotations = nearest_rotations(gaussian_filter1d(rotations, smooth_frames, axis=0, mode="nearest"))
    return with_hinges(rotations, window[0])


def with_hinges(guess: Float[ndarray, "t 18 3 3"], joints: Float[ndarray, "t 18 3"]) -> Float[ndarray, "t 18 3 3"]:
    """Rotations whose limbs are turned about themselves as their hinges are: elbows and knees that are bent tell it,
    and of straight ones the guess does."""
    guess = guess.copy()
    middle = joints[:, _LOWER]
    bones = np.stack([middle - joints[:, _UPPER], joints[:, _END] - middle])
    guessed = (guess[:, _UPPER] @ _ALONG[:, :, None])[..., 0]
    sizes = np.linalg.norm(bones, axis=-1, keepdims=True)
    if (short := sizes.min(0) < _SHORTEST_M).any():
        bones, sizes = np.where(short, guessed, bones), np.where(short, 1.0, sizes)
    upper, lower = bones / sizes
    seen = cross(upper, lower)
    sine = np.linalg.norm(seen, axis=-1, keepdims=True)
    bend = np.arctan2(sine, (upper * lower).sum(-1, keepdims=True))
    # The guess, pointed along the limb, tells the axis of a straight one.
    turn = rotation_between(guessed, upper)
    before = (turn @ (guess[:, _UPPER] @ _HINGE[:, :, None]))[..., 0]
    forwards = (seen * before).sum(-1, keepdims=True) >= 0
    least, most = (np.where(forwards, a, b) for a, b in zip(_BENT_RAD, _BACKWARDS_RAD, strict=True))
    trust = np.clip((bend - least) / (most - least), 0, 1)
    axis = trust * seen / np.maximum(sine, 1e-9) + (1 - trust) * before
    along = np.stack([upper, lower])
    across = _unit(axis - (axis * along).sum(-1, keepdims=True) * along)
    turned = np.stack([along, across, cross(along, across)], -1) @ np.swapaxes(_REST, -1, -2)
    guess[:, _UPPER], guess[:, _LOWER] = turned
    return guess


def _unit(vectors: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _at(
    joints: Float[ndarray, "t 18 3"], times_s: Float[ndarray, " t"], wanted_s: Float[ndarray, " t"]
) -> Float[ndarray, "t 18 3"]:
    """The joints at times, on a line between frames; before the first frame as in it."""
    after = np.clip(np.searchsorted(times_s, wanted_s - 1e-6), 0, len(times_s) - 1)
    before = np.maximum(after - 1, 0)
    share = np.clip((wanted_s - times_s[before]) / np.maximum(times_s[after] - times_s[before], 1e-9), 0, 1)
    return joints[before] + share[:, None, None] * (joints[after] - joints[before])
