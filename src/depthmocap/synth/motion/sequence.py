"""The demo motion: stand, turn around on the spot, walk, raise the arms, bend, squat, reach and kick."""

from __future__ import annotations

from jaxtyping import Float
from numpy import ndarray

from depthmocap.synth.motion.perform import Motion, Score, Step, perform, stand
from depthmocap.synth.people.garments import DressedBody

#: Length of the demo motion (s).
DEMO_SECONDS = 9.8

_SCORE: Score = {
    "drop": [(6.55, 0), (7.1, 0.05), (7.35, 0.1), (7.75, 0.26), (8.3, 0)],
    "back": [(6.55, 0), (7.1, 0.13), (7.35, 0.13), (7.75, 0.12), (8.3, 0)],
    "lean": [(3.3, 0), (3.7, 4), (4.4, 4), (4.9, 0), (6.55, 0), (7.1, 40), (7.35, 37), (7.75, 18), (8.3, 0), (9.0, 0),
             (9.36, -5), (9.7, 0)],
    "bend": [(0, 3), (4.8, 3), (5.45, -7), (5.8, -7), (6.55, 3), (7.1, 46), (7.35, 42), (7.75, 18), (8.3, 3), (9.0, 3),
             (9.36, 10), (9.7, 3)],
    "sway": [(8.1, 0), (8.55, 7), (8.7, 7), (9.1, 0)],
    "twist": [(0.3, 0), (0.9, 14), (2.6, 14), (3.35, 0), (3.7, -5), (4.05, 5), (4.5, 0), (8.1, 0), (8.55, 14),
              (8.7, 14), (9.1, 0)],
    "nod": [(0, 2), (4.8, 2), (5.45, -12), (5.8, -12), (6.55, 2), (7.1, 14), (7.35, 12), (7.75, -12), (8.3, 2)],
    "look": [(0.2, 0), (0.7, 24), (2.5, 22), (3.3, 0), (8.1, 0), (8.55, 8), (8.7, 8), (9.1, 0)],
    "out.L": [(0, 9), (4.4, 9), (5.0, 86), (5.15, 91), (5.6, 163), (5.75, 163), (6.2, 90), (6.65, 10), (7.1, 6),
              (7.35, 8), (7.75, 16), (8.3, 9), (9.0, 9), (9.36, 24), (9.75, 9)],
    "out.R": [(0, 9), (4.4, 9), (5.03, 86), (5.18, 91), (5.63, 163), (5.77, 163), (6.22, 90), (6.65, 10), (7.1, 6),
              (7.35, 8), (7.75, 16), (8.15, 10), (8.55, 20), (8.7, 20), (9.2, 9), (9.4, 15), (9.75, 9)],
    "forward.L": [(0, 4), (0.7, -8), (1.4, 10), (2.1, -8), (2.8, 10), (3.3, 0), (3.65, -14), (4.05, 20), (4.4, 4),
                  (6.55, 4), (7.1, 76), (7.35, 74), (7.75, 74), (8.3, 4), (9.0, 4), (9.36, 22), (9.75, 4)],
    "forward.R": [(0, 4), (0.7, 10), (1.4, -8), (2.1, 10), (2.8, -8), (3.3, 4), (3.65, 20), (4.05, -12), (4.4, 4),
                  (6.55, 4), (7.1, 76), (7.35, 74), (7.75, 74), (8.1, 35), (8.6, 112), (8.7, 112), (9.35, -10),
                  (9.75, 4)],
    "inward.L": [(4.5, 25), (5.6, -40), (5.75, -40), (6.6, 25)],
    "inward.R": [(4.5, 25), (5.6, -40), (5.75, -40), (6.6, 25)],
    "elbow.L": [(0, 10), (0.7, 22), (2.8, 22), (3.3, 14), (4.05, 24), (4.5, 10), (5.1, 3), (5.75, 12), (6.65, 10),
                (7.1, 4), (7.75, 12), (8.3, 10), (9.0, 10), (9.36, 20), (9.75, 10)],
    "elbow.R": [(0, 10), (0.7, 22), (2.8, 22), (3.65, 26), (4.5, 10), (5.1, 3), (5.75, 12), (6.65, 10), (7.1, 4),
                (7.75, 12), (8.1, 34), (8.55, 4), (8.7, 4), (9.1, 24), (9.75, 10)],
}  # fmt: skip
#: Start of the walk along y (leg lengths); forward is −Y.
_START_Y = 0.6
#: End of the walk along y (leg lengths).
_END_Y = -0.26


def _demo_steps() -> list[Step]:
    steps = []
    yaws = (50.0, 72.0, 122.0, 144.0, 194.0, 216.0, 266.0, 288.0, 330.0, 360.0, 360.0)
    for i, yaw in enumerate(yaws):
        side, start = "LR"[i % 2], 0.4 + 0.26 * i
        steps.append(Step(side, start, start + 0.26, stand(side, 0.0, _START_Y, yaw), yaw))
    walk = [("R", 3.35, 0.26), ("L", 3.67, -0.02), ("R", 3.99, _END_Y), ("L", 4.31, _END_Y)]
    steps.extend(
        Step(side, start, start + 0.32, stand(side, 0.0, y), 360.0, (0.0, 0.0, 0.1), 18.0, 0.4)
        for side, start, y in walk
    )
    steps.append(Step("L", 8.0, 8.36, stand("L", 0.28, _END_Y), 360.0))
    steps.append(Step("L", 8.64, 9.0, stand("L", 0.0, _END_Y), 360.0))
    steps.append(Step("R", 9.02, 9.7, stand("R", 0.0, _END_Y), 360.0, (0.05, -0.5, 0.3), -8.0, 0.9))
    return steps


def demo_motion(dressed: DressedBody, times_s: Float[ndarray, " n"]) -> Motion:
    """The demo motion at any times (s): from 0 to ``DEMO_SECONDS`` the body turns behind the origin, walks forward and
    then faces −Y; before and after it stands. The soles of the shoes stand on the floor."""
    return perform(dressed, times_s, _SCORE, _demo_steps(), (0.0, _START_Y, 0.0))
