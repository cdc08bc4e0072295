"""Who is in the picture: one character, sixteen, or bodies of all builds; and what they wear."""

from __future__ import annotations

import dataclasses
import functools
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.model import Body, BodyModel, Phenotype
from depthmocap.body.regions import REGION_NAMES
from depthmocap.kernels.skin import vertex_normals
from depthmocap.synth.garments import DressedBody, clothe
from depthmocap.synth.wardrobe import ORDINARY_CLOTHES, Clothes, Garment, random_clothes

__all__ = [
    "ONE_CHARACTER",
    "ORDINARY_CLOTHES",
    "Clothes",
    "DressedBody",
    "Garment",
    "Outfit",
    "clothe",
    "dress",
    "random_clothes",
    "random_dressed",
    "random_outfit",
    "random_phenotype",
    "sixteen_characters",
]

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
    rng: np.random.Generator, subset: Literal["easy", "inter", "hard", "open"], held_out: bool = False
) -> DressedBody:
    """A dressed body of a subset: easy and inter have one character, hard sixteen (kept once made), open any.

    Args:
        held_out: always in the family of garments that is kept out of training; otherwise never.
    """
    if subset in ("easy", "inter"):
        return _character(0, held_out)
    if subset == "hard":
        return _character(int(rng.integers(len(sixteen_characters()))), held_out)
    phenotype = random_phenotype(rng)
    body = BodyModel.load().shape(phenotype)
    return clothe(body, random_clothes(rng, held_out, phenotype.gender), rng)


@dataclasses.dataclass(frozen=True)
class Outfit:
    """Thickness (metres) that clothes, shoes and hair add over the skin, with folds; zero is bare."""

    top_m: float = 0.0
    bottom_m: float = 0.0
    shoes_m: float = 0.0
    hair_m: float = 0.0
    folds: float = 0.5
    long_sleeves: bool = True
    long_legs: bool = True


def random_outfit(rng: np.random.Generator) -> Outfit:
    """Anything from bare to a thick jacket and full hair."""
    return Outfit(
        top_m=float(rng.choice([0.004, 0.012, 0.025]) * rng.uniform(0.5, 1.5)),
        bottom_m=float(rng.choice([0.004, 0.01, 0.02]) * rng.uniform(0.5, 1.5)),
        shoes_m=float(rng.uniform(0, 0.012)),
        hair_m=float(rng.choice([0.0, 0.015, 0.04]) * rng.uniform(0.5, 1.5)),
        folds=float(rng.uniform(0.2, 1.0)),
        long_sleeves=bool(rng.random() < 0.5),
        long_legs=bool(rng.random() < 0.7),
    )


def _cover(names: tuple[str, ...], model: BodyModel) -> Float[ndarray, "v"]:
    """1 on the vertices of the named kinds of region, 0 elsewhere, softened over one ring of faces."""
    chosen = np.array([name.removesuffix(" R").removesuffix(" L") in names for name in REGION_NAMES])
    inside = chosen[model.face_regions].astype(np.float32)
    corners = model.faces.reshape(-1)
    count = np.bincount(corners, minlength=int(corners.max()) + 1)
    return (np.bincount(corners, np.repeat(inside, 3)) / np.maximum(count, 1)).astype(np.float32)


@functools.cache
def _covers(model: BodyModel) -> dict[str, Float[ndarray, "v"]]:
    trunk = ("chest", "belly", "upper back", "lower back", "collar", "shoulder front", "shoulder back", "nape")
    return {
        "top": _cover((*trunk, "upper arm"), model),
        "sleeves": _cover(("elbow", "forearm", "wrist"), model),
        "bottom": _cover(("thigh", "knee", "lower back"), model),
        "legs": _cover(("shin", "ankle"), model),
        "shoes": _cover(("forefoot", "ankle"), model),
        "hair": _cover(("hair", "forehead"), model),
    }


def dress(body: Body, outfit: Outfit, rng: np.random.Generator) -> Body:
    """The body with its skin pushed out by an outfit. The depth shows the clothes; the labels stay the skin's."""
    covers = _covers(body.model)
    thickness = outfit.top_m * (covers["top"] + outfit.long_sleeves * covers["sleeves"])
    thickness = thickness + outfit.bottom_m * (covers["bottom"] + outfit.long_legs * covers["legs"])
    thickness = thickness + outfit.shoes_m * covers["shoes"]
    rest = body.rest_vertices
    wave = np.zeros(len(rest), dtype=np.float32)
    for _ in range(4):  # folds: a few random waves over the skin, 5–25 cm long
        direction = rng.normal(size=3)
        direction *= 2 * np.pi / rng.uniform(0.05, 0.25) / np.linalg.norm(direction)
        wave += np.sin(rest @ direction.astype(np.float32) + np.float32(rng.uniform(0, 2 * np.pi)))
    thickness = thickness * np.maximum(1 + outfit.folds * wave * 0.35, 0) + outfit.hair_m * covers["hair"] * (
        1 + 0.2 * wave
    )
    normals = np.empty_like(rest)
    vertex_normals(rest, body.model.faces, normals)
    return body.with_vertices(rest + normals * thickness[:, None].astype(np.float32))
