"""What people wear outdoors, over what they wear indoors: padded jackets, hoods up and down."""

from __future__ import annotations

import dataclasses

import numpy as np

from depthmocap.synth.people.wardrobe import OUTDOOR_FAMILIES, Clothes, Garment, Hair, Hood, random_garment

#: Share of people in an outdoor jacket, and how many of them in one of each family.
JACKET_SHARE = 0.35
_FAMILY_SHARES = {"puffer": 0.4, "parka": 0.2, "anorak": 0.22, "fleece": 0.18}
#: Share of each family, and of hoodies that nothing is worn over, with a hood of its own shape; of those the share up.
_HOODED = {"puffer": 0.6, "parka": 0.85, "anorak": 0.85, "fleece": 0.3, "hoodie": 0.8, "jacket": 0.15}
HOOD_UP_SHARE = 0.4
#: Share of puffers without seams across.
_UNQUILTED = 0.25


def for_outdoors(clothes: Clothes, rng: np.random.Generator, jackets: float = JACKET_SHARE) -> Clothes:
    """The same clothes with what is worn outdoors, for some people: an outdoor jacket over all, and a hood that lies
    round the neck or is pulled up.

    Args:
        jackets: share of people who get an outdoor jacket.
    """
    garments = list(clothes.garments)
    if rng.random() < jackets:
        garments = [garment for garment in garments if garment.family != "jacket"]
        garments.append(_outdoor_jacket(rng, garments))
    hood: Hood = "none"
    if garments and rng.random() < _HOODED.get(garments[-1].family, 0.0):
        hood = "up" if rng.random() < HOOD_UP_SHARE else "down"
        size = float(rng.uniform(0.018, 0.05))
        garments[-1] = dataclasses.replace(garments[-1], hood=hood, hood_m=size)
    return Clothes(tuple(garments), _under_hood(clothes.hair, rng) if hood == "up" else clothes.hair, clothes.shoes)


def _outdoor_jacket(rng: np.random.Generator, under: list[Garment]) -> Garment:
    family = str(rng.choice(OUTDOOR_FAMILIES, p=[_FAMILY_SHARES[name] for name in OUTDOOR_FAMILIES]))
    jacket = random_garment(rng, family)
    # Its hem must go over a skirt.
    jacket = dataclasses.replace(jacket, flare=max([0.0, *(inner.flare for inner in under)]))
    if jacket.quilt_m and rng.random() < _UNQUILTED:
        jacket = dataclasses.replace(jacket, quilt_m=0.0)
    return jacket


def _under_hood(hair: Hair, rng: np.random.Generator) -> Hair:
    """Hair that a hood presses on; what is long is inside."""
    if hair.style == "bald":
        return hair
    return dataclasses.replace(hair, style="short", volume_m=min(hair.volume_m, float(rng.uniform(0.005, 0.02))))
