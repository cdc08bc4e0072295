"""``depthmocap evaluate motion``: what the filters over time do to joints that were estimated frame by frame."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from depthmocap.body.skeleton import JOINTS, MIRROR
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import networks_on
from depthmocap.core.settings import plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.estimated_sequences import EstimateStore, SequenceEstimates, estimate_sequence
from depthmocap.evaluate.moving_people import FPS, PostureSequence, clip_motions, moving_frames, prior_motions
from depthmocap.evaluate.sequence_settings import SequenceSettings
from depthmocap.evaluate.temporal_metrics import TemporalMetrics, temporal_metrics
from depthmocap.frames import Pose
from depthmocap.pose.estimators import load_estimator
from depthmocap.report.page import ReportSection, ReportTable, write_report
from depthmocap.smooth.filters import AUTO, BONES_CHOICES, FILTERS, load_filter
from depthmocap.smooth.pose_filter import PoseFilter
from depthmocap.smooth.swap_guard import LIMBS, limb_joints
from depthmocap.synth.sensing.sensors import find_sensor

#: Settings that the estimates do not depend on, or that only tell how many there are.
_FREE_SETTINGS = ("out", "device", "sequences", "sides_wrong", "out_of_step_ms", "lag_frames", "json", "report")
#: Columns of the table: field, heading, digits.
_COLUMNS = (
    ("mean_joint_error_cm", "error cm", 2),
    ("acceleration_error_mm", "accel mm/f²", 1),
    ("rest_jitter_mm", "jitter mm", 2),
    ("foot_skate_cmps", "skate cm/s", 1),
    ("bone_deviation_mm", "bones mm", 1),
    ("flips_per_1000", "flips ‰", 1),
    ("lag_ms", "lag ms", 0),
    ("waits_ms", "waits ms", 0),
    ("us_per_frame", "CPU µs", 0),
)


@dataclasses.dataclass(frozen=True)
class MotionEvaluation(SequenceSettings):
    """Joints over time on generated sequences: a person moves, cameras with errors look, the network labels, joints
    are estimated frame by frame, and every filter is applied to them, those of one view and those of all views.

    Attributes:
        seconds: of motion a sequence, before it comes to rest.
        sides_wrong: a fault: share (0–1) of frames whose legs or arms or both are given the wrong sides.
        out_of_step_ms: a fault: every camera looks up to so long before or after the others; the sequences are measured
            once more like this, and the growth of the error is told.
        lag_frames: that the fixed-lag smoother waits for.
        report: file for a page with the tables (.html).
    """

    seconds: float = 3.0
    sides_wrong: float = 0.0
    out_of_step_ms: float = 0.0
    lag_frames: int = 4
    report: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.seconds <= 60:
            raise InputError(f"--seconds takes 1 to 60, got {self.seconds:g}")
        if not 0 <= self.sides_wrong < 1:
            raise InputError(f"--sides-wrong must be at least 0 and below 1, got {self.sides_wrong}")
        if not 0 <= self.out_of_step_ms <= 1e3 / FPS or (self.out_of_step_ms and self.views < 2):
            raise InputError(
                f"--out-of-step-ms takes 0 to {1e3 / FPS:.0f}, a frame, of 2 or more --views; got {self.out_of_step_ms}"
            )

    def outputs(self) -> dict[str, Path | None]:
        return super().outputs() | {"--report": self.report}


@locks_outputs(folder="out", files=("json", "report"))
def evaluate_motion(settings: MotionEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Make or read the estimates and measure every filter; returns the numbers by views and filter.

    Raises:
        InputError: clips, weights or sensors that cannot be read, or estimates in ``out`` of other settings.
    """
    console = console or Terminal(stderr=True)
    sequences = make_estimates(settings, console)
    numbers: dict[str, Any] = {
        "settings": plain_settings(settings),
        "sequences": [sequence.name for sequence in sequences],
        "frames": sum(len(sequence.truth) for sequence in sequences),
    }
    for views in sorted({1, settings.views}):
        numbers[f"views {views}"] = _all_filters(sequences, views, settings, "", console)
    if settings.out_of_step_ms:
        title = f"out of step by up to {settings.out_of_step_ms:g} ms"
        off = make_estimates(settings, console, settings.out_of_step_ms)
        rows = numbers["out of step"] = _all_filters(off, settings.views, settings, f", {title}", console)
        growth = numbers["out of step, growth"] = {
            name: row["mean_joint_error_cm"] / numbers[f"views {settings.views}"][name]["mean_joint_error_cm"] - 1
            for name, row in rows.items()
        }
        shown = ", ".join(f"{name} {growth[name]:+.1%}" for name in ("none", f"{AUTO}, steady bones"))
        console.print(f"error {title}: {shown}")
    settings.write_numbers(numbers)
    if settings.report is not None:
        write_report(settings.report, "Joints over time", _sections(numbers))
    return numbers


def _all_filters(
    sequences: Sequence[SequenceEstimates], views: int, settings: MotionEvaluation, title: str, console: Console
) -> dict[str, dict[str, float]]:
    """The numbers of the estimates as they are, and of every filter with bones free and steady."""
    poses = [
        _swap_limbs(sequence.poses(views), settings.sides_wrong, np.random.default_rng([settings.seed, 2, i]))
        for i, sequence in enumerate(sequences)
    ]
    truths = [sequence.truth for sequence in sequences]
    rows = {"none": _measure(lambda: None, poses, truths)}
    for name, bones in itertools.product(FILTERS, BONES_CHOICES):
        rows[f"{name}, {bones} bones"] = _measure(
            lambda name=name, bones=bones: load_filter(name, settings.lag_frames, bones=bones), poses, truths
        )
    frames = sum(map(len, poses))
    console.print(_table(f"{frames} frames, {views} view{'s' * (views > 1)}{title}", rows))
    return rows


def make_estimates(
    settings: MotionEvaluation, console: Console, out_of_step_ms: float = 0.0
) -> list[SequenceEstimates]:
    """The sequences' estimates, read or made."""
    fixed = estimate_settings(settings)
    sensors = tuple(find_sensor(name) for name in settings.sensors)
    folder = settings.out / f"out_of_step_{out_of_step_ms:g}_ms" if out_of_step_ms else settings.out
    store = EstimateStore(folder, fixed)
    sequences = [store.load(index) for index in range(settings.sequences)]
    complete = [estimates for estimates in sequences if estimates is not None]
    if len(complete) == len(sequences):
        return complete
    motions = posture_sequences(settings)
    with networks_on(settings.device):
        classifier, estimator = Classifier(settings.weights), load_estimator(settings.estimator)
    complete = []
    with Progress(console=console) as progress:
        for index, motion in enumerate(progress.track(motions, settings.sequences, description="estimating")):
            estimates = sequences[index]
            if estimates is None:
                frames = moving_frames(
                    motion, settings.views, sensors, sequence_rng(settings, index), out_of_step_ms / 1e3
                )
                estimates = estimate_sequence(motion.name, frames, classifier, estimator)
                store.save(index, estimates)
            complete.append(estimates)
    return complete


def estimate_settings(settings: MotionEvaluation) -> dict[str, Any]:
    """Those that estimates depend on."""
    return {k: v for k, v in plain_settings(settings).items() if k not in _FREE_SETTINGS}


def posture_sequences(settings: MotionEvaluation) -> Iterator[PostureSequence]:
    """The motions that estimates are made of, in order.

    Raises:
        InputError: clips that cannot be read, or too few of them.
    """
    rng = np.random.default_rng([settings.seed, 0])
    if settings.postures is None:
        return prior_motions(settings.sequences, settings.seconds, rng)
    return clip_motions(settings.postures, settings.split, settings.sequences, settings.seconds, rng)


def sequence_rng(settings: MotionEvaluation, index: int) -> np.random.Generator:
    """What the person, the cameras and the noise of a sequence are drawn from."""
    return np.random.default_rng([settings.seed, 1, index])


def apply_filter(filter_: PoseFilter | None, poses: Sequence[Pose]) -> list[Pose]:
    """A whole stream through a filter: a result for every pose, of its own time."""
    if filter_ is None:
        return list(poses)
    return [filter_(pose) for pose in poses][filter_.delay_frames :] + filter_.finish()


def _measure(
    make: Callable[[], PoseFilter | None], streams: list[list[Pose]], truths: list[Float[ndarray, "_ 18 3"]]
) -> dict[str, float]:
    """Numbers of one filter; ``lag_ms`` is of the poses by their own time, ``waits_ms`` comes on top of it."""
    filter_, estimates = make(), []
    start = time.process_time()
    for poses in streams:
        estimates.append(np.stack([pose.joints for pose in apply_filter(filter_, poses)]))
        if filter_ is not None:
            filter_.reset()
    spent_s = time.process_time() - start
    metrics: TemporalMetrics = temporal_metrics(estimates, truths, 1 / FPS)
    return dataclasses.asdict(metrics) | {
        "waits_ms": 1e3 * filter_.delay_frames / FPS if filter_ else 0.0,
        "us_per_frame": 1e6 * spent_s / sum(map(len, streams)),
    }


def _swap_limbs(poses: list[Pose], share: float, rng: np.random.Generator) -> list[Pose]:
    """The poses, in a share of which the legs, the arms or both have changed places."""
    if not share:
        return poses
    limbs = [limb_joints(limb) for limb in LIMBS]
    choices = [*limbs, np.any(limbs, axis=0)]
    swapped = []
    for pose in poses:
        if rng.random() < share:
            order = np.where(choices[rng.integers(len(choices))], MIRROR, np.arange(len(JOINTS)))
            pose = Pose(pose.timestamp_ns, pose.joints[order], pose.confidence[order])
        swapped.append(pose)
    return swapped


def _sections(numbers: dict[str, Any]) -> list[ReportSection]:
    """Of the page: a table for every number of views, and one of the fault."""
    sections = []
    for name in (name for name in numbers if name.startswith("views") or name == "out of step"):
        header = ["filter", *(heading for _, heading, _ in _COLUMNS)]
        rows = [[row, *(values[field] for field, _, _ in _COLUMNS)] for row, values in numbers[name].items()]
        sections.append(ReportSection(name, tables=(ReportTable(header, rows),)))
    about = [[key.replace("_", " "), str(value)] for key, value in numbers["settings"].items() if value is not None]
    text = f"{numbers['frames']} frames of {', '.join(numbers['sequences'])}."
    return [*sections, ReportSection("How it was measured", (text,), (ReportTable(("setting", "value"), about),))]


def _table(title: str, rows: dict[str, dict[str, float]]) -> Table:
    table = Table(title=title, box=None, padding=(0, 1, 0, 0))
    table.add_column("filter", no_wrap=True)
    for _, heading, _ in _COLUMNS:
        table.add_column(heading, justify="right")
    for name, numbers in rows.items():
        table.add_row(name, *(f"{numbers[field]:.{digits}f}" for field, _, digits in _COLUMNS))
    return table
