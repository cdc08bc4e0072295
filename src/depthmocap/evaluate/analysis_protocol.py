"""``depthmocap evaluate analysis``: how far the numbers of ``analyse`` are from the truth, on generated people."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from depthmocap.analysis.gait_events import Swing, place_after
from depthmocap.analysis.measures import Movement, movement
from depthmocap.analysis.quantities import ANGLES, GAIT, TRANSFERS, quantity_of
from depthmocap.analysis.steady_joints import steady_joints
from depthmocap.analysis.strides import Stride, strides
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import networks_on
from depthmocap.core.settings import plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.estimated_sequences import EstimateStore, SequenceEstimates, estimate_sequence
from depthmocap.evaluate.motion_protocol import apply_filter
from depthmocap.evaluate.sequence_settings import SequenceSettings
from depthmocap.evaluate.walking_scenes import Scene, clip_scenes, made_scenes, seen_frames
from depthmocap.exporting.timeline import timeline
from depthmocap.frames import Pose
from depthmocap.pose.estimators import load_estimator
from depthmocap.smooth.filters import AUTO, load_filter
from depthmocap.synth.sensing.sensors import find_sensor

#: Settings that the estimates do not depend on.
_FREE_SETTINGS = ("out", "device", "json", "least_confidence", "cutoff_hz", "fill_s")
#: A true event without one found so near is missed (s).
_NEAR_S = 0.25
_EVENTS = ("heel_strike", "toe_off")


@dataclasses.dataclass(frozen=True)
class AnalysisEvaluation(SequenceSettings):
    """The numbers of ``analyse`` against the truth: generated people walk straight on, walk in turns, sit down and
    stand up, cameras with errors look, the network labels, joints are estimated and filtered as ``run`` does it.

    Attributes:
        postures: folder of motion capture clips, of whose walks some are shown as well.
        sequences: so many of each kind of motion.
        clips: so many clips at most.
        least_confidence, fill_s, cutoff_hz: as of ``analyse``.
    """

    sequences: int = 4
    clips: int = 12
    least_confidence: float = 0.5
    fill_s: float = 0.1
    cutoff_hz: float = 6.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.clips < 1:
            raise InputError(f"--clips takes at least 1, got {self.clips}")


@locks_outputs(folder="out", files=("json",))
def evaluate_analysis(settings: AnalysisEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Make or read the estimates and compare; returns the numbers by views, kind of motion and quantity.

    Raises:
        InputError: clips, weights or sensors that cannot be read, or estimates in ``out`` of other settings.
    """
    console = console or Terminal(stderr=True)
    scenes = list(made_scenes(settings.sequences, np.random.default_rng([settings.seed, 0])))
    if settings.postures is not None:
        rng = np.random.default_rng([settings.seed, 1])
        scenes += clip_scenes(settings.postures, settings.split, settings.clips, rng)
    sequences = _estimates(settings, scenes, console)
    numbers: dict[str, Any] = {
        "settings": plain_settings(settings),
        "frames": sum(len(scene.joints) for scene in scenes),
    }
    truths = [_true_movement(scene, settings) for scene in scenes]
    for views in sorted({1, 2, settings.views}):
        if views > settings.views:
            continue
        movements = [_found_movement(sequence.poses(views), settings) for sequence in sequences]
        errors: dict[str, dict[str, list[float]]] = {}
        for scene, truth, estimate in zip(scenes, truths, movements, strict=True):
            for quantity, values in _errors(truth, estimate).items():
                for kind in ("all", scene.kind):
                    errors.setdefault(kind, {}).setdefault(quantity, []).extend(values)
        rows = {kind: {name: _summary(values) for name, values in by.items()} for kind, by in errors.items()}
        numbers[f"views {views}"] = rows
        console.print(_table(f"{views} view{'s' * (views > 1)}", rows))
    settings.write_numbers(numbers)
    return numbers


def _estimates(settings: AnalysisEvaluation, scenes: Sequence[Scene], console: Console) -> list[SequenceEstimates]:
    fixed = {key: value for key, value in plain_settings(settings).items() if key not in _FREE_SETTINGS}
    store = EstimateStore(settings.out, fixed)
    sensors = tuple(find_sensor(name) for name in settings.sensors)
    with networks_on(settings.device):
        classifier, estimator = Classifier(settings.weights), load_estimator(settings.estimator)
    sequences = []
    with Progress(console=console) as progress:
        for index, scene in enumerate(progress.track(scenes, description="estimating")):
            sequence = store.load(index)
            if sequence is None:
                rng = np.random.default_rng([settings.seed, 2, index])
                frames = seen_frames(scene, settings.views, sensors, rng)
                sequence = estimate_sequence(scene.name, frames, classifier, estimator)
                store.save(index, sequence)
            sequences.append(sequence)
    return sequences


def _found_movement(poses: list[Pose], settings: AnalysisEvaluation) -> Movement:
    """What ``analyse`` finds in the result that ``run`` would write."""
    filtered = apply_filter(load_filter(AUTO), poses)
    line = timeline(filtered, "z", settings.least_confidence)
    return movement(steady_joints(line, settings.cutoff_hz, settings.fill_s))


def _true_movement(scene: Scene, settings: AnalysisEvaluation) -> Movement:
    """The truth: angles and transfers by the same definitions on the true joints as they are, and gait by heels and
    toes."""
    stamps = np.rint(scene.motion.times_s * 1e9).astype(np.int64).tolist()
    sure = np.ones(18)
    line = timeline([Pose(stamp, joints, sure) for stamp, joints in zip(stamps, scene.joints, strict=True)], "z")
    exact = movement(steady_joints(line, 0.0, 0.0))
    placed = []
    for swing in scene.swings:
        later = [other.toe_off_s for other in scene.swings if other.side == swing.side]
        next_s = min((at for at in later if at > swing.heel_strike_s), default=np.inf)
        placed.append(dataclasses.replace(swing, place=place_after(exact.steady, swing, next_s)))
    return dataclasses.replace(exact, swings=placed, strides=strides(placed))


def _errors(truth: Movement, found: Movement) -> dict[str, list[float]]:
    """Errors of every quantity: found less true. Of events in seconds; what was missed is NaN."""
    errors: dict[str, list[float]] = {}
    for swing in truth.swings:
        nearest = _nearest(swing, found.swings)
        for event in _EVENTS:
            value = getattr(nearest, f"{event}_s") - getattr(swing, f"{event}_s") if nearest else float("nan")
            errors.setdefault(event, []).append(value)
    for stride in truth.strides:
        same = next((other for other in found.strides if _same(other, stride)), None)
        for name, value in stride.values.items():
            if np.isfinite(value):
                errors.setdefault(name, []).append(same.values[name] - value if same else float("nan"))
    for transfer in truth.transfers:
        near = [other for other in found.transfers if other.kind == transfer.kind
                and other.start_s < transfer.end_s and transfer.start_s < other.end_s]  # fmt: skip
        errors.setdefault(transfer.kind, []).append(near[0].seconds - transfer.seconds if near else float("nan"))
    for column, true in truth.angles.items():
        name = column.removesuffix("_left").removesuffix("_right")
        seen = np.interp(truth.steady.times_s, found.steady.times_s, found.angles[column])
        difference = (seen - true + 180) % 360 - 180
        known = ~np.isnan(difference)
        if known.any():
            errors.setdefault(name, []).extend(difference[known].tolist())
            errors.setdefault(f"{name} range", []).append(float(np.ptp(seen[known]) - np.ptp(true[known])))
    between = _at_times(found.steady.times_s, found.mass_centre, truth.steady.times_s) - truth.mass_centre
    distance = np.linalg.norm(between, axis=-1)
    errors["mass_centre"] = distance[~np.isnan(distance)].tolist()
    return errors


def _at_times(
    times_s: Float[ndarray, " t"], points: Float[ndarray, "t 3"], at: Float[ndarray, " n"]
) -> Float[ndarray, "n 3"]:
    return np.stack([np.interp(at, times_s, axis) for axis in points.T], axis=1)


def _nearest(swing: Swing, among: Sequence[Swing]) -> Swing | None:
    near = [other for other in among if other.side == swing.side]
    best = min(near, key=lambda other: abs(other.heel_strike_s - swing.heel_strike_s), default=None)
    return best if best and abs(best.heel_strike_s - swing.heel_strike_s) < _NEAR_S else None


def _same(found: Stride, true: Stride) -> bool:
    return found.side == true.side and max(abs(found.start_s - true.start_s), abs(found.end_s - true.end_s)) < _NEAR_S


def _summary(values: list[float]) -> dict[str, Any]:
    """Of the errors of a quantity: how many, the mean, the mean of their sizes, and what 95 % are within."""
    known = np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return {"n": len(values), "found": 0.0}
    sizes = np.abs(known)
    return {
        "n": len(values),
        "found": len(known) / len(values),
        "bias": float(known.mean()),
        "error": float(sizes.mean()),
        "rms": float(np.sqrt((known**2).mean())),
        "within_95": float(np.quantile(sizes, 0.95)),
        "within_40ms": float((sizes <= 0.04).mean()),
    }


def unit_of(name: str) -> tuple[str, float]:
    """The unit in which tables tell a quantity, and its factor."""
    if name in _EVENTS:
        return "ms", 1e3
    if name == "mass_centre":
        return "cm", 1e2
    unit = quantity_of(name.removesuffix(" range")).unit
    return {"m": ("cm", 1e2), "s": ("ms", 1e3), "m/s": ("cm/s", 1e2)}.get(unit, (unit, 1.0))


def cells_of(name: str, rows: Mapping[str, Mapping[str, Any]]) -> tuple[str, list[str]]:
    """A quantity's unit and its cells: mean error by kind of motion, what 95 % of all are within, and how many of the
    true ones were found."""
    unit, factor = unit_of(name)
    cells = [f"{by[name]['error'] * factor:.1f}" if "error" in by.get(name, {}) else "" for by in rows.values()]
    whole = rows["all"][name]
    within = f"{whole['within_95'] * factor:.1f}" if "within_95" in whole else ""
    return unit, [*cells, within, f"{whole['found']:.0%} of {whole['n']:,}"]


def quantities_in_order(rows: dict[str, Any]) -> list[str]:
    """Names of what was measured, in the order of the table."""
    names = [*_EVENTS, *GAIT, *TRANSFERS, "mass_centre", *ANGLES, *(f"{name} range" for name in ANGLES)]
    return [name for name in names if name in rows]


def _table(title: str, rows: dict[str, dict[str, Any]]) -> Table:
    table = Table(title=title, box=None, padding=(0, 1, 0, 0))
    for heading in ("quantity", "unit"):
        table.add_column(heading, no_wrap=True)
    kinds = list(rows)
    for kind in kinds:
        table.add_column(kind, justify="right")
    table.add_column("95 % within", justify="right")
    table.add_column("found", justify="right")
    for name in quantities_in_order(rows["all"]):
        unit, cells = cells_of(name, rows)
        table.add_row(name.replace("_", " "), unit, *cells)
    return table
