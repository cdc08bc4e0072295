"""Thick jackets, standing collars, hoods, and hands in pockets."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from depthmocap.body.regions import REGION_NAMES
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import look_at
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.pocketed_hands import PocketKind, hands_in_pockets, hold_arms_off_trunk
from depthmocap.synth.people.bodies import random_dressed_body
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.outdoors import HAT_SHARE, HOOD_UP_SHARE, JACKET_SHARE, SCARF_SHARE, add_outdoor_clothes
from depthmocap.synth.people.pockets import find_pockets, pose_in_clothes
from depthmocap.synth.people.wardrobe import (
    FAMILIES,
    HELD_OUT_FAMILY,
    OUTDOOR_FAMILIES,
    SKIRT_LINE_M,
    Clothes,
    Garment,
    Hair,
    Hat,
    HatStyle,
    Scarf,
    random_clothes,
    random_garment,
)
from depthmocap.synth.render import Material, PosedPerson, Rendering, render_person

KINDS = np.array([name.removesuffix(" R").removesuffix(" L") for name in REGION_NAMES])
ARMS = [i for i, name in enumerate(POSTURE_BONES) if name.split(".")[0] in ("upper_arm", "forearm", "hand")]
PUFFER = Garment("puffer", 0.05, slack_m=0.03, sag=0.9, hem=0.05, neck=0.03, sleeve=1.95, quilt_m=0.09)


def standing() -> np.ndarray:
    """Arms hang straight down."""
    out = REST_POSTURE.copy()
    for side, sign in (("R", -1.0), ("L", 1.0)):
        out[POSTURE_INDEX[f"upper_arm.{side}"]] = (0, sign * 0.65, 0)
    return out


def see(person: PosedPerson, azimuth: float = 0.0) -> Rendering:
    vertices = person.vertices
    centre = ((vertices.min(0) + vertices.max(0)) / 2).astype(float)
    eye = centre + np.array([2.6 * np.sin(azimuth), -2.6 * np.cos(azimuth), 0.2])
    return render_person(person, DepthCamera("c", 160, 200, 200.0, 200.0, 79.5, 99.5, look_at(eye, centre)))


def bare_share(view: Rendering, *kinds: str) -> float:
    """Share of the pixels of some kinds of region that show skin."""
    chosen = np.isin(KINDS[view.labels], kinds)
    return float((view.material[chosen] == Material.SKIN).mean())


def in_jacket(body: Body, **changes: object) -> DressedBody:
    jacket = dataclasses.replace(PUFFER, **changes)
    return clothe(body, Clothes((jacket,), Hair("short")), np.random.default_rng(0))


def test_what_is_worn_outdoors_is_drawn_as_often_as_said() -> None:
    rng = np.random.default_rng(0)
    indoors = [random_clothes(rng, gender=float(rng.uniform())) for _ in range(1200)]
    drawn = [add_outdoor_clothes(clothes, rng) for clothes in indoors]
    worn = [{garment.family for garment in clothes.garments} for clothes in drawn]
    assert set.union(*worn) == set(FAMILIES) - {HELD_OUT_FAMILY}
    assert np.mean([bool(families & set(OUTDOOR_FAMILIES)) for families in worn]) == pytest.approx(
        JACKET_SHARE, abs=0.05
    )
    assert np.mean([clothes.hat.style != "none" for clothes in drawn]) == pytest.approx(HAT_SHARE, abs=0.04)
    assert np.mean([clothes.scarf is not None for clothes in drawn]) == pytest.approx(SCARF_SHARE, abs=0.03)
    drawn = [clothes for clothes in drawn if clothes.garments[-1].family != "gown"]
    hoods = [clothes.garments[-1].hood for clothes in drawn]
    assert np.mean([hood == "up" for hood in hoods if hood != "none"]) == pytest.approx(HOOD_UP_SHARE, abs=0.1)
    assert all(clothes.hair.length_m == 0 or clothes.hair.style != "long" or hood != "up"
               for clothes, hood in zip(drawn, hoods, strict=True))  # fmt: skip
    everybody = [add_outdoor_clothes(clothes, rng, 1.0).garments[-1].family for clothes in indoors[:50]]
    assert set(everybody) <= set(OUTDOOR_FAMILIES)


def test_the_longest_outdoor_jacket_is_shorter_than_the_shortest_coat() -> None:
    longest = max(SKIRT_LINE_M - FAMILIES[family]["hem"][0] for family in OUTDOOR_FAMILIES)
    assert longest < FAMILIES[HELD_OUT_FAMILY]["skirt_m"][0] - 0.05


def test_a_seed_has_the_same_bodies_indoors_and_outdoors(default_body: Body) -> None:
    for seed in range(3):
        indoors, outdoors = (
            random_dressed_body(np.random.default_rng(seed), "open", wardrobe=wardrobe)
            for wardrobe in ("indoors", "outdoors")
        )
        np.testing.assert_array_equal(indoors.body.rest_vertices, outdoors.body.rest_vertices)
        assert outdoors.clothes.garments[-1].family in OUTDOOR_FAMILIES
        held_out = random_dressed_body(np.random.default_rng(seed), "open", True, "any")
        assert held_out.clothes.garments[-1].family == HELD_OUT_FAMILY


def test_padding_is_thick_and_ridged(default_body: Body) -> None:
    bare = see(PosedPerson(default_body.pose(REST_POSTURE)))
    chest = np.isin(KINDS[bare.labels], ("chest", "belly"))
    rough = {}
    for quilt in (0.0, 0.1):
        view = see(in_jacket(default_body, quilt_m=quilt, folds_m=0.0).pose(REST_POSTURE))
        off = (bare.depth_m - view.depth_m)[chest]
        assert 0.03 < np.median(off) < 0.12
        middle = view.depth_m[55:90, 75:85].mean(1)
        rough[quilt] = np.abs(np.diff(middle, 2)).mean()
    assert rough[0.1] > 1.5 * rough[0.0]


def test_a_high_collar_hides_the_neck_but_not_the_face(default_body: Body) -> None:
    low, high = (see(in_jacket(default_body, collar_m=height).pose(REST_POSTURE)) for height in (0.0, 0.1))
    assert bare_share(high, "neck front") < 0.3 < bare_share(low, "neck front")
    assert bare_share(high, "face") > 0.6
    assert bare_share(see(in_jacket(default_body, collar_m=0.1).pose(REST_POSTURE), np.pi), "nape") < 0.05


def test_hoods_lie_behind_the_neck_or_go_round_the_head(default_body: Body) -> None:
    front, back = {}, {}
    for hood in ("none", "down", "up"):
        person = in_jacket(default_body, hood=hood, hood_m=0.04).pose(REST_POSTURE)
        front[hood], back[hood] = see(person), see(person, np.pi)
    assert bare_share(front["up"], "face") > 0.5
    hair = {hood: int((view.material == Material.HAIR).sum()) for hood, view in back.items()}
    assert hair["none"] >= hair["down"] > 100 > hair["up"] == 0
    # A roll behind the neck comes out of the back.
    nape = KINDS[back["none"].labels] == "nape"
    assert np.quantile((back["none"].depth_m - back["down"].depth_m)[nape], 0.8) > 0.02
    # A hood is a few centimetres off the head.
    head = KINDS[back["none"].labels] == "hair"
    off = (back["none"].depth_m - back["up"].depth_m)[head]
    assert 0.005 < np.median(off) < 0.09


def test_gowns_are_neither_as_short_nor_as_thick_as_coats() -> None:
    gown, coat = FAMILIES["gown"], FAMILIES[HELD_OUT_FAMILY]
    assert gown["skirt_m"][0] > coat["skirt_m"][1]
    assert gown["thickness_m"][1] < coat["thickness_m"][0]


@pytest.mark.parametrize("style", ["beanie", "cap", "brim", "helmet"])
def test_hats_cover_the_skull_but_not_the_face(default_body: Body, style: HatStyle) -> None:
    rng, hair = np.random.default_rng(2), Hair("short", 0.015)
    worn = Hat(style, 0.03 if style == "helmet" else 0.01, 0.08 if style in ("cap", "brim") else 0.0)
    bare = see(clothe(default_body, Clothes((), hair), rng).pose(REST_POSTURE), np.pi)
    person = clothe(default_body, Clothes((), hair, hat=worn), rng).pose(REST_POSTURE)
    front, back = see(person), see(person, np.pi)
    assert (back.material == Material.HAIR).sum() < 0.6 * (bare.material == Material.HAIR).sum()
    assert (front.material == Material.CLOTH).sum() > 40
    assert bare_share(front, "face") > 0.6
    # The label is the head's.
    assert np.isin(
        KINDS[back.labels[back.material == Material.CLOTH]], ("hair", "forehead", "background", "face")
    ).all()


def test_a_scarf_goes_round_the_neck_and_hangs_down(default_body: Body) -> None:
    def worn(*ends: float) -> Rendering:
        clothes = Clothes((), scarf=Scarf(0.035, (ends[0], ends[1])))
        return see(clothe(default_body, clothes, np.random.default_rng(0)).pose(REST_POSTURE))

    roll, left = worn(0.0, 0.0), worn(0.0, 0.5)
    assert bare_share(roll, "neck front") < 0.4
    added = (left.material == Material.CLOTH) & (roll.material != Material.CLOTH)
    assert added.sum() > 80
    assert set(KINDS[left.labels[added]]) >= {"chest", "belly"}
    assert np.nonzero(added)[1].mean() > 79  # on the subject's left


def test_a_shawl_covers_one_shoulder(default_body: Body) -> None:
    shawl = dataclasses.replace(random_garment(np.random.default_rng(0), "shawl"), one_shoulder=1.0)
    view = see(clothe(default_body, Clothes((shawl,)), np.random.default_rng(0)).pose(REST_POSTURE))
    shares = {}
    for side in "RL":
        chosen = np.array([name in (f"shoulder front {side}", f"collar {side}") for name in REGION_NAMES])[view.labels]
        shares[side] = (view.material[chosen] == Material.SKIN).mean()
    assert shares["L"] < 0.3 < 0.7 < shares["R"]


def test_hair_may_lie_before_the_shoulders(default_body: Body) -> None:
    counts = []
    for forward in (0.0, 1.0):
        clothes = Clothes((), Hair("long", 0.015, 0.45, 0.2, forward))
        view = see(clothe(default_body, clothes, np.random.default_rng(0)).pose(REST_POSTURE))
        on_chest = np.isin(KINDS[view.labels], ("chest", "collar", "shoulder front"))
        counts.append(int((on_chest & (view.material == Material.HAIR)).sum()))
    assert counts[1] > counts[0] + 15


@pytest.mark.parametrize("kind", ["jacket", "front", "trousers", "seat"])
def test_hands_go_into_pockets(default_body: Body, kind: PocketKind) -> None:
    rng, sides = np.random.default_rng(1), []
    others = np.setdiff1d(np.arange(len(POSTURE_BONES)), ARMS)
    for _ in range(12):
        posture, hands = hands_in_pockets(standing(), [kind], 0.01, rng)
        np.testing.assert_array_equal(posture[others], standing()[others])
        assert within_limits(posture[None])[0]
        posed = default_body.pose(posture)
        for hand in hands:
            sides.append(hand.side)
            wrist = posed.joints[default_body.model.joint_bones.tolist().index(
                default_body.model.bone_names.index(f"wrist.{hand.side}"))]  # fmt: skip
            hips = posed.joints.mean(0)
            assert np.linalg.norm(wrist - hips) < 0.45
            assert (wrist[1] > 0.02) == (kind == "seat") or kind in ("trousers", "jacket")
    assert len(sides) > 14 and {"R", "L"} == set(sides)


def test_hands_in_pockets_are_under_cloth(default_body: Body) -> None:
    rng = np.random.default_rng(3)
    trousers = random_garment(rng, "trousers")
    covered, seen = [], 0
    for family in ("puffer", "hoodie", "t-shirt"):
        dressed = clothe(default_body, Clothes((trousers, random_garment(rng, family))), rng)
        assert ("jacket" in find_pockets(dressed.clothes.garments)) == (family != "t-shirt")
        for _ in range(3):
            plain = dressed.pose(standing())
            person = pose_in_clothes(dressed, standing(), rng, 1.0)
            count = len(person.layers) - len(plain.layers)
            if count < 2:
                continue
            for azimuth in (0.0, 1.5, -1.5):
                view = see(person, azimuth)
                hand = KINDS[view.labels] == "hand"
                seen += int(hand.sum())
                covered.append((view.material[hand] != Material.SKIN).mean() if hand.sum() > 15 else np.nan)
    assert seen > 500
    assert np.nanmean(covered) > 0.8


def test_nobody_in_a_dress_has_pockets(default_body: Body) -> None:
    rng = np.random.default_rng(0)
    dressed = clothe(default_body, Clothes((random_garment(rng, "dress"),)), rng)
    person = pose_in_clothes(dressed, standing(), rng, 1.0)
    assert len(person.layers) == len(dressed.pose(standing()).layers)


def test_thick_sleeves_hold_hanging_arms_off_the_trunk(default_body: Body) -> None:
    apart = [
        np.abs(default_body.pose(hold_arms_off_trunk(standing(), bulk)).joints[:, 0]).max()
        for bulk in (0.0, 0.03, 0.06)
    ]
    assert apart[0] + 0.03 < apart[1] < apart[2] < apart[0] + 0.3
    raised = REST_POSTURE.copy()
    for side, sign in (("R", 1.0), ("L", -1.0)):
        raised[POSTURE_INDEX[f"upper_arm.{side}"]] = (0, sign * 0.8, 0)
    np.testing.assert_allclose(hold_arms_off_trunk(raised, 0.06), raised, atol=1e-9)


def test_outdoor_people_depend_on_the_seed_alone(default_body: Body) -> None:
    def person(seed: int) -> PosedPerson:
        rng = np.random.default_rng(seed)
        return pose_in_clothes(random_dressed_body(rng, "open", wardrobe="outdoors"), standing(), rng, 1.0)

    for a, b in zip(person(5).layers, person(5).layers, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
