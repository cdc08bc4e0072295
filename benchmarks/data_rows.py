"""Rows of data sets on disk: making a frame of UBC3V's layout, and writing it beside Pillow."""

from __future__ import annotations

import io
import itertools

import numpy as np
from PIL import Image
from timing import Bench, Reference

from depthmocap.body.regions import UNLABELLED
from depthmocap.datasets.ubc3v import encode_depth, encode_labels, image_paths
from depthmocap.datasets.ubc3v_write import write_images
from depthmocap.synth.output.stream import draw
from depthmocap.synth.output.units import Unit, make_unit
from depthmocap.synth.sample import Recipe

_SAMPLES = 6
_VIEWS = 3
#: 150 frames a second on two cores.
_GOAL_MS = 2e3 / 150


def rows(bench: Bench) -> None:
    """Making and storing a frame on one core; and storing alone, beside general code for the same pictures."""
    recipe = Recipe(subset="hard", views=_VIEWS)
    first = itertools.count(0, _SAMPLES)

    def make() -> None:
        start = next(first)
        make_unit(Unit(bench.folder / "made", "ubc3v", recipe, 0, 10**6, "", start, start + _SAMPLES))

    bench.measure(
        "making and writing a UBC3V frame, one core", make, items=_SAMPLES * _VIEWS, goal_ms=_GOAL_MS,
        note="hard, three views, two PNGs a frame; goal: 150 a second on two cores",
    )  # fmt: skip

    views = [view for index in range(_SAMPLES) for view in draw(recipe, 0, index).views]

    def write_pillow() -> None:
        for view in views:
            assert view.mask is not None
            assert view.labels is not None
            labels = np.where(view.mask, np.where(view.labels == 0, np.uint8(UNLABELLED), view.labels), np.uint8(0))
            for path, rgba in (
                ("depth.png", encode_depth(view.depth_m, view.mask)),
                ("labels.png", encode_labels(labels)),
            ):
                data = io.BytesIO()
                Image.fromarray(rgba).save(data, "PNG", compress_level=3)
                (bench.folder / path).write_bytes(data.getvalue())

    def write_ours() -> None:
        for view in views:
            write_images(bench.folder / "written", 0, [view])

    write_ours()
    last = views[-1]
    assert last.mask is not None
    with Image.open(image_paths(bench.folder / "written", last.camera.name, 0)[0]) as image:
        same = bool((np.array(image) == encode_depth(last.depth_m, last.mask)).all())
    bench.measure(
        "writing a UBC3V frame", write_ours, Reference("Pillow, level 3", write_pillow, len(views)),
        items=len(views), agrees=same, note="depth and labels, RGBA 512×424",
    )  # fmt: skip
