"""Settings of clothes: families of garments, hair and shoes, and the ranges of their random parameters.

The ranges are our choice, after the sizes of ordinary clothes. Lengths are those of an adult and scale with the body.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from depthmocap.errors import InputError

#: The family of garments that is kept out of training, to test networks on unknown clothes.
HELD_OUT_FAMILY = "coat"

#: Height above the crotch of the line that skirts and low hems hang from (metres).
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
        thickness_m: of the cloth, everywhere.
        slack_m: air beneath the cloth where it is loosest.
        sag: 0–1, how freely the cloth falls from chest, belly and seat instead of following the skin.
        folds_m: height of folds.
        top: upper edge on the trunk, metres above the crotch; None for tops, which hang from the shoulders.
        hem: lower edge on the trunk, metres above the crotch.
        neck: upper edge at the neck, metres above its root; negative for a neckline that is cut out.
        v_neck_m: additional depth of the neckline in front.
        sleeve: 0 none, 1 to the elbow, 2 to the wrist.
        leg: 0 none, 1 to the knee, 2 to the ankle.
        skirt_m: length of the part that hangs around both legs, from ``SKIRT_LINE_M`` above the crotch; 0 for none.
        flare: outward slope of the skirt, metres a metre.
        cuff: 0–1, how tightly an elastic gathers hem and cuffs.
        open_m: half the gap of an open front at the hem; 0 for a closed one.
        hood_m: thickness of cloth gathered at the neckline: of a hood on the back, or of a collar.
        hood: a separately modelled hood: none, down (around the neck and on the back) or up (over the head).
        collar_m: height of a standing collar from the root of the neck; 0 for none.
        quilt_m: distance between quilting seams across trunk and sleeves; 0 for none.
        one_shoulder: 1 for a shawl over the left shoulder only, which slants to the right hip; −1 for the right.
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
        """Whether the garment is padded, as outdoor jackets are."""
        return self.family in OUTDOOR_FAMILIES

    @property
    def hangs_m(self) -> float:
        """Length (metres) of the part that hangs around hips and legs: a skirt, or the low hem of a top."""
        if self.skirt_m or self.leg:
            return self.skirt_m
        return max(SKIRT_LINE_M - self.hem, 0.0) if self.hem < SKIRT_LINE_M - 0.02 else 0.0


@dataclasses.dataclass(frozen=True)
class Hair:
    """Hair: thickness over the scalp and length of hanging hair (metres), lumpiness (0–1), and share of hanging hair in
    front of the shoulders (0–1)."""

    style: HairStyle = "short"
    volume_m: float = 0.015
    length_m: float = 0.0
    lumps: float = 0.3
    forward: float = 0.0


@dataclasses.dataclass(frozen=True)
class Shoes:
    """Shoes: thickness of sole and upper (metres), and upper edge of a boot's shaft (1 knee, 2 ankle)."""

    style: ShoeStyle = "shoes"
    sole_m: float = 0.02
    upper_m: float = 0.008
    shaft: float = 1.7


@dataclasses.dataclass(frozen=True)
class Hat:
    """A hat: thickness over the hair, and width of a brim or a visor (metres)."""

    style: HatStyle = "none"
    thickness_m: float = 0.01
    brim_m: float = 0.0


@dataclasses.dataclass(frozen=True)
class Scarf:
    """A scarf: radius of the roll around the neck, and lengths of the two ends on the chest (metres); 0 for no end."""

    roll_m: float = 0.03
    ends_m: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Clothes:
    """The clothes of a person: garments from the inside out, hair, shoes, hat and scarf."""

    garments: tuple[Garment, ...] = ()
    hair: Hair = Hair("bald")
    shoes: Shoes = Shoes("bare")
    hat: Hat = Hat()
    scarf: Scarf | None = None


_Range = tuple[float, float]

#: Ranges of the settings by family. Values are uniform; ``slack_m`` and ``sag`` are correlated, from tight to loose.
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
    # A gown is closed, thin and reaches the ground, so that it does not resemble the held-out coats.
    "gown": {"thickness_m": (0.003, 0.008), "slack_m": (0.015, 0.055), "sag": (0.7, 1), "folds_m": (0.004, 0.016),
             "neck": (0.0, 0.05), "sleeve": (1.5, 2.0), "skirt_m": (0.84, 1.0), "flare": (0.03, 0.35)},
    "shawl": {"thickness_m": (0.003, 0.012), "slack_m": (0.01, 0.05), "sag": (0.6, 1), "folds_m": (0.005, 0.016),
              "hem": (0.0, 0.2), "neck": (-0.03, 0.03), "sleeve": (0.1, 1.0)},
    # Outdoor jackets end above the middle of the thighs; the shortest held-out coat is longer.
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

#: Families of robes.
ROBE_FAMILIES = ("gown", "shawl")
#: Families of outdoor jackets: thick, stiff or padded, with standing collars and hoods.
OUTDOOR_FAMILIES = ("puffer", "parka", "anorak", "fleece")

#: Share of dark garments.
DARK_SHARE = 0.25


def random_garment(rng: np.random.Generator, family: str) -> Garment:
    """A garment of a family, within its ranges."""
    ranges = FAMILIES[family]
    values = {name: float(rng.uniform(*span)) for name, span in ranges.items()}
    # Most trousers are tight.
    looseness = rng.beta(1.2, 2.2) if family == "trousers" else rng.uniform()
    for name in ("slack_m", "sag"):
        low, high = ranges[name]
        values[name] = low + (high - low) * float(np.clip(looseness + rng.normal(0, 0.1), 0, 1))
    garment = dataclasses.replace(Garment(family), **values, dark=bool(rng.random() < DARK_SHARE))
    if family in ("jacket", "coat", *OUTDOOR_FAMILIES) and rng.random() < 0.45:
        garment = dataclasses.replace(garment, open_m=float(rng.uniform(0.04, 0.12)))
    if family == "shawl":
        garment = dataclasses.replace(garment, one_shoulder=float(rng.choice([-1.0, 1.0])))
    if family == "dress" and rng.random() < 0.35:
        garment = dataclasses.replace(garment, sleeve=0.0)
    return garment


def random_hair(rng: np.random.Generator, gender: float = 0.5) -> Hair:
    """Hair of any style; long styles are likelier towards gender 1."""
    styles: tuple[HairStyle, ...] = ("bald", "short", "curly", "bob", "long", "ponytail", "bun")
    shares = (1 - gender) * np.array([12, 66, 8, 4, 5, 2, 3]) + gender * np.array([1, 17, 10, 18, 30, 15, 9])
    style = styles[rng.choice(len(styles), p=shares / shares.sum())]
    volume = {"bald": (0, 0), "short": (0.004, 0.03), "curly": (0.03, 0.09)}.get(style, (0.006, 0.03))
    length = {"bob": (0.1, 0.2), "long": (0.2, 0.5), "ponytail": (0.15, 0.45)}.get(style, (0, 0))
    lumps = (0.4, 1.0) if style == "curly" else (0.1, 0.5)
    return Hair(style, float(rng.uniform(*volume)), float(rng.uniform(*length)), float(rng.uniform(*lumps)))


def random_shoes(rng: np.random.Generator) -> Shoes:
    """Shoes, boots or, rarely, bare feet."""
    styles: tuple[ShoeStyle, ...] = ("bare", "shoes", "boots")
    style = styles[rng.choice(3, p=(0.08, 0.75, 0.17))]
    shaft = float(rng.uniform(1.1, 1.85))
    return Shoes(style, float(rng.uniform(0.008, 0.04)), float(rng.uniform(0.003, 0.012)), shaft)


def random_clothes(rng: np.random.Generator, held_out: bool = False, gender: float = 0.5) -> Clothes:
    """Random indoor clothes.

    Args:
        held_out: the clothes always include ``HELD_OUT_FAMILY``; otherwise never.
        gender: 0–1 as in ``Phenotype``; it changes the shares of skirts, dresses and long hair only.
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
        if upper in ("tank", "t-shirt", "shirt") and rng.random() < 0.25:  # tucked into the bottom
            assert bottom.top is not None
            garments = [dataclasses.replace(top, hem=bottom.top - 0.04, sag=top.sag * 0.5), bottom]
        else:
            garments = [bottom, top]
    if held_out:
        coat = random_garment(rng, HELD_OUT_FAMILY)
        # The coat must lie over a skirt.
        garments.append(dataclasses.replace(coat, flare=max([coat.flare, *(inner.flare for inner in garments)])))
    elif rng.random() < 0.22:
        garments.append(random_garment(rng, "jacket"))
    return Clothes(tuple(garments), hair, shoes)


#: Clothes of the one character of easy and inter.
ORDINARY_CLOTHES = Clothes(
    (
        Garment("trousers", 0.005, slack_m=0.025, sag=0.5, folds_m=0.004, top=0.2, leg=2.05),
        Garment("t-shirt", 0.005, slack_m=0.02, sag=0.6, folds_m=0.005, hem=0.03, neck=0.0, sleeve=0.7),
    ),
    Hair("short", 0.015),
    Shoes("shoes"),
)
