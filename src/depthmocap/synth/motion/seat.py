"""Sitting postures: upright, leaning back, with crossed legs. They are rare in motion capture and common in rooms.

The scenes draw the furniture; a chair is not part of a person's mask.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.synth.body.bones import POSTURE_INDEX, heading

#: Share of sitting people with crossed legs.
_CROSSED_SHARE = 0.15
_PELVIS = POSTURE_INDEX["pelvis"]


def seated(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture on a seat: pelvis upright or leaning with the same heading, thighs forwards, shins down or forwards.
    Trunk, head and arms do not change."""
    out = posture.copy()
    # The body faces −Y at rest, so that a negative rotation about +X leans it back and lifts its thighs forwards.
    lean = np.radians(rng.uniform(-25, 10))
    turn = Rotation.from_rotvec([0, 0, float(heading(posture[None])[0])])
    out[_PELVIS] = (turn * Rotation.from_euler("XY", [lean, rng.normal(0, 0.08)])).as_rotvec()
    mean_lift = np.radians(rng.uniform(75, 105))
    mean_spread = np.radians(rng.uniform(-2, 25))
    upright = Rotation.from_rotvec([lean, 0, 0]).inv()
    crossed = "RL"[int(rng.integers(2))] if rng.random() < _CROSSED_SHARE else ""
    for side, outwards in (("R", -1.0), ("L", 1.0)):
        is_crossing = side == crossed
        lift = mean_lift + rng.normal(0, 0.08) + (np.radians(15) if is_crossing else 0.0)
        spread = outwards * (np.radians(rng.uniform(-30, -15)) if is_crossing else mean_spread + rng.normal(0, 0.06))
        # The spread is a rotation about the vertical, independent of the lean of the pelvis.
        thigh = upright * Rotation.from_rotvec([0, 0, spread]) * Rotation.from_rotvec([-lift, 0, 0])
        bend = np.clip(lift + np.radians(rng.normal(0, 18)) - (np.radians(35) if is_crossing else 0.0), 0.2, 2.4)
        out[POSTURE_INDEX[f"thigh.{side}"]] = thigh.as_rotvec()
        out[POSTURE_INDEX[f"shin.{side}"]] = [bend, rng.normal(0, 0.1), rng.normal(0, 0.05)]
        out[POSTURE_INDEX[f"foot.{side}"]] = rng.normal(0, 0.12, 3)
    return out
