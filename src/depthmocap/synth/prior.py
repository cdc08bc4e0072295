"""``depthmocap train prior``: a Gaussian mixture over postures, learnt from motion capture (extra: train)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from sklearn.mixture import GaussianMixture

from depthmocap.body.posture import mirror_posture
from depthmocap.synth.mocap import Clip, without_heading
from depthmocap.synth.postures import load_clips, thin


@dataclasses.dataclass(frozen=True)
class PriorTraining:
    """Learn a posture prior from motion capture clips.

    Attributes:
        postures: folder of BVH clips; only those of the training split are learnt from.
        out: the .npz file to write.
        components: Gaussians of the mixture.
        rank: widest directions of each Gaussian's covariance that are kept.
    """

    postures: Path
    out: Path
    components: int = 48
    rank: int = 24
    seed: int = 0


def train_prior(settings: PriorTraining) -> Path:
    """Fit the prior on the training clips and their mirror images; returns its path (about 120 kB).

    Raises:
        InputError: when there are no readable clips.
    """
    fit_prior(load_clips(settings.postures), settings)
    return settings.out


def fit_prior(clips: Sequence[Clip], settings: PriorTraining) -> None:
    """Fit and save the prior of some clips."""
    train = [clip for clip in clips if clip.split == "train" and len(clip.postures)]
    kept = [thin(clip.postures, 0.07) for clip in train]
    postures = np.concatenate([without_heading(c.postures)[k] for c, k in zip(train, kept, strict=True)])
    simple = np.concatenate([np.full(len(k), c.simple) for c, k in zip(train, kept, strict=True)])
    data = np.concatenate([postures, mirror_posture(postures)]).reshape(-1, postures.shape[1] * 3)
    mixture = GaussianMixture(
        settings.components, covariance_type="full", reg_covar=1e-3, random_state=settings.seed, max_iter=60
    )
    mixture.fit(data)
    simple_weights = mixture.predict_proba(data[np.concatenate([simple, simple])]).mean(0)
    values, vectors = np.linalg.eigh(mixture.covariances_)
    factors = vectors[:, :, -settings.rank :] * np.sqrt(np.maximum(values[:, None, -settings.rank :], 0))
    np.savez_compressed(
        settings.out, weights=mixture.weights_.astype(np.float16), simple_weights=simple_weights.astype(np.float16),
        means=mixture.means_.astype(np.float16), factors=factors.astype(np.float16),
    )  # fmt: skip
