"""Mean errors of one value with three cameras, in the units of :mod:`~depthmocap.analysis.quantities`.

Printed by ``depthmocap evaluate analysis`` as docs/results/analysis.md has them (column "all"), with two digits; those
of angles are of their ranges.
"""

from __future__ import annotations

ERRORS: dict[str, float] = {
    "stride_length": 0.0033,
    "stride_time": 0.015,
    "step_length": 0.0044,
    "step_time": 0.0098,
    "step_width": 0.0094,
    "walking_speed": 0.0069,
    "cadence": 1.1,
    "stance": 2.6,
    "swing": 2.6,
    "double_support": 4.1,
    "sit_to_stand": 0.012,
    "stand_to_sit": 0.016,
    "pelvis_tilt": 6.3,
    "pelvis_obliquity": 3.4,
    "pelvis_heading": 5.0,
    "trunk_lean": 5.0,
    "trunk_flexion": 9.6,
    "trunk_bend": 4.2,
    "trunk_rotation": 6.7,
    "hip_flexion": 3.3,
    "hip_adduction": 2.9,
    "knee_flexion": 3.1,
    "elbow_flexion": 9.9,
    "shoulder_plane": 5.6,
    "shoulder_elevation": 4.4,
    "shoulder_rotation": 11.0,
}
