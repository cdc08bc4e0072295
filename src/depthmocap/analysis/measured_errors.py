"""Mean errors of one value with three cameras, in the units of :mod:`~depthmocap.analysis.quantities`.

Printed by ``depthmocap evaluate analysis`` as docs/results/analysis.md has them (column "all"), with two digits; those
of angles are of their ranges.
"""

from __future__ import annotations

ERRORS: dict[str, float] = {
    "stride_length": 0.0033,
    "stride_time": 0.016,
    "step_length": 0.0045,
    "step_time": 0.0097,
    "step_width": 0.0098,
    "walking_speed": 0.0069,
    "cadence": 1.1,
    "stance": 2.2,
    "swing": 2.2,
    "double_support": 3.7,
    "sit_to_stand": 0.01,
    "stand_to_sit": 0.016,
    "pelvis_tilt": 6.1,
    "pelvis_obliquity": 3.2,
    "pelvis_heading": 5.0,
    "trunk_lean": 4.3,
    "trunk_flexion": 9.5,
    "trunk_bend": 4.2,
    "trunk_rotation": 6.7,
    "hip_flexion": 3.4,
    "hip_adduction": 2.9,
    "knee_flexion": 3.0,
    "elbow_flexion": 8.5,
    "shoulder_plane": 5.1,
    "shoulder_elevation": 3.7,
    "shoulder_rotation": 11.0,
}
