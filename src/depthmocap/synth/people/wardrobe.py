"""What people wear, as settings: families of garments, hair and shoes with the ranges they are drawn from.

Ranges are our choice, after ordinary clothes' sizes; lengths are of an adult and shrink with the body.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from depthmocap.errors import InputError

#: The family that is kept out of training, to test what a network makes of clothes it has never seen.
HELD_OUT_FAMILY = "coat"

#: Height of the line that skirts and low hems hang from, metres above the crotch.
SKIRT_LINE_M = 0.05

Hood = Literal["none", "down", "up"]
HatStyle = Literal["none", "beanie", "cap", "brim", "helmet"]
HairStyle = Literal["bald", "short", "curly", "bob", "long", "ponytail", "bun"]
ShoeStyle = Literal["bare", "shoes", "boots"]


@dataclasses.dataclass(frozen=True)
class Garment:
    """One garment.

    Attributes:
        family: a key of ``FAMILIES``.
        thickness_m: cloth and what is under it, over the skin everywhere.
        slack_m: air under the cloth where it is loosest.
        sag: 0–1, how freely it falls from what sticks out (chest, belly, seat) instead of following the skin.
        folds_m: height of folds.
        top: the upper edge on the trunk, metres above the crotch; tops, which hang from the shoulders, have none.
        hem: the lower edge on the trunk, metres above the crotch.
        neck: how far it goes up the neck, metres above its root; negative is cut out.
        v_neck_m: how much deeper the neckline is in front.
        sleeve: 0 none, 1 to the elbow, 2 to the wrist.
        leg: 0 none, 1 to the knee, 2 to the ankle.
        skirt_m: length of what hangs free around both legs, from ``SKIRT_LINE_M`` above the crotch; 0 is none.
        flare: outward slope of the skirt, metres a metre.
        cuff: 0–1, how tightly an elastic gathers hem and cuffs.
        open_m: half the gap of an open front at the hem; 0 is closed.
        hood_m: thickness of cloth that is gathered at the neckline: of a hood that lies on the back, or of a collar.
        hood: a hood's own shape: none, lying round the neck and on the back, or up, over the head.
        collar_m: height of a collar that stands round the neck, from its root; 0 is none.
        quilt_m: distance of the seams across trunk and sleeves between which padding bulges; 0 is none.
        one_shoulder: 1 for what is wound over the left shoulder alone and slants to the other hip, −1 for the right.
        dark: dark cloth, which returns less light.
    """

    family: str
    thickness_m: float = 0.006
    slack_m: float = 0.02
    sag: float = 0.5
    folds_m: float = 0.004
    top: float | None = None
    hem: float = 0.03
    neck: float = 0.0
    v_neck_m: float = 0.0
    sleeve: float = 0.0
    leg: float = 0.0
    skirt_m: float = 0.0
    flare: float = 0.0
    cuff: float = 0.0
    open_m: float = 0.0
    hood_m: float = 0.0
    hood: Hood = "none"
    collar_m: float = 0.0
    quilt_m: float = 0.0
    one_shoulder: float = 0.0
    dark: bool = False

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise InputError(f"{self.family!r} is no family of garments: use one of {', '.join(FAMILIES)}")
        lengths = (
            self.thickness_m, self.slack_m, self.folds_m, self.skirt_m, self.open_m, self.hood_m, self.v_neck_m,
            self.collar_m, self.quilt_m,
        )  # fmt: skip
        if not all(np.isfinite(lengths)) or min(lengths) < 0:
            raise InputError(f"{self.family}: lengths of a garment must be finite and at least 0, got {lengths}")
        for name in ("sag", "cuff"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{self.family}: {name} must be in 0 to 1, got {getattr(self, name)}")
        for name in ("sleeve", "leg"):
            if not 0 <= getattr(self, name) <= 2.2:
                raise InputError(f"{self.family}: {name} must be in 0 (none) to 2.2, got {getattr(self, name)}")

    @property
    def padded(self) -> bool:
        """Whether there is padding in it, as in outdoor jackets."""
        return self.family in OUTDOOR_FAMILIES

    @property
    def hangs_m(self) -> float:
        """Length (metres) of what hangs free around the hips and legs: a skirt, or a top's hem that reaches low."""
        if self.skirt_m or self.leg:
            return self.skirt_m
        return max(SKIRT_LINE_M - self.hem, 0.0) if self.hem < SKIRT_LINE_M - 0.02 else 0.0


@dataclasses.dataclass(frozen=True)
class Hair:
    """Hair: its thickness over the scalp (metres), the length of what hangs (metres), 0–1 how lumpy it is, and 0–1 how
    much of what hangs lies before the shoulders."""

    style: HairStyle = "short"
    volume_m: float = 0.015
    length_m: float = 0.0
    lumps: float = 0.3
    forward: float = 0.0


@dataclasses.dataclass(frozen=True)
class Shoes:
    """Shoes: sole and upper (metres) and how far up the leg boots reach (1 knee, 2 ankle)."""

    style: ShoeStyle = "shoes"
    sole_m: float = 0.02
    upper_m: float = 0.008
    shaft: float = 1.7


@dataclasses.dataclass(frozen=True)
class Hat:
    """What is worn on the head: its thickness over the hair, and how far a brim or a visor reaches out (metres)."""

    style: HatStyle = "none"
    thickness_m: float = 0.01
    brim_m: float = 0.0


@dataclasses.dataclass(frozen=True)
class Scarf:
    """A scarf round the neck: radius of its roll, and lengths of the ends on the chest, 0 for none (metres)."""

    roll_m: float = 0.03
    ends_m: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Clothes:
    """All that a person wears: garments from the inside out, hair, shoes, a hat and a scarf."""

    garments: tuple[Garment, ...] = ()
    hair: Hair = Hair("bald")
    shoes: Shoes = Shoes("bare")
    hat: Hat = Hat()
    scarf: Scarf | None = None


_Range = tuple[float, float]

#: Family → settings, each drawn uniformly within its range; ``slack_m`` and ``sag`` are drawn together, tight to loose.
FAMILIES: dict[str, dict[str, _Range]] = {
    "tank": {"thickness_m": (0.003, 0.006), "slack_m": (0.0, 0.03), "sag": (0.1, 0.9), "folds_m": (0.001, 0.005),
             "hem": (0.0, 0.16), "neck": (-0.07, -0.02), "v_neck_m": (0, 0.06)},
    "t-shirt": {"thickness_m": (0.003, 0.008), "slack_m": (0.003, 0.045), "sag": (0.1, 1), "folds_m": (0.002, 0.009),
                "hem": (-0.06, 0.12), "neck": (-0.02, 0.01), "v_neck_m": (0, 0.05), "sleeve": (0.35, 1.0)},
    "shirt": {"thickness_m": (0.003, 0.008), "slack_m": (0.008, 0.045), "sag": (0.3, 1), "folds_m": (0.003, 0.011),
              "hem": (-0.1, 0.08), "neck": (0.015, 0.05), "v_neck_m": (0, 0.05), "sleeve": (1.2, 1.97),
              "hood_m": (0.004, 0.014)},
    "sweater": {"thickness_m": (0.006, 0.016), "slack_m": (0.004, 0.045), "sag": (0.3, 1), "folds_m": (0.003, 0.011),
                "hem": (-0.06, 0.12), "neck": (-0.02, 0.07), "v_neck_m": (0, 0.04), "sleeve": (1.6, 2.0),
                "cuff": (0, 0.9)},
    "hoodie": {"thickness_m": (0.010, 0.02), "slack_m": (0.012, 0.055), "sag": (0.6, 1), "folds_m": (0.004, 0.013),
               "hem": (-0.06, 0.1), "neck": (0.01, 0.04), "sleeve": (1.8, 2.0), "cuff": (0.4, 1),
               "hood_m": (0.02, 0.06)},
    "jacket": {"thickness_m": (0.012, 0.035), "slack_m": (0.01, 0.05), "sag": (0.6, 1), "folds_m": (0.003, 0.012),
               "hem": (-0.12, 0.17), "neck": (0.01, 0.06), "sleeve": (1.8, 2.0), "cuff": (0, 0.8),
               "hood_m": (0.005, 0.045)},
    "coat": {"thickness_m": (0.010, 0.03), "slack_m": (0.015, 0.05), "sag": (0.7, 1), "folds_m": (0.004, 0.012),
             "neck": (0.01, 0.06), "sleeve": (1.7, 2.0), "skirt_m": (0.3, 0.8), "flare": (0.03, 0.25),
             "hood_m": (0.005, 0.04)},
    "trousers": {"thickness_m": (0.003, 0.009), "slack_m": (0.0, 0.075), "sag": (0.1, 0.9), "folds_m": (0.002, 0.014),
                 "top": (0.16, 0.27), "leg": (1.8, 2.12), "cuff": (0, 0.5)},
    "shorts": {"thickness_m": (0.003, 0.009), "slack_m": (0.002, 0.06), "sag": (0.3, 1), "folds_m": (0.003, 0.012),
               "top": (0.16, 0.27), "leg": (0.4, 1.15)},
    "skirt": {"thickness_m": (0.003, 0.009), "slack_m": (0.003, 0.03), "sag": (0.5, 1), "folds_m": (0.002, 0.02),
              "top": (0.17, 0.28), "skirt_m": (0.25, 0.9), "flare": (0.0, 0.45)},
    "dress": {"thickness_m": (0.003, 0.008), "slack_m": (0.003, 0.035), "sag": (0.1, 0.8), "folds_m": (0.002, 0.02),
              "neck": (-0.06, 0.03), "v_neck_m": (0, 0.07), "sleeve": (0, 1.95), "skirt_m": (0.25, 0.9),
              "flare": (0.0, 0.45)},
    # To the ground, closed, of thin cloth, so that no coat is like it.
    "gown": {"thickness_m": (0.003, 0.008), "slack_m": (0.015, 0.055), "sag": (0.7, 1), "folds_m": (0.004, 0.016),
             "neck": (0.0, 0.05), "sleeve": (1.5, 2.0), "skirt_m": (0.84, 1.0), "flare": (0.03, 0.35)},
    "shawl": {"thickness_m": (0.003, 0.012), "slack_m": (0.01, 0.05), "sag": (0.6, 1), "folds_m": (0.005, 0.016),
              "hem": (0.0, 0.2), "neck": (-0.03, 0.03), "sleeve": (0.1, 1.0)},
    # Outdoor jackets. They end above the middle of the thighs, where the shortest coat goes on.
    "puffer": {"thickness_m": (0.02, 0.06), "slack_m": (0.01, 0.05), "sag": (0.7, 1), "folds_m": (0.002, 0.008),
               "hem": (-0.08, 0.17), "neck": (0.01, 0.04), "sleeve": (1.8, 2.02), "cuff": (0.2, 1),
               "hood_m": (0.02, 0.05), "collar_m": (0.04, 0.115), "quilt_m": (0.06, 0.13)},
    "parka": {"thickness_m": (0.02, 0.045), "slack_m": (0.015, 0.05), "sag": (0.8, 1), "folds_m": (0.004, 0.012),
              "hem": (-0.18, -0.03), "neck": (0.01, 0.04), "sleeve": (1.85, 2.03), "cuff": (0, 0.6),
              "hood_m": (0.02, 0.05), "collar_m": (0.04, 0.11)},
    "anorak": {"thickness_m": (0.006, 0.02), "slack_m": (0.03, 0.08), "sag": (0.7, 1), "folds_m": (0.006, 0.016),
               "hem": (-0.1, 0.1), "neck": (0.01, 0.05), "sleeve": (1.85, 2.02), "cuff": (0.3, 1),
               "hood_m": (0.012, 0.04), "collar_m": (0.03, 0.1)},
    "fleece": {"thickness_m": (0.014, 0.035), "slack_m": (0.005, 0.045), "sag": (0.5, 1), "folds_m": (0.002, 0.009),
               "hem": (-0.06, 0.12), "neck": (0.01, 0.05), "sleeve": (1.8, 2.0), "cuff": (0.2, 1),
               "hood_m": (0.005, 0.02), "collar_m": (0.03, 0.1)},
}  # fmt: skip

#: Families of some peoples and occasions.
ROBE_FAMILIES = ("gown", "shawl")
#: Families worn over all else and outdoors: thick, stiff or blown up, with standing collars and hoods.
OUTDOOR_FAMILIES = ("puffer", "parka", "anorak", "fleece")

#: Share of clothes that is dark.
DARK_SHARE = 0.25


def random_garment(rng: np.random.Generator, family: str) -> Garment:
    """A garment of a family, within its ranges."""
    ranges = FAMILIES[family]
    values = {name: float(rng.uniform(*span)) for name, span in ranges.items()}
    # Most trousers are rather tight.
    loose = rng.beta(1.2, 2.2) if family == "trousers" else rng.uniform()
    for name in ("slack_m", "sag"):
        low, high = ranges[name]
        values[name] = low + (high - low) * float(np.clip(loose + rng.normal(0, 0.1), 0, 1))
    garment = dataclasses.replace(Garment(family), **values, dark=bool(rng.random() < DARK_SHARE))
    if family in ("jacket", "coat", *OUTDOOR_FAMILIES) and rng.random() < 0.45:
        garment = dataclasses.replace(garment, open_m=float(rng.uniform(0.04, 0.12)))
    if family == "shawl":
        garment = dataclasses.replace(garment, one_shoulder=float(rng.choice([-1.0, 1.0])))
    if family == "dress" and rng.random() < 0.35:
        garment = dataclasses.replace(garment, sleeve=0.0)
    return garment


def random_hair(rng: np.random.Generator, gender: float = 0.5) -> Hair:
    """Hair of any style; long ones are likelier towards gender 1."""
    styles: tuple[HairStyle, ...] = ("bald", "short", "curly", "bob", "long", "ponytail", "bun")
    shares = (1 - gender) * np.array([12, 66, 8, 4, 5, 2, 3]) + gender * np.array([1, 17, 10, 18, 30, 15, 9])
    style = styles[rng.choice(len(styles), p=shares / shares.sum())]
    volume = {"bald": (0, 0), "short": (0.004, 0.03), "curly": (0.03, 0.09)}.get(style, (0.006, 0.03))
    length = {"bob": (0.1, 0.2), "long": (0.2, 0.5), "ponytail": (0.15, 0.45)}.get(style, (0, 0))
    lumps = (0.4, 1.0) if style == "curly" else (0.1, 0.5)
    return Hair(style, float(rng.uniform(*volume)), float(rng.uniform(*length)), float(rng.uniform(*lumps)))


def random_shoes(rng: np.random.Generator) -> Shoes:
    """Shoes or boots; now and then bare feet."""
    styles: tuple[ShoeStyle, ...] = ("bare", "shoes", "boots")
    style = styles[rng.choice(3, p=(0.08, 0.75, 0.17))]
    high = float(rng.uniform(1.1, 1.85))
    return Shoes(style, float(rng.uniform(0.008, 0.04)), float(rng.uniform(0.003, 0.012)), high)


def random_clothes(rng: np.random.Generator, held_out: bool = False, gender: float = 0.5) -> Clothes:
    """What somebody may wear.

    Args:
        held_out: always wear the family ``HELD_OUT_FAMILY``; otherwise never.
        gender: 0–1 as in ``Phenotype``; it only shifts how likely skirts, dresses and long hair are.
    """
    hair, shoes = random_hair(rng, gender), random_shoes(rng)
    garments: list[Garment] = []
    if rng.random() < 0.02 + 0.22 * gender:
        garments.append(random_garment(rng, "dress"))
        if rng.random() < 0.3:  # leggings
            tight = dataclasses.replace(random_garment(rng, "trousers"), slack_m=0.0, sag=0.0, folds_m=0.001)
            garments.insert(0, tight)
    else:
        skirt = 0.01 + 0.24 * gender
        lower = rng.choice(["trousers", "shorts", "skirt"], p=[0.82 - 0.82 * skirt, 0.18 - 0.18 * skirt, skirt])
        bottom = random_garment(rng, str(lower))
        upper = rng.choice(["tank", "t-shirt", "shirt", "sweater", "hoodie"], p=[0.07, 0.33, 0.2, 0.2, 0.2])
        top = random_garment(rng, str(upper))
        if upper in ("tank", "t-shirt", "shirt") and rng.random() < 0.25:  # tucked in: the bottom goes over it
            assert bottom.top is not None
            garments = [dataclasses.replace(top, hem=bottom.top - 0.04, sag=top.sag * 0.5), bottom]
        else:
            garments = [bottom, top]
    if held_out:
        coat = random_garment(rng, HELD_OUT_FAMILY)
        # It must go over a skirt.
        garments.append(dataclasses.replace(coat, flare=max([coat.flare, *(inner.flare for inner in garments)])))
    elif rng.random() < 0.22:
        garments.append(random_garment(rng, "jacket"))
    return Clothes(tuple(garments), hair, shoes)


#: What the one character of easy and inter wears.
ORDINARY_CLOTHES = Clothes(
    (
        Garment("trousers", 0.005, slack_m=0.025, sag=0.5, folds_m=0.004, top=0.2, leg=2.05),
        Garment("t-shirt", 0.005, slack_m=0.02, sag=0.6, folds_m=0.005, hem=0.03, neck=0.0, sleeve=0.7),
    ),
    Hair("short", 0.015),
    Shoes("shoes"),
)
