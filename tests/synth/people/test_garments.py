"""Clothes, hair and shoes over the skin."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from depthmocap.body.regions import REGION_NAMES
from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import look_at
from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.mesh import REST_POSTURE, Body, BodyModel, Phenotype
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.shell import PosedCloth
from depthmocap.synth.people.wardrobe import (
    FAMILIES,
    HELD_OUT_FAMILY,
    ORDINARY_CLOTHES,
    OUTDOOR_FAMILIES,
    ROBE_FAMILIES,
    Clothes,
    Garment,
    Hair,
    Shoes,
    random_clothes,
    random_garment,
)
from depthmocap.synth.render import REACH_M, Material, PosedPerson, Rendering, render_person

KINDS = np.array([name.removesuffix(" R").removesuffix(" L") for name in REGION_NAMES])


def posture(**bones: tuple[float, float, float]) -> np.ndarray:
    """A posture; names are of bones without their side, for both sides, or with it (``thigh_L``)."""
    out = REST_POSTURE.copy()
    for name, vector in bones.items():
        name = name.replace("_L", ".L").replace("_R", ".R")
        for full in (name, f"{name}.L", f"{name}.R"):
            if full in POSTURE_INDEX:
                out[POSTURE_INDEX[full]] = vector
    return out


WALK = posture(thigh_L=(-0.45, 0, 0), thigh_R=(0.35, 0, 0), shin_L=(0.2, 0, 0), shin_R=(0.5, 0, 0))
SIT = posture(thigh=(-1.5, 0, 0), shin=(1.5, 0, 0))
KICK = posture(thigh_R=(-1.7, 0, 0), shin_R=(0.1, 0, 0))
SPLITS = posture(thigh_L=(-1.4, 0, 0), thigh_R=(1.2, 0, 0))
CARTWHEEL = posture(pelvis=(0, 3.0, 0), thigh_L=(0, 0.8, 0), thigh_R=(0, -0.8, 0))
CROUCH = posture(thigh=(-2.1, 0, 0), shin=(2.3, 0, 0), spine_low=(0.5, 0, 0))
EXTREMES = (REST_POSTURE, WALK, SIT, KICK, SPLITS, CARTWHEEL, CROUCH)


def see(person: PosedPerson, azimuth: float = 0.0, height: float = 0.3) -> Rendering:
    vertices = person.vertices
    centre = ((vertices.min(0) + vertices.max(0)) / 2).astype(float)
    eye = centre + np.array([2.6 * np.sin(azimuth), -2.6 * np.cos(azimuth), height])
    return render_person(person, DepthCamera("c", 160, 200, 200.0, 200.0, 79.5, 99.5, look_at(eye, centre)))


def bare_share(person: PosedPerson, *kinds: str) -> float:
    """Share of the pixels of some kinds of region, from all sides, that show skin."""
    skin = total = 0
    for azimuth in (0.0, 1.2, 2.4, 3.6, 4.8):
        view = see(person, azimuth)
        chosen = np.isin(KINDS[view.labels], kinds)
        skin += int((chosen & (view.material == Material.SKIN)).sum())
        total += int(chosen.sum())
    return skin / max(total, 1)


def middling(family: str, loose: float = 0.5) -> Garment:
    """A garment of a family in the middle of its ranges, as loose as said."""
    shares = {"slack_m": loose, "sag": loose}
    values = {name: low + shares.get(name, 0.5) * (high - low) for name, (low, high) in FAMILIES[family].items()}
    return dataclasses.replace(Garment(family), **values)


@pytest.fixture(scope="module")
def woman(body_model: BodyModel) -> Body:
    return body_model.shape(Phenotype(gender=0.9, weight=0.6))


def dressed_in(body: Body, *garments: Garment, seed: int = 0) -> DressedBody:
    return clothe(body, Clothes(garments), np.random.default_rng(seed))


def test_no_clothes_is_bare_skin(default_body: Body) -> None:
    person = clothe(default_body, Clothes(), np.random.default_rng(0)).pose(WALK)
    assert person.layers == ()
    np.testing.assert_array_equal(person.vertices, default_body.pose(WALK).vertices)


@pytest.mark.parametrize("loose", [0.0, 1.0])
def test_tops_and_trousers_stay_outside_the_skin(default_body: Body, loose: float) -> None:
    sweater, trousers = middling("sweater", loose), middling("trousers", loose)
    dressed = dressed_in(default_body, trousers, sweater)
    for pose in (REST_POSTURE, WALK, SIT):
        person = dressed.pose(pose)
        covered = ("belly", "chest", "upper back", "lower back", "upper arm", "elbow", "thigh", "knee", "shin")
        assert bare_share(person, *covered) < 0.01


def test_shells_stay_within_their_thickness(default_body: Body) -> None:
    for family in FAMILIES:
        garment = random_garment(np.random.default_rng(1), family)
        dressed = dressed_in(default_body, garment)
        shell = dressed.pieces[0].shell
        assert shell is not None
        posed = dressed.pose(REST_POSTURE).layers[0].vertices[: len(shell.vertices)]
        rest = default_body.rest_vertices[dressed.rest.cloth.vertices]
        skin = (1 - shell.mix)[:, None] * rest[shell.vertices] + shell.mix[:, None] * rest[shell.partner]
        off = np.linalg.norm(posed - skin, axis=1)
        most = 2 * (garment.thickness_m + garment.slack_m + garment.hood_m + 5 * garment.folds_m) + 0.15
        assert off.max() < most
        assert np.median(off) > 0.3 * garment.thickness_m


def test_looser_is_wider(default_body: Body) -> None:
    for family in ("t-shirt", "hoodie", "trousers", "dress"):
        tight, loose = (
            (see(dressed_in(default_body, middling(family, x)).pose(REST_POSTURE)).material == Material.CLOTH).sum()
            for x in (0.0, 1.0)
        )
        assert loose > 1.03 * tight


@pytest.mark.parametrize("pose", [REST_POSTURE, WALK, SIT, KICK], ids=["rest", "walk", "sit", "kick"])
def test_skirts_cover_the_thighs(woman: Body, pose: np.ndarray) -> None:
    skirt = dataclasses.replace(middling("skirt"), skirt_m=0.6, flare=0.2)
    person = dressed_in(woman, skirt).pose(pose)
    assert bare_share(dressed_in(woman).pose(pose), "thigh") == 1
    assert bare_share(person, "thigh") < (0.35 if pose is KICK else 0.1)


def test_a_longer_skirt_covers_more(woman: Body) -> None:
    shares = [
        bare_share(dressed_in(woman, dataclasses.replace(middling("skirt"), skirt_m=length)).pose(WALK), "knee", "shin")
        for length in (0.25, 0.5, 0.9)
    ]
    assert shares[0] > 0.9
    assert shares[2] < 0.3 < shares[1] < shares[0]


def test_extreme_postures_do_not_burst_the_seams(woman: Body) -> None:
    clothes = Clothes(
        (middling("trousers"), middling("dress"), middling("coat")), Hair("long", 0.02, 0.4), Shoes("boots")
    )
    dressed = clothe(woman, clothes, np.random.default_rng(3))
    for pose in EXTREMES:
        person = dressed.pose(pose)
        low, high = person.vertices.min(0) - 0.45, person.vertices.max(0) + 0.45
        for piece, layer in zip(dressed.pieces, person.layers, strict=True):
            assert np.isfinite(layer.vertices).all()
            assert (layer.vertices > low).all()
            assert (layer.vertices < high).all()
            if piece.sheet is not None:
                rows = piece.sheet.rows
                grid = layer.vertices[len(layer.vertices) - len(piece.sheet.rest) :].reshape(rows, -1, 3)
                stretch = np.linalg.norm(np.diff(grid, axis=0), axis=2) / piece.sheet.along
                assert np.quantile(stretch, 0.95) < 1.5
                # Nothing sinks into the floor that the person stands on.
                assert grid[1:, :, 2].min() > person.vertices[:, 2].min() - 1e-4


def test_a_skirt_hangs_down_when_the_person_lies_on_the_back(woman: Body) -> None:
    lying = posture(pelvis=(-np.pi / 2, 0, 0))
    skirt = dataclasses.replace(middling("skirt"), skirt_m=0.5, flare=0.4)
    layer = dressed_in(woman, skirt).pose(lying).layers[0]
    floor = woman.pose(lying).vertices[:, 2].min()
    assert layer.vertices[:, 2].min() < floor + 0.02


def test_the_labels_are_the_skins(default_body: Body) -> None:
    rng = np.random.default_rng(4)
    for seed in range(4):
        person = clothe(default_body, random_clothes(rng), rng).pose(EXTREMES[seed])
        bare, view = see(PosedPerson(person.body)), see(person)
        kept = view.labels > 0
        np.testing.assert_array_equal(view.labels[kept], bare.labels[kept])
        lost = (bare.labels > 0) & ~kept
        assert (bare.depth_m[lost] - view.depth_m[lost] > REACH_M - 1e-4).all()
        assert lost.mean() < 0.02
        # Clothes only add to what is seen, and only come nearer.
        assert view.person[bare.person].all()
        assert (view.depth_m[bare.person] <= bare.depth_m[bare.person]).all()


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_every_family_shows_in_the_depth(woman: Body, family: str) -> None:
    person = dressed_in(woman, random_garment(np.random.default_rng(0), family)).pose(REST_POSTURE)
    bare, view = see(PosedPerson(person.body)), see(person)
    cloth = np.isin(view.material, (Material.CLOTH, Material.DARK_CLOTH))
    assert cloth.mean() > 0.02
    assert np.median((bare.depth_m - view.depth_m)[cloth & bare.person]) > 0.003


def test_hidden_inner_clothes_are_not_drawn(default_body: Body) -> None:
    inner, outer = middling("t-shirt"), middling("jacket")
    alone = dressed_in(default_body, inner).pieces[0].shell
    beneath = dressed_in(default_body, inner, outer).pieces[0].shell
    assert alone is not None and beneath is not None
    assert len(beneath.faces) < 0.3 * len(alone.faces)
    # A vest has nothing that looks out of a closed jacket.
    vest = dataclasses.replace(middling("tank"), hem=0.2)
    assert len(dressed_in(default_body, vest, dataclasses.replace(outer, hem=0.05)).pieces) == 1


def test_an_open_jacket_shows_what_is_beneath(default_body: Body) -> None:
    shirt, jacket = dataclasses.replace(middling("t-shirt"), dark=True), middling("jacket")
    shares = []
    for gap in (0.0, 0.05, 0.1):
        worn = dressed_in(default_body, shirt, dataclasses.replace(jacket, open_m=gap)).pose(REST_POSTURE)
        shares.append((see(worn).material == Material.DARK_CLOTH).sum())
    assert shares[0] < 40 < shares[1] < shares[2]


def test_folds_deepen_where_the_body_bends(default_body: Body) -> None:
    smooth = Garment("sweater", 0.01, slack_m=0.02, sag=0.0, folds_m=0.0, hem=0.1, sleeve=2.0)
    creased = dataclasses.replace(smooth, folds_m=0.006)
    bent = posture(forearm_L=(-1.3, 0, -1.1))  # the elbow, by 100°
    depths = []
    for pose in (REST_POSTURE, bent):
        dressed = [dressed_in(default_body, garment) for garment in (smooth, creased)]
        a, b = (one.pose(pose).layers[0].vertices for one in dressed)
        shell, rest = dressed[0].pieces[0].shell, dressed[0].rest
        assert shell is not None
        compression = PosedCloth.of(rest, default_body.bone_transforms(bent)).compression[shell.vertices]
        depths.append(np.linalg.norm(a - b, axis=1)[compression > 0.08].mean())
    assert depths[1] > 1.5 * depths[0] > 0.0005


def test_hair_is_of_all_sizes(default_body: Body) -> None:
    hair = {
        "bald": Hair("bald", 0.0), "short": Hair("short", 0.01), "curly": Hair("curly", 0.07),
        "bob": Hair("bob", 0.015, 0.15), "long": Hair("long", 0.015, 0.4), "ponytail": Hair("ponytail", 0.01, 0.4),
        "bun": Hair("bun", 0.02),
    }  # fmt: skip
    size = {}
    for name, style in hair.items():
        person = clothe(default_body, Clothes((), style), np.random.default_rng(0)).pose(REST_POSTURE)
        size[name] = int((see(person, 2.6).material == Material.HAIR).sum())
    assert size["bald"] == 0 < size["short"] < size["bun"]
    assert size["short"] < size["bob"] < size["long"]
    assert size["curly"] > 1.5 * size["short"] < 1.2 * size["ponytail"]


def test_shoes_have_soles_and_boots_have_shafts(default_body: Body) -> None:
    floor = default_body.rest_vertices[:, 2].min()
    shoes, boots = (
        clothe(default_body, Clothes((), shoes=Shoes(style, sole_m=0.03, shaft=1.2)), np.random.default_rng(0))
        for style in ("shoes", "boots")
    )
    person = shoes.pose(REST_POSTURE)
    assert [layer.material for layer in person.layers] == [Material.SHOE] * 2
    for layer in person.layers:
        assert layer.vertices[:, 2].min() == pytest.approx(floor - 0.03, abs=2e-3)
    assert bare_share(person, "forefoot") < 0.01
    assert bare_share(person, "shin") > 0.95
    assert bare_share(boots.pose(REST_POSTURE), "shin", "ankle") < 0.15


def test_clothes_depend_on_the_seed_alone(default_body: Body) -> None:
    for seed in range(3):
        pair = []
        for _ in range(2):
            rng = np.random.default_rng(seed)
            pair.append(clothe(default_body, random_clothes(rng), rng).pose(WALK))
        assert len(pair[0].layers) == len(pair[1].layers)
        for a, b in zip(pair[0].layers, pair[1].layers, strict=True):
            np.testing.assert_array_equal(a.vertices, b.vertices)
            np.testing.assert_array_equal(a.faces, b.faces)


def test_the_held_out_family_is_only_drawn_when_asked() -> None:
    rng = np.random.default_rng(0)
    drawn = [random_clothes(rng, gender=float(rng.uniform())) for _ in range(300)]
    families = {garment.family for clothes in drawn for garment in clothes.garments}
    assert families == set(FAMILIES) - {HELD_OUT_FAMILY, *OUTDOOR_FAMILIES, *ROBE_FAMILIES}
    held = [random_clothes(rng, held_out=True) for _ in range(50)]
    assert all(HELD_OUT_FAMILY in [garment.family for garment in clothes.garments] for clothes in held)


def test_random_clothes_are_of_all_kinds() -> None:
    rng = np.random.default_rng(1)
    drawn = {gender: [random_clothes(rng, gender=gender) for _ in range(400)] for gender in (0.0, 1.0)}

    def skirted(clothes: Clothes) -> bool:
        return any(garment.family in ("skirt", "dress") for garment in clothes.garments)

    assert np.mean([skirted(c) for c in drawn[0.0]]) < 0.1 < 0.3 < np.mean([skirted(c) for c in drawn[1.0]])
    everything = drawn[0.0] + drawn[1.0]
    assert {clothes.shoes.style for clothes in everything} == {"bare", "shoes", "boots"}
    assert len({clothes.hair.style for clothes in everything}) == 7
    garments = [garment for clothes in everything for garment in clothes.garments]
    assert 0.15 < np.mean([garment.dark for garment in garments]) < 0.35
    for garment in garments:
        low, high = FAMILIES[garment.family]["thickness_m"]
        assert low <= garment.thickness_m <= high


def test_ordinary_clothes_have_top_trousers_and_shoes(default_body: Body) -> None:
    view = see(clothe(default_body, ORDINARY_CLOTHES, np.random.default_rng(0)).pose(WALK))
    shares = np.bincount(view.material[view.person], minlength=9) / view.person.sum()
    assert shares[Material.CLOTH] > 0.5
    assert shares[Material.SKIN] > 0.1
    assert shares[Material.HAIR] > 0.01
    assert shares[Material.SHOE] > 0.02


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"family": "toga"}, "toga"),
        ({"slack_m": -0.01}, "at least 0"),
        ({"thickness_m": float("nan")}, "finite"),
        ({"sag": 1.5}, "sag"),
        ({"sleeve": 3.0}, "sleeve"),
    ],
)
def test_impossible_garments_are_refused(change: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Garment(**{"family": "shirt", **change})
