"""``depthmocap synth``: labelled data sets on disk, of any size, on all cores or a cluster; the paper's among them."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import json
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from depthmocap.core.console import Terminal
from depthmocap.core.cores import usable_cores
from depthmocap.core.locks import LOCK_FILE, lock_folder
from depthmocap.core.output import write_file
from depthmocap.core.settings import check_seed, plain_settings, read_settings
from depthmocap.core.version import __version__
from depthmocap.errors import InputError
from depthmocap.synth.sample import Recipe
from depthmocap.synth.sensing.sensors import SENSORS
from depthmocap.synth.writing.card import CardRow, card_stride, write_card
from depthmocap.synth.writing.cluster import RayCluster
from depthmocap.synth.writing.units import Folder, Layout, Made, Unit, describing_units, make_unit, open_folder
from depthmocap.synth.writing.workers import ordered

Preset = Literal["paper-easy", "paper-inter", "paper-hard"]

#: Samples of the paper's Table 1. How they fall to train, valid and test it does not say: 80, 10 and 10 % is ours.
_PRESETS: dict[Preset, tuple[Literal["easy", "inter", "hard"], int]] = {
    "paper-easy": ("easy", 1_000_000),
    "paper-inter": ("inter", 1_300_000),
    "paper-hard": ("hard", 300_000),
}
_SPLITS = {"train": 0.8, "valid": 0.1, "test": 0.1}
#: The start of a process takes about as long as this number of samples.
_WORTH_A_WORKER = 100

_Runner = Callable[[Iterable[Unit]], Generator[Made, None, None]]


@dataclasses.dataclass(frozen=True)
class SynthSettings:
    """Random bodies in random postures seen by random cameras (Algorithm 1 of the paper).

    Attributes:
        out: the root that will hold <subset>-pose/<split>.
        recipe: what the data shows.
        samples: postures; each gives one picture per view. Run again with more to go on where it stopped.
        seed: the same seed gives the same data.
        format: UBC3V's layout of sections, or tar shards that the webdataset package reads.
        preset: sets of the paper's sizes, all three splits, in place of --subset, --split and --samples.
        workers: processes; all usable cores by default. 0 makes all in this one.
        ray: address of a Ray cluster that makes the set in a folder all its nodes share; "local" starts one here.
    """

    out: Path
    recipe: Annotated[Recipe, tyro.conf.OmitArgPrefixes] = dataclasses.field(default_factory=Recipe)
    samples: int = 1000
    seed: int = 0
    format: Layout = "ubc3v"
    preset: Preset | None = None
    workers: int | None = None
    ray: str | None = None


def generate(settings: SynthSettings, console: Console | None = None) -> Path:
    """Write the samples and return the split's folder (with a preset, the subset's). A run that was interrupted, in
    whatever way, goes on with the same command, and the set has the same contents.

    Every sample depends on its own index, the recipe and the seed alone.

    Raises:
        InputError: settings that cannot be; a folder that is not writable, holds something else or is being written;
            a full disk.
    """
    if settings.samples < 1:
        raise InputError(f"--samples must be at least 1, got {settings.samples}")
    if settings.workers is not None and settings.workers < 0:
        raise InputError(f"--workers must be at least 0, got {settings.workers}")
    check_seed(settings.seed)
    if settings.preset is not None:
        usual = SynthSettings(settings.out)
        for option in ("subset", "split"):
            if (value := getattr(settings.recipe, option)) != getattr(usual.recipe, option):
                raise InputError(f"--preset {settings.preset} tells --{option}: leave out {value}")
        if settings.samples != usual.samples:
            raise InputError(f"--preset {settings.preset} tells --samples: leave out {settings.samples}")
    if settings.format == "ubc3v":
        _check_storable(settings.recipe)
    console = console or Terminal(stderr=True)
    with contextlib.ExitStack() as stack:
        cluster = None if settings.ray is None else stack.enter_context(RayCluster(settings.ray))
        if settings.preset is None:
            return _make_set(settings, cluster, console)
        subset, samples = _PRESETS[settings.preset]
        folder = settings.out
        for split, share in _SPLITS.items():
            recipe = dataclasses.replace(settings.recipe, subset=subset, split=split)
            part = dataclasses.replace(settings, recipe=recipe, samples=round(samples * share))
            folder = _make_set(part, cluster, console)
        return folder.parent


def _check_storable(recipe: Recipe) -> None:
    """Raise InputError where UBC3V's layout could not hold the cameras, before anything is written."""
    if recipe.cameras.roll_rad > 0:
        raise InputError("UBC3V's layout cannot store a camera's roll: give --roll-rad 0 or --format shards")
    if any(preset != SENSORS["ubc3v"] for preset in recipe.presets):
        raise InputError(
            f"UBC3V's layout holds the pictures of --sensors ubc3v only, got {' '.join(recipe.sensors)}: "
            "use --format shards"
        )


def _make_set(settings: SynthSettings, cluster: RayCluster | None, console: Console) -> Path:
    recipe = settings.recipe
    folder = settings.out / f"{recipe.subset}-pose" / recipe.split
    try:
        with lock_folder(folder):
            if not (folder / "settings.json").exists() and (others := _others(folder)):
                raise InputError(
                    f"{folder} holds files of something else ({', '.join(others[:3])}) and no settings.json: "
                    "choose another --out or empty it"
                )
            identity = _claim(folder, settings)
            target = open_folder(folder, settings.format)
            samples = max(settings.samples, target.begun)
            whole = Unit(folder, settings.format, recipe, settings.seed, samples, identity, 0, samples)
            card = folder / "card.json"
            rows: dict[int, CardRow] = {}
            if missing := list(target.missing(samples)):
                card.unlink(missing_ok=True)  # it is of a smaller set
                rows = _make_units(_runner(settings, cluster, _count(missing)), whole, target, missing, console)
            if not card.exists():
                _describe(settings, cluster, whole, rows)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise InputError(
                f"the disk of {folder} is full: free some space, then run the same command; it goes on where it stopped"
            ) from None
        if isinstance(error, PermissionError):
            raise InputError(f"cannot write {error.filename or folder}: {error.strerror}") from None
        raise
    console.print(f"{folder}: {samples} samples of {recipe.views} views, see card.html")
    return folder


def _others(folder: Path) -> list[str]:
    """Files of a folder besides the settings and the lock, by name."""
    return sorted(path.name for path in folder.iterdir() if path.name not in (LOCK_FILE, "settings.json"))


def _claim(folder: Path, settings: SynthSettings) -> str:
    """Note what the set is made of or, where some of it is made, check that it is the same; returns a short hash."""
    plain: dict[str, Any] = {
        "recipe": plain_settings(settings.recipe),
        "seed": settings.seed,
        "format": settings.format,
        "version": __version__,
    }
    text = json.dumps(plain, indent=1, default=str) + "\n"
    settings_now = json.loads(text)
    path = folder / "settings.json"
    if _others(folder):
        flat = [_flat(read_settings(path, "the set")), _flat(settings_now)]
        changed = sorted(key for key in {*flat[0], *flat[1]} if flat[0].get(key) != flat[1].get(key))
        if changed:
            raise InputError(f"{folder} was made with other settings ({', '.join(changed)}): choose another --out")
    else:
        write_file(path, text)
    return hashlib.sha256(json.dumps(settings_now, sort_keys=True).encode()).hexdigest()[:16]


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """The recipe's settings beside the others."""
    recipe = settings.get("recipe")
    recipe = recipe if isinstance(recipe, dict) else {}
    return {**{key: value for key, value in settings.items() if key != "recipe"}, **recipe}


def _count(stretches: Sequence[tuple[int, int]]) -> int:
    return sum(stop - start for start, stop in stretches)


def _runner(settings: SynthSettings, cluster: RayCluster | None, samples: int) -> _Runner:
    if cluster is not None:
        return lambda units: cluster.ordered(make_unit, units)
    workers = settings.workers
    if workers is None:
        workers = min(usable_cores(), samples // _WORTH_A_WORKER)
        workers = workers if workers > 1 else 0
    return lambda units: ordered(make_unit, units, workers)


def _make_units(
    run: _Runner, whole: Unit, target: Folder, missing: Sequence[tuple[int, int]], console: Console
) -> dict[int, CardRow]:
    """Make what the folder lacks; returns the rows of the card that it gave, by index."""
    left = _count(missing)
    rows: dict[int, CardRow] = {}
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    ) as progress:
        task = progress.add_task(
            f"{whole.folder.parent.name}/{whole.folder.name}", total=whole.samples, completed=whole.samples - left
        )
        units = (dataclasses.replace(whole, start=start, stop=stop) for start, stop in missing)
        with contextlib.closing(target), contextlib.closing(run(units)) as all_made:
            for made in all_made:
                target.commit(made)
                rows.update((row.index, row) for row in made.rows)
                progress.advance(task, len(made.unit.indices))
    return rows


def _describe(settings: SynthSettings, cluster: RayCluster | None, whole: Unit, rows: dict[int, CardRow]) -> None:
    """Write the card; samples that an earlier run made are drawn once more."""
    stride = card_stride(whole.samples)
    units = list(describing_units(whole, list(rows), stride))
    with contextlib.closing(_runner(settings, cluster, len(units) * 16)(units)) as all_made:
        for made in all_made:
            rows.update((row.index, row) for row in made.rows)
    facts = {
        **read_settings(whole.folder / "settings.json", "the set"),
        "settings": whole.identity,
        "samples": whole.samples,
        "views": whole.samples * whole.recipe.views,
    }
    title = f"{whole.folder.parent.name}/{whole.folder.name}"
    write_card(whole.folder, title, facts, [rows[index] for index in sorted(rows)])


class _Rate(ProgressColumn):
    """Samples a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f}/s" if task.speed else "", style="progress.data.speed")
