"""What is measured: names as in the files, units, and how large the error of each was found to be."""

from __future__ import annotations

import dataclasses

from depthmocap.analysis.joint_angles import BODY_ANGLES, SIDE_ANGLES
from depthmocap.analysis.measured_errors import ERRORS


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A number of a trial.

    Attributes:
        label: for people.
        unit: of its numbers in files and on the page.
        meaning: how it is taken, in a line.
        decimals: digits on the page.
        error: mean error of one value with three cameras, as measured (docs/results/analysis.md); None where none was.
    """

    label: str
    unit: str
    meaning: str
    decimals: int = 2
    error: float | None = None


GAIT: dict[str, Quantity] = {
    "stride_length": Quantity("stride length", "m", "from where a foot stands to where it stands next"),
    "stride_time": Quantity("stride time", "s", "between heel strikes of a foot"),
    "step_length": Quantity("step length", "m", "from the other foot to this one, along the stride"),
    "step_time": Quantity("step time", "s", "from the other foot's heel strike to this one's"),
    "step_width": Quantity("step width", "m", "between the ankles, across the stride"),
    "walking_speed": Quantity("walking speed", "m/s", "stride length by stride time"),
    "cadence": Quantity("cadence", "steps/min", "120 by stride time in seconds", decimals=1),
    "stance": Quantity("stance", "% of stride", "from heel strike to toe-off", decimals=1),
    "swing": Quantity("swing", "% of stride", "from toe-off to heel strike", decimals=1),
    "double_support": Quantity("double support", "% of stride", "both feet stand", decimals=1),
}
TRANSFERS: dict[str, Quantity] = {
    "sit_to_stand": Quantity("sit to stand", "s", "from a tenth to nine tenths of the hips' way up"),
    "stand_to_sit": Quantity("stand to sit", "s", "from a tenth to nine tenths of the hips' way down"),
}
ASYMMETRY = Quantity(
    "asymmetry", "% of mean", "difference of the sides, positive where the right is larger", decimals=1
)
MASS_RANGE = Quantity("centre of mass, up and down", "m", "range of its height in a stride")
_ANGLE_LABELS = {
    "hip_flexion": "hip flexion", "hip_adduction": "hip adduction", "knee_flexion": "knee flexion",
    "shoulder_plane": "shoulder, plane of elevation", "shoulder_elevation": "shoulder elevation",
    "shoulder_rotation": "shoulder rotation (inwards)", "elbow_flexion": "elbow flexion",
    "pelvis_tilt": "pelvic tilt (forwards)", "pelvis_obliquity": "pelvic obliquity (right side up)",
    "pelvis_heading": "heading of the pelvis (to the left)", "trunk_lean": "lean of the trunk (forwards)",
    "trunk_flexion": "trunk flexion on the pelvis", "trunk_bend": "trunk bend (to the right)",
    "trunk_rotation": "trunk rotation (to the left)",
}  # fmt: skip
#: Angles over time, in degrees.
ANGLES: dict[str, Quantity] = {
    name: Quantity(_ANGLE_LABELS[name], "°", "range of motion: largest less smallest", decimals=1)
    for name in (*SIDE_ANGLES, *BODY_ANGLES)
}


def quantity_of(name: str) -> Quantity:
    """What a name in the files stands for."""
    if name.endswith("_asymmetry"):
        base = GAIT[name.removesuffix("_asymmetry")]
        return dataclasses.replace(ASYMMETRY, label=f"{base.label}, asymmetry")
    if name == "mass_centre_range":
        return MASS_RANGE
    return dataclasses.replace({**GAIT, **TRANSFERS, **ANGLES}[name], error=ERRORS.get(name))
