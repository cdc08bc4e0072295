"""People who are cut off: what of them stays in sight."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest

from depthmocap.body.regions import REGION
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.cut import CUTS, Cut, cut_plane, random_cut
from depthmocap.synth.render import PosedPerson, render_person
from depthmocap.synth.sample import BENCH, Sampler

#: Of somebody upright, regions that a cut leaves in sight, and regions of which it leaves nothing.
KEPT: dict[Cut, tuple[str, str]] = {
    "knees": ("belly", "forefoot"), "thighs": ("chest", "shin"), "hips": ("upper back", "knee"),
    "chest": ("face", "thigh"), "waist": ("shin", "face"), "head": ("thigh", "forehead"),
}  # fmt: skip


def regions(name: str) -> list[int]:
    return [number for region, number in REGION.items() if region.startswith(name)]


@pytest.mark.parametrize("cut", KEPT)
def test_cuts_across_the_body(default_body: Body, cut: Cut) -> None:
    person = PosedPerson(default_body.pose(REST_POSTURE))
    kept, hidden = (regions(name) for name in KEPT[cut])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        azimuth = rng.uniform(-np.pi, np.pi)
        eye = np.array([2.6 * np.sin(azimuth), -2.6 * np.cos(azimuth), 1.2])
        camera = DepthCamera("c", 96, 96, 80.0, 80.0, 47.5, 47.5, look_at(eye, np.array([0.0, 0.0, 0.9])))
        rendering = render_person(person, camera)
        keeps = cut_plane(rng, cut, person.joints, camera).keeps(rendering.depth_m, camera)
        for names, stays in ((kept, True), (hidden, False)):
            shown = np.isin(rendering.labels, names)
            # From one side a region may not be seen at all.
            assert not shown.any() or (keeps[shown].mean() > 0.6 if stays else keeps[shown].mean() < 0.1)


@pytest.mark.parametrize("cut", ["side", "edge"])
def test_cuts_to_one_side_leave_a_part(default_body: Body, cut: Cut) -> None:
    person = PosedPerson(default_body.pose(REST_POSTURE))
    camera = DepthCamera("c", 96, 96, 80.0, 80.0, 47.5, 47.5, look_at(np.array([1.0, -2.4, 1.0]), np.zeros(3)))
    rendering = render_person(person, camera)
    shares = []
    for seed in range(20):
        keeps = cut_plane(np.random.default_rng(seed), cut, person.joints, camera).keeps(rendering.depth_m, camera)
        shares.append(keeps[rendering.person].mean())
        if cut == "edge":  # a straight line along the picture's own rows or columns
            assert len(np.unique(keeps[rendering.depth_m > 0])) == 2
            assert (keeps == keeps[:1])[:, rendering.depth_m.any(0)].mean() > 0.5 or (keeps == keeps[:, :1])[
                rendering.depth_m.any(1)
            ].mean() > 0.5
    assert min(shares) > 0.15 and max(shares) < 0.99 and np.ptp(shares) > 0.3


def test_training_shows_every_cut() -> None:
    rng = np.random.default_rng(0)
    drawn = Counter(random_cut(rng) for _ in range(600))
    assert set(drawn) == set(CUTS) and min(drawn.values()) > 20


def test_a_share_is_cut_off() -> None:
    recipe = dataclasses.replace(BENCH["seen"], views=1, noise="none")
    some = Sampler(dataclasses.replace(recipe, cut="any", cut_share=0.5), 3)
    cut = 0
    for index in range(12):
        (whole,), (part,) = Sampler(recipe, 3)(index).views, some(index).views
        assert whole.mask is not None and part.mask is not None
        assert not (part.mask & ~whole.mask).any()
        cut += part.mask.sum() < whole.mask.sum()
    assert 2 <= cut <= 10


def test_what_is_cut_off_is_gone_from_every_view() -> None:
    whole, cut = (Sampler(dataclasses.replace(BENCH[name], noise="none"), 3)(1) for name in ("seen", "cut hips"))
    np.testing.assert_allclose(whole.joints, cut.joints)
    for before, after in zip(whole.views, cut.views, strict=True):
        assert before.mask is not None and after.mask is not None and after.labels is not None
        assert not (after.mask & ~before.mask).any()
        gone = before.mask & ~after.mask
        assert 0.2 < gone.sum() / before.mask.sum() < 0.95
        assert not after.depth_m[gone].any() and not after.labels[gone].any()
