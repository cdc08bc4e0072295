"""Samples on the fly: the same from any number of processes."""

from __future__ import annotations

import itertools

import pytest

from depthmocap import InputError
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.sample import Recipe, Sample
from depthmocap.synth.writing.stream import stream

RECIPE = Recipe(subset="easy", split="valid", views=2)


def alike(a: Sample, b: Sample) -> bool:
    return (
        bool((a.joints == b.joints).all())
        and a.group == b.group
        and all(
            (x.depth_m == y.depth_m).all()
            and x.labels is not None
            and y.labels is not None
            and (x.labels == y.labels).all()
            and (x.camera.world_from_camera == y.camera.world_from_camera).all()
            for x, y in zip(a.views, b.views, strict=True)
        )
    )


@pytest.mark.slow
def test_the_same_from_any_number_of_workers(body_model: BodyModel) -> None:
    here = list(stream(RECIPE, 3, 4, 9))
    assert [index for index, _ in here] == [4, 5, 6, 7, 8]
    there = list(stream(RECIPE, 3, 4, 9, workers=2, chunk=2))
    assert [index for index, _ in there] == [4, 5, 6, 7, 8]
    assert all(alike(a, b) for (_, a), (_, b) in zip(here, there, strict=True))
    ((_, other),) = stream(RECIPE, 4, 4, 5)
    assert not alike(here[0][1], other)
    assert [index for index, _ in itertools.islice(stream(RECIPE, 3), 2)] == [0, 1]  # without end


def test_settings_that_cannot_be() -> None:
    with pytest.raises(InputError, match="workers must be at least 0"):
        next(stream(RECIPE, workers=-1))
    with pytest.raises(InputError, match="chunk at least 1"):
        next(stream(RECIPE, chunk=0))
    assert not list(stream(RECIPE, start=2, stop=2))
