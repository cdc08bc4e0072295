"""Sitting people: upright, leaning back, with legs crossed. They are rare in recordings of motion, and common in rooms.

Only the posture is made. A chair that stood there before is no part of a person's mask; what hides their back and
thighs is drawn by the scenes, as for anybody else.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.synth.body.bones import POSTURE_INDEX, heading

#: Share of people who cross their legs.
_CROSSED = 0.15
_PELVIS = POSTURE_INDEX["pelvis"]


def seated(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture on a seat: an upright or leaning pelvis that faces as before, thighs forwards, shins down or out.
    Trunk, head and arms stay as they are."""
    out = posture.copy()
    # At rest a body faces −Y, so that a turn about +X leans it back and lifts its thighs forwards.
    lean = np.radians(rng.uniform(-25, 10))
    turn = Rotation.from_rotvec([0, 0, float(heading(posture[None])[0])])
    out[_PELVIS] = (turn * Rotation.from_euler("XY", [lean, rng.normal(0, 0.08)])).as_rotvec()
    lifted = np.radians(rng.uniform(75, 105))
    apart = np.radians(rng.uniform(-2, 25))
    upright = Rotation.from_rotvec([lean, 0, 0]).inv()
    crossed = "RL"[int(rng.integers(2))] if rng.random() < _CROSSED else ""
    for side, outwards in (("R", -1.0), ("L", 1.0)):
        over = side == crossed
        lift = lifted + rng.normal(0, 0.08) + (np.radians(15) if over else 0.0)
        spread = outwards * (np.radians(rng.uniform(-30, -15)) if over else apart + rng.normal(0, 0.06))
        # About the vertical after the lift, whatever the lean of the pelvis.
        thigh = upright * Rotation.from_rotvec([0, 0, spread]) * Rotation.from_rotvec([-lift, 0, 0])
        bend = np.clip(lift + np.radians(rng.normal(0, 18)) - (np.radians(35) if over else 0.0), 0.2, 2.4)
        out[POSTURE_INDEX[f"thigh.{side}"]] = thigh.as_rotvec()
        out[POSTURE_INDEX[f"shin.{side}"]] = [bend, rng.normal(0, 0.1), rng.normal(0, 0.05)]
        out[POSTURE_INDEX[f"foot.{side}"]] = rng.normal(0, 0.12, 3)
    return out
