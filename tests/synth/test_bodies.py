"""Who is in the picture, and what clothes do to the skin."""

from __future__ import annotations

import dataclasses

import numpy as np

from depthmocap.body.model import Body, BodyModel, Phenotype
from depthmocap.body.regions import REGION
from depthmocap.synth.bodies import (
    ONE_CHARACTER,
    ORDINARY_CLOTHES,
    Outfit,
    dress,
    random_dressed,
    random_outfit,
    random_phenotype,
    sixteen_characters,
)
from depthmocap.synth.wardrobe import HELD_OUT_FAMILY


def test_the_sixteen_are_fixed_adults() -> None:
    characters = sixteen_characters()
    assert len(characters) == len(set(characters)) == 16
    assert characters == sixteen_characters.__wrapped__()
    assert min(character.age for character in characters) >= 0.5


def test_random_phenotypes_are_of_all_kinds() -> None:
    rng = np.random.default_rng(0)
    people = [random_phenotype(rng) for _ in range(300)]
    for field in dataclasses.fields(Phenotype):
        values = np.array([getattr(person, field.name) for person in people])
        assert values.min() >= 0
        assert values.max() <= 1
        assert np.ptp(values) > 0.7
    assert 20 < sum(person.age < 0.5 for person in people) < 90


def test_no_outfit_is_bare_skin(default_body: Body) -> None:
    bare = dress(default_body, Outfit(), np.random.default_rng(0))
    np.testing.assert_array_equal(bare.rest_vertices, default_body.rest_vertices)


def test_outfit_pushes_the_covered_skin_outwards(body_model: BodyModel, default_body: Body) -> None:
    outfit = Outfit(top_m=0.02, folds=0.0, long_sleeves=False)
    dressed = dress(default_body, outfit, np.random.default_rng(0))
    shift = dressed.rest_vertices - default_body.rest_vertices

    def vertices(region: str) -> np.ndarray:
        return np.unique(body_model.faces[body_model.face_regions == REGION[region]])

    assert np.median(np.linalg.norm(shift[vertices("chest R")], axis=1)) == np.float32(0.02)
    assert shift[vertices("chest R"), 1].mean() < -0.005  # forwards
    assert shift[vertices("upper back L"), 1].mean() > 0.01
    assert not shift[vertices("forearm L")].any()
    assert not shift[vertices("shin L")].any()
    # The skeleton stays.
    np.testing.assert_array_equal(dressed.rest_heads, default_body.rest_heads)


def test_random_outfits_depend_on_the_generator(default_body: Body) -> None:
    dressed = [dress(default_body, random_outfit(rng), rng) for rng in map(np.random.default_rng, (1, 1, 2))]
    np.testing.assert_array_equal(dressed[0].rest_vertices, dressed[1].rest_vertices)
    assert np.abs(dressed[0].rest_vertices - dressed[2].rest_vertices).max() > 0.003
    thickness = np.linalg.norm(dressed[0].rest_vertices - default_body.rest_vertices, axis=1)
    assert thickness.max() < 0.15


def test_easy_and_inter_have_one_character_in_ordinary_clothes(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    people = [random_dressed(rng, subset) for subset in ("easy", "inter", "easy")]
    assert people[0] is people[1] is people[2]
    assert people[0].clothes == ORDINARY_CLOTHES
    np.testing.assert_array_equal(people[0].body.rest_vertices, body_model.shape(ONE_CHARACTER).rest_vertices)


def test_hard_has_sixteen_characters_who_always_wear_the_same(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    people = {id(person): person for person in (random_dressed(rng, "hard") for _ in range(150))}
    assert len(people) == 16
    assert len({person.clothes for person in people.values()}) == 16
    assert random_dressed(np.random.default_rng(1), "easy") in people.values()


def test_open_is_anybody_and_depends_on_the_generator(body_model: BodyModel) -> None:
    a, b, c = (random_dressed(rng, "open") for rng in map(np.random.default_rng, (1, 1, 2)))
    np.testing.assert_array_equal(a.body.rest_vertices, b.body.rest_vertices)
    assert a.clothes == b.clothes != c.clothes


def test_held_out_clothes_are_worn_when_asked(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    for subset in ("easy", "hard", "open"):
        for held_out in (False, True):
            families = [garment.family for garment in random_dressed(rng, subset, held_out).clothes.garments]
            assert (HELD_OUT_FAMILY in families) == held_out
