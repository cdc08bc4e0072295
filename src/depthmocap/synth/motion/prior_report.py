"""``depthmocap postures report``: distances between the prior's samples and held-out postures, and plausibility."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import check_outputs, write_json
from depthmocap.core.settings import check_seed, plain_settings
from depthmocap.errors import InputError
from depthmocap.kernels.nearest_postures import nearest_distances
from depthmocap.synth.body.mesh import BodyModel, Phenotype
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.mocap import Clip, without_heading
from depthmocap.synth.motion.postures import (
    TRAINING_VARIATION,
    ClipPostures,
    PosturePrior,
    PostureSource,
    Variation,
    joint_positions,
    load_clips,
)

#: Quantiles of distances in the report.
_QUANTILES = (0.1, 0.5, 0.9)
#: Bones at the ends of the trunk's capsule.
_TRUNK_BONES = ("root", "spine01")
#: Radius of the trunk's capsule. It and the next two are less than the default body's, so that contact does not count
#: as penetration (metres; our choice).
_TRUNK_RADIUS_M = 0.08
#: Radius of the head.
_HEAD_RADIUS_M = 0.07
#: Radius of a leg's capsules.
_LEG_RADIUS_M = 0.04
#: Distance from the head's joint to its centre (metres).
_HEAD_CENTRE_M = 0.09
#: Joints that must not penetrate: elbows, wrists, knuckles and ankles.
_TIP_BONES = ("lowerarm01", "wrist", "finger3-1", "foot")


@dataclasses.dataclass(frozen=True)
class PostureReport:
    """Compare the posture prior, and training clips, with held-out clips.

    Attributes:
        clips: folder of BVH and ASF/AMC files; those of valid and test are the held-out ones.
        prior: a prior of your own; by default the packaged one.
        samples: postures of each source.
        json: file for the numbers.
        seed: of what is drawn.
    """

    clips: Path
    prior: Path | None = None
    samples: int = 3000
    json: Path | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_outputs({"--json": self.json})
        if self.samples < 10:
            raise InputError(f"--samples must be at least 10, got {self.samples}")
        check_seed(self.seed)


@locks_outputs(files=("json",))
def report_postures(settings: PostureReport) -> dict[str, Any]:
    """Compare the prior, training clips, and training clips with variation to held-out clips: nearest distances in both
    directions, and plausibility. Prints a table; returns (and writes) the numbers.

    Raises:
        InputError: no readable clips, none held out or none for training, or a bad prior.
    """
    clips = load_clips(settings.clips)
    console = Terminal()
    report: dict[str, Any] = {"settings": plain_settings(settings)}
    for simple in (False, True):
        if simple and not any(clip.simple for clip in clips):
            console.print("no clip is described as walking or running: no table of easy postures")
            continue
        rows = compare_sources(clips, simple, settings)
        report["easy" if simple else "all"] = rows
        console.print(_table("walking and running" if simple else "all postures", rows))
    if settings.json:
        write_json(settings.json, report)
    return report


def compare_sources(clips: list[Clip], simple: bool, settings: PostureReport) -> dict[str, dict[str, Any]]:
    """Quantiles of distances (metres) and shares of one table, by source."""
    as_recorded = Variation(mirror=0.5)
    rng = np.random.default_rng(settings.seed)
    held_out = np.concatenate(
        [ClipPostures(clips, split, simple, as_recorded).postures for split in _held_out_splits(clips, simple)]
    ).astype(np.float64)
    sources: dict[str, PostureSource] = {
        "prior": PosturePrior.load(settings.prior, simple, as_recorded),
        "training clips": ClipPostures(clips, "train", simple, as_recorded),
        "training clips, varied": ClipPostures(clips, "train", simple, TRAINING_VARIATION),
    }
    held_out_ends = joint_positions(held_out).astype(np.float32)
    rows: dict[str, dict[str, Any]] = {}
    for name, source in sources.items():
        samples_drawn = np.stack([source.sample(rng)[0] for _ in range(settings.samples)])
        ends = joint_positions(without_heading(samples_drawn)).astype(np.float32)
        rows[name] = {
            "to_held_out_m": _quantiles(distances_to_nearest(ends, held_out_ends)),
            "from_held_out_m": _quantiles(distances_to_nearest(held_out_ends, ends)),
            **_plausibility(samples_drawn),
        }
    subset = held_out[rng.permutation(len(held_out))[: settings.samples]]
    rows["held-out clips"] = _plausibility(subset)
    return rows


def _held_out_splits(clips: list[Clip], simple: bool) -> list[str]:
    splits = {clip.split for clip in clips if len(clip.postures) and (clip.simple or not simple)}
    if not splits & {"valid", "test"}:
        raise InputError("no clip falls in the valid or test split: give more clips")
    return sorted(splits & {"valid", "test"})


def distances_to_nearest(ends: Float[ndarray, "n 20 3"], others: Float[ndarray, "m 20 3"]) -> Float[ndarray, "n"]:
    """Distance of every posture to the nearest other one, in the joint that differs most (metres)."""
    out = np.empty(len(ends), np.float32)
    nearest_distances(ends, others, out)
    return out


def _quantiles(distances: Float[ndarray, "n"]) -> dict[str, float]:
    return {
        f"p{round(100 * q)}": round(float(value), 4)
        for q, value in zip(_QUANTILES, np.quantile(distances, _QUANTILES), strict=True)
    }


def _plausibility(postures: Float[ndarray, "n 20 3"]) -> dict[str, float]:
    return {
        "within_limits": round(float(within_limits(postures).mean()), 4),
        "penetrating": round(float(is_penetrating(postures).mean()), 4),
    }


def is_penetrating(postures: Float[ndarray, "n 20 3"]) -> Bool[ndarray, "n"]:
    """Whether an elbow, wrist, knuckle or ankle of the default body penetrates its trunk, its head or the other leg,
    which are modelled as capsules: a coarse measure, to be compared with that of recorded postures."""
    model = BodyModel.load()
    body = model.shape(Phenotype())
    index = {name: i for i, name in enumerate(model.bone_names)}
    transforms = [body.bone_transforms(posture.astype(np.float64)) for posture in postures]
    heads = np.stack([transform.heads for transform in transforms])
    up = np.stack([transform.rotations[index["head"], :, 2] for transform in transforms])
    tips = heads[:, [index[f"{tip}.{side}"] for tip in _TIP_BONES for side in "RL"]]
    trunk = _distances_to_segment(tips, heads[:, index[_TRUNK_BONES[0]]], heads[:, index[_TRUNK_BONES[1]]])
    skull = np.linalg.norm(tips - (heads[:, index["head"]] + _HEAD_CENTRE_M * up)[:, None], axis=-1)
    inside = (trunk < _TRUNK_RADIUS_M).any(1) | (skull < _HEAD_RADIUS_M).any(1)
    for side, other in ("RL", "LR"):
        ankle = heads[:, [index[f"foot.{side}"]]]
        for start, end in (("upperleg01", "lowerleg01"), ("lowerleg01", "foot")):
            leg = _distances_to_segment(ankle, heads[:, index[f"{start}.{other}"]], heads[:, index[f"{end}.{other}"]])
            inside |= leg[:, 0] < _LEG_RADIUS_M
    return inside


def _distances_to_segment(
    points: Float[ndarray, "n k 3"], start: Float[ndarray, "n 3"], end: Float[ndarray, "n 3"]
) -> Float[ndarray, "n k"]:
    """Distance of points to the segment of their row."""
    along = (end - start)[:, None]
    share = ((points - start[:, None]) * along).sum(-1) / (along**2).sum(-1)
    return np.linalg.norm(points - start[:, None] - share.clip(0, 1)[..., None] * along, axis=-1)


def _table(title: str, rows: dict[str, dict[str, Any]]) -> Table:
    table = Table(
        "source",
        "to held-out, cm",
        "held-out to it, cm",
        "within limits",
        "penetrating",
        title=f"{title} (p10 p50 p90)",
    )
    for name, row in rows.items():
        distances = [
            " ".join(f"{100 * value:.1f}" for value in row[key].values()) if key in row else "–"
            for key in ("to_held_out_m", "from_held_out_m")
        ]
        table.add_row(name, *distances, f"{100 * row['within_limits']:.1f} %", f"{100 * row['penetrating']:.1f} %")
    return table
