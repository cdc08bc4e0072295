"""``depthmocap postures build``: a pool of the most dissimilar postures of clips, filled up with synthetic ones."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import check_outputs
from depthmocap.core.settings import check_seed, plain_settings
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import mirror_posture
from depthmocap.synth.motion.clips.retarget import Up
from depthmocap.synth.motion.clips.skeletons import read_mapping
from depthmocap.synth.motion.cover import Cover, farthest_points
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.mocap import SPLITS, Clip, ClipFolder, ClipReading, SkippedClip, check_any_read
from depthmocap.synth.motion.pool import KINDS, PosturePool
from depthmocap.synth.motion.postures import UPPER_BONES, anny_rest

#: Number of candidates per posture of the pool, from which farthest-point sampling selects.
_CANDIDATES_PER_POSTURE = 3
#: Number of synthetic postures in a batch.
_BATCH = 4096
#: Share of distinct postures in a batch below which filling ends.
_LEAST_DISTINCT_SHARE = 0.01


@dataclasses.dataclass(frozen=True)
class PoolBuild:
    """Pick the most dissimilar postures of a folder of clips, and fill up where the clips give few.

    Attributes:
        clips: folder of BVH and ASF/AMC files; manifest.csv (file, description, fps) marks the walking ones.
        out: the .npz file to write; give it to --postures of other commands.
        count: postures, of all splits together.
        easy: least number of these from walking and running, if there are such clips.
        preset: "paper": 100,000 postures, 10,000 of them easy, as in the paper, in place of --count and --easy.
        shares: of the postures, for train, valid and test. Clips, not postures, are divided: by their names.
        spacing_m: least distance of two recorded postures of the pool, in the joint that differs most.
        fill: add mirrored, recombined and perturbed postures where the clips give too few.
        noise_rad: standard deviation of a perturbation, per axis of a bone.
        mapping: JSON file, joint of a posture bone, for skeletons with names of their own.
        skeletons: ASF file for a subject without one: --skeletons 88 86.asf 90 86.asf
        up: the axis that is up in the files' worlds; by default it follows from each file's rest pose and the path of
            its root.
        seed: the same seed gives the same pool.
    """

    clips: Path
    out: Path
    count: int = 100_000
    easy: int = 0
    preset: Literal["paper"] | None = None
    shares: tuple[float, float, float] = (0.8, 0.1, 0.1)
    spacing_m: float = 0.05
    fill: bool = True
    noise_rad: float = 0.08
    mapping: Path | None = None
    skeletons: dict[str, str] = dataclasses.field(default_factory=dict)
    up: Up | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.out.suffix != ".npz" or self.out.is_dir():
            raise InputError(f"--out must be a file that ends in .npz, got {self.out}")
        if self.preset == "paper":
            if self.count != 100_000 or self.easy not in (0, 10_000):
                raise InputError(f"--preset paper tells --count and --easy: leave out {self.count} and {self.easy}")
            object.__setattr__(self, "count", 100_000)
            object.__setattr__(self, "easy", 10_000)
        if self.count < 1 or not 0 <= self.easy <= self.count:
            raise InputError(f"--count must be at least 1 and --easy from 0 to --count, got {self.count}, {self.easy}")
        if not (min(self.shares) >= 0 and abs(sum(self.shares) - 1) <= 1e-6):
            raise InputError(f"--shares must be three shares that add up to 1, got {self.shares}")
        if not (0 < self.spacing_m < np.inf and 0 <= self.noise_rad < np.inf):
            raise InputError(
                f"--spacing-m must be above 0 and --noise-rad not below, got {self.spacing_m}, {self.noise_rad}"
            )
        check_seed(self.seed)


@dataclasses.dataclass(frozen=True)
class _Quota:
    count: int
    easy: int


@locks_outputs(files=("out",))
def build_pool(settings: PoolBuild) -> PosturePool:
    """Read the clips one by one, select, fill, write the pool and print a summary. Memory depends on the number of
    postures (about 1.5 kB each), not on that of the clips.

    Raises:
        InputError: no readable clip, a bad mapping or manifest, or a file that cannot be written.
    """
    console = Terminal()
    joints = read_mapping(settings.mapping) if settings.mapping else {}
    folder = ClipFolder.open(settings.clips, ClipReading(joints, settings.skeletons, settings.up))
    check_outputs({"--out": settings.out})
    quotas = [_Quota(round(settings.count * share), round(settings.easy * share)) for share in settings.shares]
    covers = [Cover(settings.spacing_m, max(1000, _CANDIDATES_PER_POSTURE * quota.count)) for quota in quotas]
    rng = np.random.default_rng(settings.seed)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        read, skipped = _read_clips(folder.read(anny_rest()), len(folder), covers, progress)
        check_any_read(settings.clips, len(read), skipped)
        task = progress.add_task("picking postures", total=settings.count)
        parts, stops, done = [], {}, 0
        for split, cover, quota in zip(SPLITS, covers, quotas, strict=True):

            def show(picked: int, before: int = done) -> None:
                progress.update(task, completed=before + picked)

            selected, stops[split] = _select(cover, quota, settings, rng, show)
            parts.append((cover.postures[selected].copy(), cover.tags[selected].copy()))
            done += len(selected)
            progress.update(task, completed=done)
    tags = np.concatenate([tags for _, tags in parts])
    clips, simple, kinds = _unpack_tag(tags)
    splits = np.repeat(np.arange(len(SPLITS)), [len(tags) for _, tags in parts]).astype(np.uint8)
    postures = np.concatenate([postures for postures, _ in parts])
    report = _report(settings, read, skipped, stops)
    pool = PosturePool(postures, clips, splits, simple, kinds, tuple(clip.name for clip in read), report)
    report["counts"] = count_by_split(pool)
    pool.save(settings.out)
    _print_report(console, pool, settings)
    return pool


def _read_clips(
    clips: Iterable[Clip | SkippedClip], count: int, covers: Sequence[Cover], progress: Progress
) -> tuple[list[Clip], list[SkippedClip]]:
    """Add the postures of all clips to the covers of their splits; returns the clips without their postures."""
    read: list[Clip] = []
    skipped: list[SkippedClip] = []
    task = progress.add_task("reading clips", total=count)
    for clip in clips:
        if isinstance(clip, Clip):
            split = SPLITS.index(clip.split)
            covers[split].add(clip.postures, np.full(len(clip.postures), _pack_tag(len(read), clip.simple, 0)))
            read.append(dataclasses.replace(clip, postures=clip.postures[:0]))
        else:
            skipped.append(clip)
        progress.advance(task)
    return read, skipped


def _report(
    settings: PoolBuild, read: Sequence[Clip], skipped: Sequence[SkippedClip], distances_m: dict[str, dict[str, float]]
) -> dict[str, Any]:
    """The report that the pool's file holds."""
    return {
        "settings": plain_settings(settings),
        "clips_read": len(read),
        "skipped": {clip.name: clip.reason for clip in skipped},
        "frames": sum(clip.frames for clip in read),
        "flipped_frames": sum(clip.flipped for clip in read),
        "impossible_frames": sum(clip.impossible for clip in read),
        "skeletons": dict(Counter(clip.skeleton for clip in read)),
        "up": {clip.name: clip.up for clip in read if clip.up is not None},
        "lying": [clip.name for clip in read if clip.lies],
        "distances_m": distances_m,
    }


def _pack_tag(clip: int, simple: bool, kind: int) -> int:
    """Clip, ``simple`` and kind of a posture in one integer."""
    return clip * 16 + int(simple) * 8 + kind


def _unpack_tag(tags: Int[ndarray, "n"]) -> tuple[ndarray, ndarray, ndarray]:
    return (tags // 16).astype(np.int32), tags % 16 >= 8, (tags % 8).astype(np.uint8)


def _select(
    cover: Cover, quota: _Quota, settings: PoolBuild, rng: np.random.Generator, show: Any
) -> tuple[Int[ndarray, "k"], dict[str, float]]:
    """Indices of the selected postures of a split in its cover, and distances (metres): the least distance between
    candidates, and the distance of the first posture that was not selected."""
    if not quota.count or not cover.count:
        return np.zeros(0, dtype=np.int64), {}
    distances = {"candidates": cover.radius_m, "stop": cover.radius_m}
    if settings.fill:
        _fill(cover, quota.easy, True, settings, rng)
    if cover.count <= quota.count:
        if settings.fill:
            _fill(cover, quota.count, False, settings, rng)
        return np.arange(cover.count), distances
    simple = _unpack_tag(cover.tags)[1]
    everything = np.ones(cover.count, dtype=bool)
    selected, stop = farthest_points(cover.ends, [(simple, quota.easy), (everything, quota.count)], show)
    return selected, distances | {"stop": stop}


def _fill(cover: Cover, target: int, easy: bool, settings: PoolBuild, rng: np.random.Generator) -> None:
    """Add synthetic postures until there are ``target`` postures (easy ones, with ``easy``).

    First all mirrored postures; half of the rest are recombined (legs of one posture, trunk and arms of another), half
    perturbed. All are within the joint limits and distinct from each other.
    """
    recorded = np.flatnonzero(_is_eligible(cover, easy) & (_unpack_tag(cover.tags)[2] == KINDS.index("recorded")))
    if not len(recorded):
        return

    def missing() -> int:
        return target - int(_is_eligible(cover, easy).sum())

    def add(postures: ndarray, sources: ndarray, kind: str) -> int:
        is_valid = within_limits(postures)
        clips, simple, _ = _unpack_tag(cover.tags[sources[is_valid]])
        tags = clips.astype(np.int64) * 16 + simple * 8 + KINDS.index(kind)
        return cover.add(postures[is_valid], tags, limit=cover.count + max(missing(), 0))

    for rows in np.array_split(rng.permutation(recorded), max(1, len(recorded) // _BATCH)):
        if missing() > 0:
            add(mirror_posture(cover.postures[rows]), rows, "mirrored")
    half = missing() // 2
    while missing() > half:
        legs, arms = rng.choice(recorded, (2, _BATCH))
        # Only easy postures are combined with easy ones, so that the results are easy.
        legs, arms = (
            rows[_unpack_tag(cover.tags[legs])[1] == _unpack_tag(cover.tags[arms])[1]] for rows in (legs, arms)
        )
        mixed = cover.postures[legs].copy()
        mixed[:, UPPER_BONES] = cover.postures[arms][:, UPPER_BONES]
        batch = max(1, min(len(mixed), missing() - half))
        if add(mixed[:batch], legs[:batch], "recombined") < _LEAST_DISTINCT_SHARE * batch:
            break
    while missing() > 0:
        base = rng.choice(np.flatnonzero(_is_eligible(cover, easy)), _BATCH)
        perturbed = cover.postures[base] + rng.normal(0, settings.noise_rad, (_BATCH, 20, 3)).astype(np.float32)
        if add(perturbed, base, "perturbed") < _LEAST_DISTINCT_SHARE * _BATCH:
            break


def _is_eligible(cover: Cover, easy: bool) -> Bool[ndarray, "n"]:
    return _unpack_tag(cover.tags)[1] | (not easy)


def count_by_split(pool: PosturePool) -> dict[str, dict[str, int]]:
    """Number of postures by split: all, easy ones, and by kind."""
    table = {}
    for index, split in enumerate(SPLITS):
        of_split = pool.splits == index
        kinds = {kind: int((of_split & (pool.kinds == k)).sum()) for k, kind in enumerate(KINDS)}
        table[split] = {"postures": int(of_split.sum()), "easy": int((of_split & pool.simple).sum()), **kinds}
    return table


def _clips_by_axis(up: dict[str, str]) -> dict[str, list[str]]:
    return {axis: [name for name, clip_axis in up.items() if clip_axis == axis] for axis in sorted(set(up.values()))}


def _first_names(names: list[str]) -> str:
    """The first five names, as text."""
    return ", ".join(names[:5]) + (", …" if len(names) > 5 else "")


def _print_report(console: Console, pool: PosturePool, settings: PoolBuild) -> None:
    report = pool.report
    skipped = report["skipped"]
    console.print(
        f"{report['clips_read']} clips, {report['frames']} frames; left out: {report['flipped_frames']} around flips, "
        f"{report['impossible_frames']} impossible; {len(skipped)} clips skipped",
    )
    for name, reason in skipped.items():
        console.print(f"  skipped {name}: {reason}", soft_wrap=True)
    for skeleton, clips in report["skeletons"].items():
        if skeleton.startswith("guessed"):
            console.print(f"  {clips} clips {skeleton}", soft_wrap=True)
    for axis, names in _clips_by_axis(report["up"]).items():
        console.print(
            f"  up is {axis} in {len(names)} clips, as the path of the root tells, and not as in the rest pose: "
            f"{_first_names(names)}", soft_wrap=True,
        )  # fmt: skip
    if report["lying"]:
        console.print(
            f"  nobody stands or sits in {len(report['lying'])} clips; if that is wrong, tell --up: "
            f"{_first_names(report['lying'])}", style="yellow", soft_wrap=True,
        )  # fmt: skip
    table = Table("split", "postures", "easy", *KINDS, "stop")
    for split, counts in report["counts"].items():
        distances = report["distances_m"][split]
        stop = f"{100 * distances['stop']:.1f} cm" if distances else "–"
        table.add_row(split, *(str(value) for value in counts.values()), stop)
    console.print(table)
    for split, share in zip(SPLITS, settings.shares, strict=True):
        held, target = report["counts"][split]["postures"], round(settings.count * share)
        if held < target:
            why = (
                f"its clips give no more that differ by {100 * settings.spacing_m:g} cm; lower --spacing-m or"
                if held
                else "no clip falls in it;"
            )
            console.print(f"{split}: {held} of {target} postures: {why} give more clips", style="yellow")
    console.print(f"wrote {settings.out} ({settings.out.stat().st_size / 1e6:.1f} MB)")
