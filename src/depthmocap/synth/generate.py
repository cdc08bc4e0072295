"""``depthmocap synth``: the paper's data sets in UBC3V's layout, as many samples as wanted."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.progress import Progress

from depthmocap.errors import InputError
from depthmocap.settings import plain_settings


@dataclasses.dataclass(frozen=True)
class SynthSettings:
    """Random bodies in random postures seen by random cameras (Algorithm 1 of the paper).

    Attributes:
        out: the root that will hold <subset>-pose/<split>/<section>.
        subset: easy (one character, walking and running), inter (one character, all postures) or hard (sixteen).
        split: postures of the splits come from different motion clips.
        samples: postures; each gives one picture per view. Run again with more to go on where it stopped.
        views: cameras around each posture.
        seed: the same seed gives the same data.
        postures: folder of BVH clips; without it postures come from the packaged prior.
        noise: sensor noise on the depth; UBC3V itself has none.
    """

    out: Path
    subset: Literal["easy", "inter", "hard"] = "hard"
    split: Literal["train", "valid", "test"] = "train"
    samples: int = 1000
    views: int = 3
    seed: int = 0
    postures: Path | None = None
    noise: bool = False


def generate(settings: SynthSettings, console: Console | None = None) -> Path:
    """Write the samples and return the split's folder. An interrupted run goes on with the same command.

    Every sample depends on its own index and the seed alone.

    Raises:
        InputError: settings that cannot be, or an unwritable folder.
    """
    from depthmocap.datasets.ubc3v import FRAMES_PER_SECTION
    from depthmocap.datasets.ubc3v_write import SectionWriter
    from depthmocap.synth.postures import Variation, posture_source
    from depthmocap.synth.sample import draw_sample
    from depthmocap.synth.sensor import SensorNoise

    if settings.samples < 1 or settings.views < 1:
        raise InputError(f"--samples and --views must be at least 1, got {settings.samples} and {settings.views}")
    source = posture_source(settings.postures, settings.split, settings.subset == "easy", Variation(mirror=0.5))
    subset = f"{settings.subset}-pose"
    folder = settings.out / subset / settings.split
    folder.mkdir(parents=True, exist_ok=True)
    described = plain_settings(settings)
    card = folder / "settings.json"
    if card.exists():
        earlier = json.loads(card.read_text())
        changed = [k for k in described if k not in ("samples", "out") and earlier.get(k) != described[k]]
        if changed:
            raise InputError(f"{folder} was made with other settings ({', '.join(changed)}): choose another --out")
    card.write_text(json.dumps(described, indent=1) + "\n")
    split_seed = ("train", "valid", "test").index(settings.split)
    with Progress(console=console or Console(stderr=True)) as progress:
        task = progress.add_task(f"{subset}/{settings.split}", total=settings.samples)
        for first in range(0, settings.samples, FRAMES_PER_SECTION):
            last = min(first + FRAMES_PER_SECTION, settings.samples)
            with SectionWriter(settings.out, subset, settings.split, first // FRAMES_PER_SECTION + 1) as writer:
                progress.update(task, completed=first + len(writer))
                for index in range(first + len(writer), last):
                    rng = np.random.default_rng([settings.seed, split_seed, index])
                    noise = SensorNoise() if settings.noise else None
                    sample = draw_sample(rng, settings.subset, source, settings.views, noise=noise)
                    writer.write(sample.views, sample.joints)
                    progress.advance(task)
    return folder
