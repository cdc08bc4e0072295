"""The numbers of a person in a trial."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.analysis.centre_of_mass import Anthropometry, centre_of_mass
from depthmocap.analysis.gait_events import Swing, swings
from depthmocap.analysis.joint_angles import SIDES, joint_angles
from depthmocap.analysis.sit_to_stand import Transfer, transfers
from depthmocap.analysis.steady_joints import SteadyJoints
from depthmocap.analysis.strides import SYMMETRIES, Stride, asymmetry, strides

#: Markers of these names end a trial and begin none.
_ENDS = ("end", "stop")
#: An angle that was seen for a shorter time has no range (s).
_LEAST_SEEN_S = 0.5


@dataclasses.dataclass(frozen=True)
class Trial:
    """A part of a take, in seconds on its clock; the last instant does not belong to it."""

    name: str
    start_s: float
    end_s: float

    def holds(self, first_s: float, last_s: float) -> bool:
        """Whether something lies in the trial as a whole."""
        return self.start_s <= first_s and last_s < self.end_s


@dataclasses.dataclass(frozen=True)
class Measure:
    """A number of a trial.

    Attributes:
        quantity: its name.
        side: left, right, or empty.
        value: the mean of the values; of an angle its range.
        deviation: standard deviation of the values, NaN of one and of an angle.
        n: the number of values; of an angle that of the frames in which it was seen.
        low, high: the smallest and the largest value.
    """

    quantity: str
    side: str
    value: float
    deviation: float
    n: int
    low: float
    high: float


@dataclasses.dataclass(frozen=True, eq=False)
class Movement:
    """What a person does in a take: angles (degrees) and centre of mass (m, Y up) over time, and single events."""

    steady: SteadyJoints
    angles: dict[str, Float[ndarray, " t"]]
    mass_centre: Float[ndarray, "t 3"]
    swings: list[Swing]
    strides: list[Stride]
    transfers: list[Transfer]


def movement(steady: SteadyJoints, anthropometry: Anthropometry = "mean") -> Movement:
    """Everything that is measured of a person."""
    walked = swings(steady)
    return Movement(
        steady, joint_angles(steady), centre_of_mass(steady, anthropometry), walked, strides(walked), transfers(steady)
    )


def trials(markers: Sequence[tuple[float, str]]) -> list[Trial]:
    """The trials of a take: each from a marker to the next one, the last one to the end. A marker called "end" or
    "stop" begins none. Without markers the whole take is one trial, "all"."""
    if not markers:
        return [Trial("all", -np.inf, np.inf)]
    ends = [*(time_s for time_s, _ in markers[1:]), np.inf]
    return [
        Trial(text or f"trial {i + 1}", time_s, end_s)
        for i, ((time_s, text), end_s) in enumerate(zip(markers, ends, strict=True))
        if text.strip().lower() not in _ENDS and end_s > time_s
    ]


def measure(moved: Movement, trial: Trial) -> list[Measure]:
    """The numbers of a trial; what was not seen in it has none."""
    inside = (moved.steady.times_s >= trial.start_s) & (moved.steady.times_s < trial.end_s)
    return [*_of_gait(moved, trial), *_of_transfers(moved, trial), *_of_angles(moved, inside)]


def _of_gait(moved: Movement, trial: Trial) -> Iterator[Measure]:
    in_trial = [stride for stride in moved.strides if trial.holds(stride.start_s, stride.end_s)]
    if not in_trial:
        return
    means: dict[tuple[str, str], float] = {}
    for quantity in in_trial[0].values:
        for side in ("", *SIDES):
            values = [stride.values[quantity] for stride in in_trial if side in ("", stride.side)]
            if (statistic := _statistics(quantity, side, values)) is not None:
                means[quantity, side] = statistic.value
                yield statistic
    for quantity in SYMMETRIES:
        left, right = (means.get((quantity, side), float("nan")) for side in SIDES)
        value = asymmetry(left, right)
        if np.isfinite(value):
            yield Measure(f"{quantity}_asymmetry", "", value, float("nan"), len(in_trial), value, value)
    times_s, height = moved.steady.times_s, moved.mass_centre[:, 1]
    ranges = [float(np.ptp(height[(times_s >= stride.start_s) & (times_s <= stride.end_s)])) for stride in in_trial]
    if (statistic := _statistics("mass_centre_range", "", ranges)) is not None:
        yield statistic


def _of_transfers(moved: Movement, trial: Trial) -> Iterator[Measure]:
    in_trial = [transfer for transfer in moved.transfers if trial.holds(transfer.start_s, transfer.end_s)]
    for kind in ("sit_to_stand", "stand_to_sit"):
        seconds = [transfer.seconds for transfer in in_trial if transfer.kind == kind]
        if (statistic := _statistics(kind, "", seconds)) is not None:
            yield statistic


def _of_angles(moved: Movement, inside: ndarray) -> Iterator[Measure]:
    for name, values in moved.angles.items():
        seen = values[inside & ~np.isnan(values)]
        if len(seen) * moved.steady.frame_s < _LEAST_SEEN_S:
            continue
        base, _, side = name.rpartition("_")
        quantity, side = (base, side) if side in SIDES else (name, "")
        low, high = float(seen.min()), float(seen.max())
        yield Measure(quantity, side, high - low, float("nan"), len(seen), low, high)


def _statistics(quantity: str, side: str, values: Sequence[float]) -> Measure | None:
    known = np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return None
    deviation = float(known.std(ddof=1)) if len(known) > 1 else float("nan")
    return Measure(quantity, side, float(known.mean()), deviation, len(known), float(known.min()), float(known.max()))
