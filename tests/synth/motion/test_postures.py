"""Where postures come from: the packaged prior and clips of motion capture."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import POSTURE_INDEX, heading, mirror_posture, world_rotations
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.mocap import Clip
from depthmocap.synth.motion.postures import (
    TRAINING_VARIATION,
    ClipPostures,
    PosturePrior,
    Variation,
    joint_positions,
    posture_source,
    thin_frames,
)

AS_RECORDED = Variation(mirror=0.0)


def angles(postures: np.ndarray, bone: str) -> np.ndarray:
    return np.linalg.norm(postures[:, POSTURE_INDEX[bone]], axis=-1)


def draw(source: PosturePrior | ClipPostures, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([source.sample(rng)[0] for _ in range(count)])


# The packaged prior


def test_prior_is_a_mixture() -> None:
    prior = PosturePrior.load()
    components = len(prior.weights)
    assert prior.weights.sum() == pytest.approx(1, abs=0.01)
    assert prior.simple_weights.sum() == pytest.approx(1, abs=0.01)
    assert prior.means.shape == (components, 60)
    assert prior.factors.shape[:2] == (components, 60)
    for array in (prior.weights, prior.simple_weights, prior.means, prior.factors):
        assert np.isfinite(array).all()
    assert (prior.weights >= 0).all()
    assert (prior.simple_weights >= 0).all()
    assert isinstance(posture_source(None, "train"), PosturePrior)


def test_prior_depends_on_the_generator_alone() -> None:
    pytest.importorskip("anny")
    prior = PosturePrior.load(variation=TRAINING_VARIATION)
    np.testing.assert_array_equal(draw(prior, 20, 5), draw(PosturePrior.load(variation=TRAINING_VARIATION), 20, 5))
    assert np.abs(draw(prior, 20, 5) - draw(prior, 20, 6)).max() > 0.1
    groups = {prior.sample(np.random.default_rng(seed))[1] for seed in range(60)}
    assert groups <= set(range(len(prior.weights)))
    assert len(groups) > 10


@pytest.mark.parametrize("simple", [False, True])
def test_prior_gives_plausible_bodies(default_body: Body, simple: bool) -> None:
    postures = draw(PosturePrior.load(simple=simple), 150)
    upright, reach = 0, []
    for posture in postures:
        joints = default_body.pose(posture).joints
        assert np.isfinite(joints).all()
        head, hip = joints[JOINT_INDEX["Head"]], joints[JOINT_INDEX["Hip"]]
        upright += bool(head[2] > hip[2] + 0.3)
        reach.append(np.ptp(joints, axis=0).max())
    assert upright > (0.97 if simple else 0.75) * len(postures)
    assert max(reach) < 2.2
    # No knee or elbow is bent the whole way round, and the spine's joints bend little.
    for bone, limit in (("shin.L", 2.9), ("forearm.R", 2.9), ("spine_mid", 1.2), ("head", 1.6), ("foot.L", 1.6)):
        assert np.quantile(angles(postures, bone), 0.99) < limit, bone


def test_prior_faces_every_way() -> None:
    directions = heading(draw(PosturePrior.load(), 400))
    counts, _ = np.histogram(np.mod(directions, 2 * np.pi), 4, (0, 2 * np.pi))
    assert counts.min() > 60


def test_simple_postures_differ() -> None:
    """Walking and running: arms below the shoulders, and less variety."""
    every, simple = (joint_positions(draw(PosturePrior.load(simple=flag), 300)) for flag in (False, True))

    def hands_up(ends: np.ndarray) -> float:
        hand, shoulder = ends[:, POSTURE_INDEX["hand.L"], 2], ends[:, POSTURE_INDEX["clavicle.L"], 2]
        return float((hand > shoulder).mean())

    assert hands_up(simple) < 0.5 * hands_up(every)
    assert simple[:, POSTURE_INDEX["hand.L"], 2].std() < every[:, POSTURE_INDEX["hand.L"], 2].std()


def test_noise_and_mirror() -> None:
    still, noisy, mirrored = (
        draw(PosturePrior.load(variation=variation), 1, 3)[0]
        for variation in (AS_RECORDED, Variation(0.0, noise_rad=0.05), Variation(mirror=1.0))
    )
    # The same component and latent, then 3 numbers a bone of noise.
    difference = (noisy - still)[1:]
    assert 0.03 < difference.std() < 0.07
    np.testing.assert_allclose(mirrored[1:], mirror_posture(still)[1:])


@pytest.mark.parametrize("content", ["empty", "text", "half", "array", "other archive", "not finite", "negative"])
def test_prior_file_errors(tmp_path: Path, content: str) -> None:
    path = tmp_path / "prior.npz"
    np.savez(path, weights=np.ones(2))
    whole = path.read_bytes()
    if content == "array":
        with path.open("wb") as handle:
            np.save(handle, np.ones(3))
    elif content in ("not finite", "negative"):
        value = np.nan if content == "not finite" else -1.0
        np.savez(
            path, weights=np.array([1, value]), simple_weights=np.ones(2), means=np.zeros((2, 60)),
            factors=np.zeros((2, 60, 3)),
        )  # fmt: skip
    elif content != "other archive":
        path.write_bytes({"empty": b"", "text": b"postures", "half": whole[: len(whole) // 2]}[content])
    with pytest.raises(InputError, match="is not a posture prior") as raised:
        PosturePrior.load(path)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"out": Path("prior.txt")}, r"--out must end in \.npz"),
        ({"components": 0}, "--components and --rank"),
        ({"seed": -1}, "--seed"),
    ],
)
def test_fits_that_cannot_be(options: dict[str, Any], message: str) -> None:
    pytest.importorskip("sklearn")
    from depthmocap.synth.motion.prior import PriorTraining

    with pytest.raises(InputError, match=message):
        PriorTraining(Path("clips"), **{"out": Path("prior.npz"), **options})


def test_fewer_postures_than_components(tmp_path: Path) -> None:
    pytest.importorskip("sklearn")
    from depthmocap.synth.motion.prior import PriorTraining, fit_prior

    clips = [Clip("still", np.zeros((5, 20, 3), np.float32), simple=False, split="train")]
    with pytest.raises(InputError, match="2 distinct postures are fewer than --components 48"):
        fit_prior(clips, PriorTraining(Path("clips"), tmp_path / "prior.npz"))
    assert not list(tmp_path.iterdir())


def test_prior_file_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a posture prior"):
        PosturePrior.load(tmp_path / "none.npz")


# Clips


def swinging_clip(name: str, seed: int, split: str = "train", simple: bool = False, frames: int = 60) -> Clip:
    """All bones swing smoothly, each its own way; the pelvis also turns round."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 3, frames)[:, None, None]
    postures = 0.5 * rng.normal(size=(20, 3)) * np.sin(time + rng.uniform(0, 6, (20, 3)))
    postures[:, 0] = np.array([0.0, 0, 1.0]) * time[:, :, 0]
    return Clip(name, postures.astype(np.float32), simple, split)


def test_thin_keeps_what_differs() -> None:
    postures = swinging_clip("a", 0, frames=200).postures
    kept = thin_frames(postures, 0.05)
    ends = joint_positions(postures)
    steps = np.abs(np.diff(ends[kept], axis=0)).max((1, 2))
    assert (steps > 0.05).all()
    assert kept[0] == 0
    assert 5 < len(kept) < 200
    # Every frame is near the one kept before it.
    last = kept[np.searchsorted(kept, np.arange(200), side="right") - 1]
    assert np.abs(ends - ends[last]).max() <= 0.05
    assert len(thin_frames(np.repeat(postures[:1], 9, 0), 0.05)) == 1
    assert len(thin_frames(postures[:0], 0.05)) == 0


def test_joint_positions_lie_at_typical_distances() -> None:
    ends = joint_positions(np.zeros((1, 20, 3)))[0]
    head, foot = ends[POSTURE_INDEX["head"]], ends[POSTURE_INDEX["foot.L"]]
    assert 1.4 < head[2] - foot[2] < 1.9
    left, right = ends[POSTURE_INDEX["hand.L"]], ends[POSTURE_INDEX["hand.R"]]
    assert left[0] > 0.3
    np.testing.assert_allclose(right, left * [-1, 1, 1])


def test_clip_postures() -> None:
    clips = [
        swinging_clip("a", 1),
        swinging_clip("b", 2),
        swinging_clip("c", 3, "test"),
        swinging_clip("d", 4, frames=0),
    ]
    source = ClipPostures(clips, "train", simple=False, variation=AS_RECORDED)
    assert source.names == ["a", "b"]
    assert len(source) == len(source.postures) == len(source.groups) < 120
    assert set(source.groups) == {0, 1}
    np.testing.assert_allclose(heading(source.postures), 0, atol=1e-5)
    rng = np.random.default_rng(0)
    for _ in range(20):
        posture, group = source.sample(rng)
        near = np.abs(source.postures[:, 1:] - posture[1:]).max((1, 2))
        assert near.min() < 1e-6
        assert source.groups[near.argmin()] == group
    np.testing.assert_array_equal(draw(source, 5, 1), draw(source, 5, 1))


def test_recombination_keeps_the_legs() -> None:
    clips = [swinging_clip("a", 1), swinging_clip("b", 2)]
    source = ClipPostures(clips, "train", False, Variation(mirror=0.0, recombine=1.0))
    legs = [POSTURE_INDEX[f"{part}.{side}"] for part in ("thigh", "shin", "foot") for side in "RL"]
    arms = [POSTURE_INDEX[f"{part}.{side}"] for part in ("upper_arm", "forearm", "hand") for side in "RL"]
    mixed = 0
    for posture in draw(source, 20):
        of_legs, of_arms = (np.abs(source.postures[:, part] - posture[part]).max((1, 2)) for part in (legs, arms))
        assert max(of_legs.min(), of_arms.min()) < 1e-6
        mixed += bool(of_legs.argmin() != of_arms.argmin())
    assert mixed > 10


def test_limbs_of_other_postures() -> None:
    clips = [swinging_clip("a", 1), swinging_clip("b", 2)]
    source = ClipPostures(clips, "train", False, Variation(mirror=0.0, limb=0.5))
    limbs = [
        [POSTURE_INDEX[f"{bone}.{side}"] for bone in bones]
        for bones in (("upper_arm", "forearm", "hand"), ("thigh", "shin", "foot"))
        for side in "RL"
    ]
    trunk = [i for i in range(1, 20) if not any(i in limb for limb in limbs)]
    postures = draw(source, 30)
    own = [np.abs(source.postures[:, trunk] - posture[trunk]).max((1, 2)).argmin() for posture in postures]
    changed = np.array(
        [
            [np.abs(source.postures[i][limb] - posture[limb]).max() > 1e-6 for limb in limbs]
            for i, posture in zip(own, postures, strict=True)
        ]
    )
    assert (changed.mean(0) > 0.2).all() and (changed.mean(0) < 0.8).all()  # each limb by itself
    for limb in limbs:
        assert all(np.abs(source.postures[:, limb] - posture[limb]).max((1, 2)).min() < 1e-6 for posture in postures)


def test_tilted_bodies() -> None:
    source = ClipPostures([swinging_clip("a", 1)], "train", False, Variation(mirror=0.0, tilt=1.0))
    up = world_rotations(draw(source, 200))[:, 0, :, 2]
    lean = np.degrees(np.arccos(up[:, 2]))  # these people stand upright as recorded
    assert np.quantile(lean, [0.1, 0.5, 0.9]) == pytest.approx([18, 90, 162], abs=15)
    assert np.abs(up.mean(0)[:2]).max() < 0.2  # to any side
    upright = ClipPostures([swinging_clip("a", 1)], "train", False, AS_RECORDED)
    assert world_rotations(draw(upright, 50))[:, 0, 2, 2].min() > 0.99


def test_a_share_of_postures_stays_as_recorded() -> None:
    varied = Variation(mirror=0.0, recombine=1.0, noise_rad=0.05, limb=1.0, tilt=1.0, sit=1.0, as_recorded=0.4)
    source = ClipPostures([swinging_clip("a", 1), swinging_clip("b", 2)], "train", False, varied)
    postures = draw(source, 200)
    # But for the heading, which is the pelvis's.
    off = np.abs(source.postures[None, :, 1:] - postures[:, None, 1:]).max((2, 3)).min(1)
    kept = off < 1e-6
    assert kept.mean() == pytest.approx(0.4, abs=0.1)
    assert off[~kept].min() > 0.02
    assert world_rotations(postures[kept])[:, 0, 2, 2].min() > 0.99
    prior = PosturePrior.load(variation=dataclasses.replace(varied, as_recorded=1.0))
    plain = PosturePrior.load(variation=dataclasses.replace(AS_RECORDED, as_recorded=1.0))
    for seed in range(5):
        ours, theirs = (each.sample(np.random.default_rng(seed))[0] for each in (prior, plain))
        np.testing.assert_array_equal(ours, theirs)


def test_walking_and_running_people_keep_their_limbs_and_stand() -> None:
    prior = posture_source(None, "train", simple=True, variation=TRAINING_VARIATION)
    assert isinstance(prior, PosturePrior)
    nothing = dict.fromkeys(("limb", "tilt", "sit", "touch", "beyond"), 0.0)
    assert prior.variation == dataclasses.replace(TRAINING_VARIATION, **nothing)


def test_simple_clips_alone() -> None:
    clips = [swinging_clip("a", 1), swinging_clip("walk", 2, simple=True)]
    assert ClipPostures(clips, "train", simple=True, variation=AS_RECORDED).names == ["walk"]


@pytest.mark.parametrize(
    ("split", "simple", "message"),
    [("valid", False, "no clips fall in the valid split"), ("train", True, "no walking or running clips")],
)
def test_no_clips_left(split: str, simple: bool, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ClipPostures([swinging_clip("a", 1)], split, simple, AS_RECORDED)


def test_fitted_prior_covers_its_clips(tmp_path: Path) -> None:
    pytest.importorskip("sklearn")
    from depthmocap.synth.motion.prior import PriorTraining, fit_prior

    clips = [swinging_clip("a", 1, simple=True), swinging_clip("b", 2), swinging_clip("c", 3, "test")]
    path = tmp_path / "prior.npz"
    fit_prior(clips, PriorTraining(tmp_path, path, components=4, rank=6))
    prior = PosturePrior.load(path, variation=AS_RECORDED)
    assert prior.factors.shape == (4, 60, 6)
    recorded = ClipPostures(clips, "train", False, AS_RECORDED).postures
    recorded = np.concatenate([recorded, mirror_posture(recorded)]).astype(np.float64)
    drawn = draw(prior, 60)
    drawn[:, 0] = 0
    recorded_ends, drawn_ends = joint_positions(recorded), joint_positions(drawn)
    spread = np.median(np.abs(recorded_ends[:, None] - recorded_ends[None]).max((2, 3)))
    nearest = np.abs(drawn_ends[:, None] - recorded_ends[None]).max((2, 3)).min(1)
    assert np.median(nearest) < 0.5 * spread
