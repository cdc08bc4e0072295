"""The body's centre of mass, from the masses of segments.

Masses and centres of mass are those of de Leva 1996 ("Adjustments to Zatsiorsky-Seluyanov's segment inertia
parameters", Journal of Biomechanics 29, 1223-1230, Table 4), between joint centres. What joints do not show is
simplified: the head's centre is taken at the joint Head, a foot's at its ankle, a hand's beyond the wrist in the
direction of the forearm.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.analysis.steady_joints import SteadyJoints

Anthropometry = Literal["mean", "female", "male"]


@dataclasses.dataclass(frozen=True)
class Segment:
    """A segment between two points.

    Attributes:
        masses: share of the body's, of women and men.
        centres: share of the way from the first point to the second, of women and men.
    """

    first: str
    second: str
    masses: tuple[float, float]
    centres: tuple[float, float]


#: Where a hand's centre is beyond the wrist, in lengths of the forearm.
_HAND = 0.25
SEGMENTS: dict[str, Segment] = {
    "head": Segment("Head", "Head", (0.0668, 0.0694), (0.0, 0.0)),
    "trunk": Segment("shoulders", "hips", (0.4257, 0.4346), (0.3782, 0.4310)),
    **{
        f"{name} {side}": Segment(f"{side}{first}", f"{side}{second}", masses, centres)
        for side in "LR"
        for name, first, second, masses, centres in (
            ("upper arm", "Shoulder", "Elbow", (0.0255, 0.0271), (0.5754, 0.5772)),
            ("forearm", "Elbow", "Hand", (0.0138, 0.0162), (0.4559, 0.4574)),
            ("hand", "Elbow", "Hand", (0.0056, 0.0061), (1 + _HAND, 1 + _HAND)),
            ("thigh", "Hip", "Knee", (0.1478, 0.1416), (0.3612, 0.4095)),
            ("shank", "Knee", "Foot", (0.0481, 0.0433), (0.4352, 0.4395)),
            ("foot", "Foot", "Foot", (0.0129, 0.0137), (0.0, 0.0)),
        )
    },
}


def centre_of_mass(steady: SteadyJoints, of: Anthropometry = "mean") -> Float[ndarray, "t 3"]:
    """The centre of mass (m, Y up) over time; NaN where a joint that any segment needs was not seen."""
    shares = {"female": (1.0, 0.0), "male": (0.0, 1.0), "mean": (0.5, 0.5)}[of]

    def point(name: str) -> Float[ndarray, "t 3"]:
        if name in ("shoulders", "hips"):
            joint = name.capitalize().removesuffix("s")
            return (steady.of(f"L{joint}") + steady.of(f"R{joint}")) / 2
        return steady.of(name)

    total, centre = 0.0, np.zeros((len(steady.times_s), 3))
    for segment in SEGMENTS.values():
        mass, along = float(np.dot(shares, segment.masses)), float(np.dot(shares, segment.centres))
        first, second = point(segment.first), point(segment.second)
        centre += mass * (first + along * (second - first))
        total += mass
    return centre / total
