"""Who is in the picture, and what clothes do to the skin."""

from __future__ import annotations

import dataclasses

import numpy as np

from depthmocap.synth.body.mesh import BodyModel, Phenotype
from depthmocap.synth.people.bodies import (
    ONE_CHARACTER,
    random_dressed_body,
    random_phenotype,
    sixteen_characters,
)
from depthmocap.synth.people.wardrobe import HELD_OUT_FAMILY, ORDINARY_CLOTHES


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


def test_easy_and_inter_have_one_character_in_ordinary_clothes(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    people = [random_dressed_body(rng, subset) for subset in ("easy", "inter", "easy")]
    assert people[0] is people[1] is people[2]
    assert people[0].clothes == ORDINARY_CLOTHES
    np.testing.assert_array_equal(people[0].body.rest_vertices, body_model.shape(ONE_CHARACTER).rest_vertices)


def test_hard_has_sixteen_characters_who_always_wear_the_same(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    people = {id(person): person for person in (random_dressed_body(rng, "hard") for _ in range(150))}
    assert len(people) == 16
    assert len({person.clothes for person in people.values()}) == 16
    assert random_dressed_body(np.random.default_rng(1), "easy") in people.values()


def test_open_is_anybody_and_depends_on_the_generator(body_model: BodyModel) -> None:
    a, b, c = (random_dressed_body(rng, "open") for rng in map(np.random.default_rng, (1, 1, 2)))
    np.testing.assert_array_equal(a.body.rest_vertices, b.body.rest_vertices)
    assert a.clothes == b.clothes != c.clothes


def test_held_out_clothes_are_worn_when_asked(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    for subset in ("easy", "hard", "open"):
        for held_out in (False, True):
            families = [garment.family for garment in random_dressed_body(rng, subset, held_out).clothes.garments]
            assert (HELD_OUT_FAMILY in families) == held_out
