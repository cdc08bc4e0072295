"""Outdoor clothes over indoor ones: padded jackets, hoods, hats, scarves; also robes and shawls."""

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

#: Share of people in an outdoor jacket.
JACKET_SHARE = 0.35
#: Share of each family among outdoor jackets.
_FAMILY_SHARES = {"puffer": 0.4, "parka": 0.2, "anorak": 0.22, "fleece": 0.18}
#: Share of garments with a separately modelled hood, of those of a family that are outermost.
_HOOD_SHARES = {"puffer": 0.6, "parka": 0.85, "anorak": 0.85, "fleece": 0.3, "hoodie": 0.8, "jacket": 0.15}
#: Share of these hoods that are pulled up.
HOOD_UP_SHARE = 0.4
#: Share of people in a gown to the ground, of those without an outdoor jacket.
_GOWN_SHARE = 0.05
#: The same for a skirt to the ground with a shawl over one shoulder.
_SKIRT_AND_SHAWL_SHARE = 0.03
#: The same for a shawl over the other clothes.
_SHAWL_SHARE = 0.03
#: Share of gowns that cover the head.
_GOWN_HOOD_SHARE = 0.4
#: Share of trousers that are wide.
_WIDE_SHARE = 0.12
#: Share of long hair that falls in front of the shoulders.
_FORWARD_HAIR_SHARE = 0.5
#: Share of people with a scarf.
SCARF_SHARE = 0.1
#: Share of people with a hat, of those without a hood up.
HAT_SHARE = 0.14
#: Share of each style among hats.
_HAT_SHARES: dict[HatStyle, float] = {"beanie": 0.45, "cap": 0.27, "brim": 0.14, "helmet": 0.14}
#: Share of puffers without quilting seams.
_UNQUILTED_SHARE = 0.25


def add_outdoor_clothes(clothes: Clothes, rng: np.random.Generator, jackets: float = JACKET_SHARE) -> Clothes:
    """The clothes with outdoor ones added at random: an outdoor jacket, or a gown or shawl; a hood, up or down; a
    scarf, a hat, wide trousers.

    Args:
        jackets: share of people who get an outdoor jacket.
    """
    garments = [_widen_trousers(garment, rng) for garment in clothes.garments]
    if rng.random() < jackets:
        garments = [garment for garment in garments if garment.family != "jacket"]
        garments.append(_outdoor_jacket(rng, garments))
    else:
        garments = _add_robe(rng, garments)
    hair, hat, scarf, hood = clothes.hair, Hat(), None, _random_hood(rng, garments)
    if hood != "none":
        garments[-1] = dataclasses.replace(garments[-1], hood=hood, hood_m=float(rng.uniform(0.018, 0.05)))
    if rng.random() < SCARF_SHARE:
        ends = rng.uniform(0.2, 0.65, 2) * (rng.random(2) < 0.5)
        scarf = Scarf(float(rng.uniform(0.02, 0.045)), (float(ends[0]), float(ends[1])))
    if hair.style == "long" and rng.random() < _FORWARD_HAIR_SHARE:
        hair = dataclasses.replace(hair, forward=float(rng.uniform(0.4, 1.0)))
    if hood == "up":
        hair = _press_under_hood(hair, rng)
    elif rng.random() < HAT_SHARE:
        hat = _random_hat(rng)
        hair = dataclasses.replace(hair, volume_m=min(hair.volume_m, float(rng.uniform(0.004, 0.02))))
    return Clothes(tuple(garments), hair, clothes.shoes, hat, scarf)


def _widen_trousers(garment: Garment, rng: np.random.Generator) -> Garment:
    """The garment; trousers are widened in some cases."""
    if garment.family != "trousers" or garment.slack_m == 0 or rng.random() >= _WIDE_SHARE:
        return garment
    return dataclasses.replace(garment, slack_m=float(rng.uniform(0.05, 0.1)), sag=1.0, cuff=0.0)


def _add_robe(rng: np.random.Generator, garments: list[Garment]) -> list[Garment]:
    """A gown alone, a long skirt with a shawl, a shawl over the garments, or the garments as they are."""
    draw = rng.random()
    if draw < _GOWN_SHARE:
        return [random_garment(rng, "gown")]
    if draw < _GOWN_SHARE + _SKIRT_AND_SHAWL_SHARE:
        skirt = dataclasses.replace(random_garment(rng, "skirt"), skirt_m=float(rng.uniform(0.75, 0.95)))
        return [skirt, random_garment(rng, "t-shirt"), random_garment(rng, "shawl")]
    if draw < _GOWN_SHARE + _SKIRT_AND_SHAWL_SHARE + _SHAWL_SHARE:
        return [*garments, random_garment(rng, "shawl")]
    return garments


def _random_hood(rng: np.random.Generator, garments: list[Garment]) -> Hood:
    if not garments:
        return "none"
    family = garments[-1].family
    if family == "gown":
        return "up" if rng.random() < _GOWN_HOOD_SHARE else "none"
    if rng.random() >= _HOOD_SHARES.get(family, 0.0):
        return "none"
    return "up" if rng.random() < HOOD_UP_SHARE else "down"


def _random_hat(rng: np.random.Generator) -> Hat:
    styles = tuple(_HAT_SHARES)
    style = styles[rng.choice(len(styles), p=list(_HAT_SHARES.values()))]
    thick = rng.uniform(0.02, 0.045) if style == "helmet" else rng.uniform(0.003, 0.015)
    brim = {"cap": (0.05, 0.08), "brim": (0.04, 0.12)}.get(style, (0.0, 0.0))
    return Hat(style, float(thick), float(rng.uniform(*brim)))


def _outdoor_jacket(rng: np.random.Generator, inner_garments: list[Garment]) -> Garment:
    family = str(rng.choice(OUTDOOR_FAMILIES, p=[_FAMILY_SHARES[name] for name in OUTDOOR_FAMILIES]))
    jacket = random_garment(rng, family)
    # The hem must lie over a skirt.
    jacket = dataclasses.replace(jacket, flare=max([0.0, *(inner.flare for inner in inner_garments)]))
    if jacket.quilt_m and rng.random() < _UNQUILTED_SHARE:
        jacket = dataclasses.replace(jacket, quilt_m=0.0)
    return jacket


def _press_under_hood(hair: Hair, rng: np.random.Generator) -> Hair:
    """Hair under a raised hood: pressed flat, and long hair inside the hood."""
    if hair.style == "bald":
        return hair
    return dataclasses.replace(hair, style="short", volume_m=min(hair.volume_m, float(rng.uniform(0.005, 0.02))))
