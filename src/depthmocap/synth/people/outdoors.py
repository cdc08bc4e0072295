"""What people wear outdoors, over what they wear indoors: padded jackets, hoods, hats, scarves; robes and shawls."""

from __future__ import annotations

import dataclasses

import numpy as np

from depthmocap.synth.people.wardrobe import (
    OUTDOOR_FAMILIES,
    Clothes,
    Garment,
    Hair,
    Hat,
    HatStyle,
    Hood,
    Scarf,
    random_garment,
)

#: Share of people in an outdoor jacket, and how many of them in one of each family.
JACKET_SHARE = 0.35
_FAMILY_SHARES = {"puffer": 0.4, "parka": 0.2, "anorak": 0.22, "fleece": 0.18}
#: Share of each family, and of hoodies that nothing is worn over, with a hood of its own shape; of those the share up.
_HOODED = {"puffer": 0.6, "parka": 0.85, "anorak": 0.85, "fleece": 0.3, "hoodie": 0.8, "jacket": 0.15}
HOOD_UP_SHARE = 0.4
#: Share of those without an outdoor jacket in a gown to the ground, in a skirt to the ground and a shawl over one
#: shoulder, and with a shawl over what they wear.
_ROBED = 0.05, 0.03, 0.03
_HEAD_COVERED = 0.4  # of those in a gown
#: Share of trousers that are wide, of long hair that lies before the shoulders, of people with a scarf, and with a hat.
_WIDE, _FORWARD, SCARF_SHARE, HAT_SHARE = 0.12, 0.5, 0.1, 0.14
_HATS: dict[HatStyle, float] = {"beanie": 0.45, "cap": 0.27, "brim": 0.14, "helmet": 0.14}
#: Share of puffers without seams across.
_UNQUILTED = 0.25


def for_outdoors(clothes: Clothes, rng: np.random.Generator, jackets: float = JACKET_SHARE) -> Clothes:
    """The same clothes with what else people wear, each for some of them: an outdoor jacket over all, or a gown or a
    shawl; a hood that lies round the neck or is pulled up; a scarf, a hat, wide trousers.

    Args:
        jackets: share of people who get an outdoor jacket.
    """
    garments = [_wide(garment, rng) for garment in clothes.garments]
    if rng.random() < jackets:
        garments = [garment for garment in garments if garment.family != "jacket"]
        garments.append(_outdoor_jacket(rng, garments))
    else:
        garments = _robed(rng, garments)
    hair, hat, scarf, hood = clothes.hair, Hat(), None, _random_hood(rng, garments)
    if hood != "none":
        garments[-1] = dataclasses.replace(garments[-1], hood=hood, hood_m=float(rng.uniform(0.018, 0.05)))
    if rng.random() < SCARF_SHARE:
        ends = rng.uniform(0.2, 0.65, 2) * (rng.random(2) < 0.5)
        scarf = Scarf(float(rng.uniform(0.02, 0.045)), (float(ends[0]), float(ends[1])))
    if hair.style == "long" and rng.random() < _FORWARD:
        hair = dataclasses.replace(hair, forward=float(rng.uniform(0.4, 1.0)))
    if hood == "up":
        hair = _under_hood(hair, rng)
    elif rng.random() < HAT_SHARE:
        hat = _random_hat(rng)
        hair = dataclasses.replace(hair, volume_m=min(hair.volume_m, float(rng.uniform(0.004, 0.02))))
    return Clothes(tuple(garments), hair, clothes.shoes, hat, scarf)


def _wide(garment: Garment, rng: np.random.Generator) -> Garment:
    """Trousers, some of them wide."""
    if garment.family != "trousers" or garment.slack_m == 0 or rng.random() >= _WIDE:
        return garment
    return dataclasses.replace(garment, slack_m=float(rng.uniform(0.05, 0.1)), sag=1.0, cuff=0.0)


def _robed(rng: np.random.Generator, garments: list[Garment]) -> list[Garment]:
    """A gown, a long skirt and a shawl, a shawl over the rest, or nothing else."""
    gown, wound, shawl = _ROBED
    kind = rng.random()
    if kind < gown:
        return [random_garment(rng, "gown")]
    if kind < gown + wound:
        skirt = dataclasses.replace(random_garment(rng, "skirt"), skirt_m=float(rng.uniform(0.75, 0.95)))
        return [skirt, random_garment(rng, "t-shirt"), random_garment(rng, "shawl")]
    if kind < gown + wound + shawl:
        return [*garments, random_garment(rng, "shawl")]
    return garments


def _random_hood(rng: np.random.Generator, garments: list[Garment]) -> Hood:
    if not garments:
        return "none"
    family = garments[-1].family
    if family == "gown":
        return "up" if rng.random() < _HEAD_COVERED else "none"
    if rng.random() >= _HOODED.get(family, 0.0):
        return "none"
    return "up" if rng.random() < HOOD_UP_SHARE else "down"


def _random_hat(rng: np.random.Generator) -> Hat:
    styles = tuple(_HATS)
    style = styles[rng.choice(len(styles), p=list(_HATS.values()))]
    thick = rng.uniform(0.02, 0.045) if style == "helmet" else rng.uniform(0.003, 0.015)
    brim = {"cap": (0.05, 0.08), "brim": (0.04, 0.12)}.get(style, (0.0, 0.0))
    return Hat(style, float(thick), float(rng.uniform(*brim)))


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
