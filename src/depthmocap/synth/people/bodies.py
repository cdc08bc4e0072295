"""Who is in the picture: one character, sixteen, or bodies of all builds; and what they wear."""

from __future__ import annotations

import functools
from typing import Literal

import numpy as np

from depthmocap.synth.body.hands import random_grip, with_hands
from depthmocap.synth.body.mesh import BodyModel, Phenotype
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.outdoors import JACKET_SHARE, for_outdoors
from depthmocap.synth.people.wardrobe import ORDINARY_CLOTHES, random_clothes

#: What people of ``open`` wear: what is worn indoors; that, and what is worn outdoors, robes and shawls; or all an
#: outdoor jacket.
Wardrobe = Literal["indoors", "any", "outdoors"]

#: The one character of easy and inter, and the first of the sixteen of hard.
ONE_CHARACTER = Phenotype(gender=0.0, age=0.65, muscle=0.55, weight=0.5, height=0.5)


@functools.cache
def sixteen_characters() -> tuple[Phenotype, ...]:
    """The fixed characters of the hard set: men and women, young and old, slight and heavy."""
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
    """One of the sixteen, who always wears the same; the first is dressed in ``ORDINARY_CLOTHES``."""
    phenotype = sixteen_characters()[index]
    rng = np.random.default_rng([16, index])
    ordinary = index == 0 and not held_out
    clothes = ORDINARY_CLOTHES if ordinary else random_clothes(rng, held_out, phenotype.gender)
    return clothe(BodyModel.load().shape(phenotype), clothes, rng)


def random_dressed(
    rng: np.random.Generator,
    subset: Literal["easy", "inter", "hard", "open"],
    held_out: bool = False,
    wardrobe: Wardrobe = "indoors",
) -> DressedBody:
    """A dressed body of a subset: easy and inter have one character, hard sixteen (kept once made), open any.
    Hands are open in the first three, and do anything in the last.

    Args:
        held_out: always in the family of garments that is kept out of training; otherwise never.
        wardrobe: of whom is in open and not in that family; a seed's bodies are the same whatever they wear.
    """
    if subset in ("easy", "inter"):
        return _character(0, held_out)
    if subset == "hard":
        return _character(int(rng.integers(len(sixteen_characters()))), held_out)
    # Of generators of their own, so that a seed's people are the same whatever their hands do and is worn outdoors.
    (hands_rng,) = rng.spawn(1)
    (outdoors_rng,) = hands_rng.spawn(1)
    phenotype = random_phenotype(rng)
    body = with_hands(BodyModel.load().shape(phenotype), random_grip(hands_rng), random_grip(hands_rng))
    clothes = random_clothes(rng, held_out, phenotype.gender)
    if wardrobe != "indoors" and not held_out:
        clothes = for_outdoors(clothes, outdoors_rng, JACKET_SHARE if wardrobe == "any" else 1.0)
    return clothe(body, clothes, rng)
