"""The curve of expected errors of joints by their confidence (``depthmocap.frames``), fitted on validation clips.

    python benchmarks/make_error_curve.py POSTURES --samples 300

POSTURES is a folder of clips or a pool. Draws so many people of every set of ``evaluate bench`` but those with clothes
and a sensor that training never shows, estimates joints from three cameras and from one, and prints the rows of the
curve: the mean error at each confidence, linear between them, never growing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro
from numpy import ndarray

from depthmocap.classify.classifier import Classifier
from depthmocap.core.cores import usable_cores
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import load_estimator
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.synth.sample import BENCH, Sample
from depthmocap.synth.writing.stream import stream

#: Confidences of the rows: closer to each other near 1, where most joints are.
KNOTS = np.array([0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.998, 0.999, 0.9995, 1.0])
_NEVER_TRAINED = ("new clothes", "new sensor")


def fit_curve(confidence: ndarray, error_m: ndarray) -> ndarray:
    """Errors (metres) at ``KNOTS``: the line through them has the least squares to the errors of joints, (n,) each.
    Where it would grow with the confidence it is level."""
    place = np.clip(np.searchsorted(KNOTS, confidence, side="right") - 1, 0, len(KNOTS) - 2)
    along = (confidence - KNOTS[place]) / np.diff(KNOTS)[place]
    design = np.zeros((len(confidence), len(KNOTS)))
    rows = np.arange(len(confidence))
    design[rows, place], design[rows, place + 1] = 1 - along, along
    heights = np.linalg.lstsq(design, error_m, rcond=None)[0]
    return np.minimum.accumulate(heights)


def errors(postures: Path, samples: int, seed: int) -> Iterator[tuple[ndarray, ndarray]]:
    """Confidences and errors (metres) of the joints of each cloud."""
    classifier, estimator = Classifier(), load_estimator()
    for name, recipe in BENCH.items():
        if name in _NEVER_TRAINED:
            continue
        recipe = dataclasses.replace(recipe, split="valid", postures=postures, views=3)
        for _, sample in stream(recipe, seed, 0, samples, usable_cores()):
            views = _labelled(classifier, sample)
            for some in (views, views[:1]):
                joints, confidence = estimator(merge_views(some), "z")
                yield confidence, np.linalg.norm(joints - sample.joints, axis=1)


def _labelled(classifier: Classifier, sample: Sample) -> list[LabelledView]:
    masks = [view.depth_m > 0 if view.mask is None else view.mask for view in sample.views]
    results = classifier.label_masks(list(sample.views), masks)
    return [LabelledView(view, *result.prediction) for view, result in zip(sample.views, results, strict=True)]


def main(postures: tyro.conf.Positional[Path], samples: int = 300, seed: int = 1) -> None:
    """Print the rows of the curve.

    Args:
        postures: a folder of clips or a pool.
        samples: people a set.
    """
    confidence, error = (np.concatenate(part) for part in zip(*errors(postures, samples, seed), strict=True))
    known = np.isfinite(error)
    for knot, height in zip(KNOTS, fit_curve(confidence[known], error[known]), strict=True):
        print(f"({knot:g}, {height:.4f}),")


if __name__ == "__main__":
    tyro.cli(main)
