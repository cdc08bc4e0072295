"""Random people of a data set: one character, sixteen, or bodies of all builds, with their clothes."""

from __future__ import annotations

import functools
from typing import Literal

import numpy as np

from depthmocap.synth.body.hands import random_grip, with_hands
from depthmocap.synth.body.mesh import BodyModel, Phenotype
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.outdoors import JACKET_SHARE, add_outdoor_clothes
from depthmocap.synth.people.wardrobe import ORDINARY_CLOTHES, random_clothes

#: Clothes of people of ``open``: indoor ones; indoor and outdoor ones, robes and shawls; or an outdoor jacket for all.
Wardrobe = Literal["indoors", "any", "outdoors"]

#: The one character of easy and inter, and the first of the sixteen of hard.
ONE_CHARACTER = Phenotype(gender=0.0, age=0.65, muscle=0.55, weight=0.5, height=0.5)


@functools.cache
def sixteen_characters() -> tuple[Phenotype, ...]:
    """The fixed characters of the hard set: men and women of all ages and builds."""
    rng = np.random.default_rng(16)
    others = [random_phenotype(rng, children=False) for _ in range(15)]
    return (ONE_CHARACTER, *others)


def random_phenotype(rng: np.random.Generator, children: bool = True) -> Phenotype:
    """A body of any build; one in six is a child."""
    child = children and rng.random() < 1 / 6
    return Phenotype(
        gender=float(rng.uniform(0, 1)),
        age=float(rng.uniform(0.22, 0.5) if child else rng.uniform(0.5, 1.0)),
        muscle=float(rng.beta(2, 2)),
        weight=float(rng.beta(1.6, 1.6)),
        height=float(rng.beta(2, 2)),
        proportions=float(rng.beta(2, 2)),
    )


@functools.cache
def _character(index: int, held_out: bool) -> DressedBody:
    """One of the sixteen, always in the same clothes; the first wears ``ORDINARY_CLOTHES``."""
    phenotype = sixteen_characters()[index]
    rng = np.random.default_rng([16, index])
    ordinary = index == 0 and not held_out
    clothes = ORDINARY_CLOTHES if ordinary else random_clothes(rng, held_out, phenotype.gender)
    return clothe(BodyModel.load().shape(phenotype), clothes, rng)


def random_dressed_body(
    rng: np.random.Generator,
    subset: Literal["easy", "inter", "hard", "open"],
    held_out: bool = False,
    wardrobe: Wardrobe = "indoors",
) -> DressedBody:
    """A dressed body of a subset: easy and inter have one character, hard has sixteen (cached), open has any body.
    Hands are random in open and flat in the other subsets.

    Args:
        held_out: the body always wears the family of garments that is kept out of training; otherwise never.
        wardrobe: clothes of people of open without held-out garments. It does not change the bodies of a seed.
    """
    if subset in ("easy", "inter"):
        return _character(0, held_out)
    if subset == "hard":
        return _character(int(rng.integers(len(sixteen_characters()))), held_out)
    # Hands and outdoor clothes have their own generators, so that they do not change the rest of a seed's people.
    (hands_rng,) = rng.spawn(1)
    (outdoors_rng,) = hands_rng.spawn(1)
    phenotype = random_phenotype(rng)
    body = with_hands(BodyModel.load().shape(phenotype), random_grip(hands_rng), random_grip(hands_rng))
    clothes = random_clothes(rng, held_out, phenotype.gender)
    if wardrobe != "indoors" and not held_out:
        clothes = add_outdoor_clothes(clothes, outdoors_rng, JACKET_SHARE if wardrobe == "any" else 1.0)
    return clothe(body, clothes, rng)
