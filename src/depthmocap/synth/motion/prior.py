"""``depthmocap train prior``: a Gaussian mixture over postures, learnt from motion capture (extra: train)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from sklearn.mixture import GaussianMixture

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import atomic_write
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import mirror_posture
from depthmocap.synth.motion.mocap import Clip, without_heading
from depthmocap.synth.motion.postures import load_clips, thin_frames


@dataclasses.dataclass(frozen=True)
class PriorTraining:
    """Learn a posture prior from motion capture clips.

    Attributes:
        postures: folder of BVH and ASF/AMC clips; only those of the training split are learnt from.
        out: the .npz file to write.
        components: Gaussians of the mixture.
        rank: widest directions of each Gaussian's covariance that are kept.
        seed: of the fit's start.
    """

    postures: Path
    out: Path
    components: int = 48
    rank: int = 24
    seed: int = 0

    def __post_init__(self) -> None:
        if self.out.suffix != ".npz":
            raise InputError(f"--out must end in .npz, got {self.out}")
        if self.components < 1 or self.rank < 1:
            raise InputError(f"--components and --rank must be at least 1, got {self.components} and {self.rank}")
        check_seed(self.seed)


@locks_outputs(files=("out",))
def train_prior(settings: PriorTraining) -> Path:
    """Fit the prior on the training clips and their mirror images; returns its path (about 120 kB).

    Raises:
        InputError: when there are no readable clips.
    """
    fit_prior(load_clips(settings.postures), settings)
    Terminal().print(f"wrote {settings.out}")
    return settings.out


def fit_prior(clips: Sequence[Clip], settings: PriorTraining) -> None:
    """Fit and save the prior of some clips.

    Raises:
        InputError: when no training clip is among them, or too few postures.
    """
    train = [clip for clip in clips if clip.split == "train" and len(clip.postures)]
    if not train:
        raise InputError(f"{settings.postures}: no clip falls in the train split; give more clips")
    frames = [thin_frames(clip.postures, 0.07) for clip in train]
    postures = np.concatenate([without_heading(c.postures)[k] for c, k in zip(train, frames, strict=True)])
    simple = np.concatenate([np.full(len(k), c.simple) for c, k in zip(train, frames, strict=True)])
    data = np.concatenate([postures, mirror_posture(postures)]).reshape(-1, postures.shape[1] * 3)
    if len(data) < settings.components:
        raise InputError(
            f"{settings.postures}: {len(data)} distinct postures are fewer than --components {settings.components}"
        )
    mixture = GaussianMixture(
        settings.components, covariance_type="full", reg_covar=1e-3, random_state=settings.seed, max_iter=60
    )
    mixture.fit(data)
    # Without a manifest no clip is marked as walking; then easy postures use all components.
    walking = data[np.concatenate([simple, simple])]
    simple_weights = mixture.predict_proba(walking).mean(0) if len(walking) else np.asarray(mixture.weights_)
    values, vectors = np.linalg.eigh(np.asarray(mixture.covariances_))
    factors = vectors[:, :, -settings.rank :] * np.sqrt(np.maximum(values[:, None, -settings.rank :], 0))
    arrays = {
        "weights": np.asarray(mixture.weights_),
        "simple_weights": simple_weights,
        "means": np.asarray(mixture.means_),
        "factors": factors,
    }
    with atomic_write(settings.out) as unfinished:
        np.savez_compressed(unfinished, **{name: array.astype(np.float16) for name, array in arrays.items()})
