"""Pools of dissimilar postures: the cover, farthest-point picking, joint limits, the file, and the command."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.synth.body.bones import POSTURE_INDEX, heading, mirror_posture
from depthmocap.synth.motion import pool_build
from depthmocap.synth.motion.cover import Cover, farthest_points
from depthmocap.synth.motion.limits import LIMITS_DEG, bone_axis, swing_twist, within_limits
from depthmocap.synth.motion.mocap import SPLITS, Clip, ClipFolder, SkippedClip, split_of, without_heading
from depthmocap.synth.motion.pool import KINDS, PosturePool
from depthmocap.synth.motion.pool_build import PoolBuild, build_pool
from depthmocap.synth.motion.postures import UPPER_BONES, ClipPostures, Variation, joint_positions, posture_source
from depthmocap.synth.motion.prior_report import (
    PostureReport,
    compare_sources,
    distances_to_nearest,
    is_penetrating,
    report_postures,
)


def random_postures(count: int, seed: int = 0, size: float = 0.3) -> np.ndarray:
    postures = np.random.default_rng(seed).normal(0, size, (count, 20, 3)).astype(np.float32)
    postures[:, 0] = 0
    return postures


def distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a[:, None] - b[None], axis=-1).max(-1)


# Limits


def test_swing_and_twist_of_known_turns() -> None:
    postures = np.zeros((3, 20, 3))
    shin, arm = POSTURE_INDEX["shin.L"], POSTURE_INDEX["upper_arm.R"]
    postures[0, shin] = [1.2, 0, 0]
    postures[1, shin] = [0, 0, -0.7]
    axis = bone_axis("upper_arm.R")
    postures[2, arm] = 0.9 * axis / np.linalg.norm(axis)
    swing, twist = swing_twist(postures)
    np.testing.assert_allclose(swing[:, shin], [1.2, 0, 0], atol=1e-6)
    np.testing.assert_allclose(twist[:, shin], [0, 0.7, 0], atol=1e-6)
    np.testing.assert_allclose([swing[2, arm], twist[2, arm]], [0, 0.9], atol=1e-6)


@pytest.mark.parametrize("kind", LIMITS_DEG)
def test_limits_hold_on_both_sides_and_in_the_mirror(kind: str) -> None:
    for bone in (name for name in POSTURE_INDEX if name.partition(".")[0] == kind):
        axis = bone_axis(bone) / np.linalg.norm(bone_axis(bone))
        across = np.cross(axis, [0, 1, 0] if kind in ("shin", "thigh") else [1, 0.3, 0])
        across /= np.linalg.norm(across)
        across *= -1 if across[0] < 0 else 1  # a knee bends one way
        for direction, most in zip((across, axis), LIMITS_DEG[kind], strict=True):
            for factor, good in ((0.97, True), (1.03, False)):
                posture = np.zeros((1, 20, 3))
                posture[0, POSTURE_INDEX[bone]] = direction * np.deg2rad(most) * factor
                assert within_limits(posture)[0] == good, (bone, most, factor)
                assert within_limits(mirror_posture(posture))[0] == good, (bone, most, factor)


# Cover


@pytest.mark.slow
def test_a_cover_keeps_what_is_distinct_and_nothing_else() -> None:
    postures = random_postures(1500, size=0.08)
    cover = Cover(0.15, 1500)
    kept = sum(cover.add(part, np.arange(len(part))) for part in np.array_split(postures, 7))
    assert kept == cover.count
    assert 20 < cover.count < 1250
    assert cover.radius_m == 0.15
    among = distances(cover.ends, cover.ends)
    np.fill_diagonal(among, np.inf)
    assert among.min() > 0.15
    assert distances_to_nearest(joint_positions(postures).astype(np.float32), cover.ends).max() <= 0.15 + 1e-6


def test_a_full_cover_grows_its_radius() -> None:
    postures = random_postures(1500)
    cover = Cover(0.01, 200)
    for part in np.array_split(postures, 5):
        cover.add(part, np.zeros(len(part), dtype=np.int64))
        assert cover.count <= 200
    assert cover.radius_m > 0.05
    among = distances(cover.ends, cover.ends)
    np.fill_diagonal(among, np.inf)
    assert among.min() > cover.radius_m
    np.testing.assert_allclose(cover.ends, joint_positions(cover.postures), atol=1e-5)


def test_headings_do_not_make_postures_distinct() -> None:
    cover = Cover(0.05, 100)
    postures = np.zeros((50, 20, 3), np.float32)
    postures[:, 0, 2] = np.linspace(-3, 3, 50)
    assert cover.add(postures, np.arange(50)) == 1


def test_farthest_points_are_the_greedy_ones() -> None:
    ends = joint_positions(random_postures(300)).astype(np.float32)
    allowed = np.arange(300) % 3 == 0
    picks, left = farthest_points(ends, [(allowed, 20), (np.ones(300, dtype=bool), 60)])
    assert len(set(picks)) == 60
    assert allowed[picks[:20]].all()
    for n in range(1, 60):
        to_picks = distances(ends, ends[picks[:n]]).min(1)
        candidates = to_picks[allowed] if n < 20 else to_picks
        assert to_picks[picks[n]] == pytest.approx(candidates.max(), abs=1e-5)
    assert left == pytest.approx(distances(ends, ends[picks]).min(1).max(), abs=1e-5)
    everything, left = farthest_points(ends, [(np.ones(300, dtype=bool), 1000)])
    assert sorted(everything) == list(range(300))
    assert left == 0


# The file


def small_pool(count: int = 60) -> PosturePool:
    rng = np.random.default_rng(1)
    return PosturePool(
        random_postures(count, size=1.0).clip(-np.pi, np.pi),
        rng.integers(3, size=count).astype(np.int32),
        (np.arange(count) % 3).astype(np.uint8),
        np.arange(count) % 2 == 0,
        rng.integers(len(KINDS), size=count).astype(np.uint8),
        ("a", "b", "ç"),
        {"seed": 3},
    )


def test_a_pool_comes_back_from_its_file(tmp_path: Path) -> None:
    pool, path = small_pool(), tmp_path / "pool.npz"
    pool.save(path)
    read = PosturePool.load(path)
    assert np.rad2deg(np.abs(read.postures - pool.postures).max()) < 0.01
    for field in ("clips", "splits", "simple", "kinds"):
        np.testing.assert_array_equal(getattr(read, field), getattr(pool, field))
    assert (read.clip_names, read.report) == (pool.clip_names, pool.report)
    assert os.listdir(tmp_path) == ["pool.npz"]  # noqa: PTH208


def test_pool_as_a_source_of_postures(tmp_path: Path) -> None:
    pool, path = small_pool(), tmp_path / "pool.npz"
    pool.save(path)
    source = posture_source(path, "valid", simple=True, variation=Variation(mirror=0.0))
    assert isinstance(source, ClipPostures)
    mine = (pool.splits == 1) & pool.simple
    assert len(source) == mine.sum()
    rng = np.random.default_rng(0)
    for _ in range(20):
        posture, group = source.sample(rng)
        difference = np.abs(pool.postures[:, 1:] - posture[1:]).max((1, 2))
        assert difference.min() < 1e-3
        assert mine[difference.argmin()]
        assert source.names[group] == pool.clip_names[pool.clips[difference.argmin()]]
    empty = dataclasses.replace(pool, splits=np.zeros(len(pool), np.uint8))
    empty.save(path)
    with pytest.raises(InputError, match="no walking or running postures of the test split"):
        posture_source(path, "test", simple=True)


@pytest.mark.parametrize(
    "content", ["empty", "text", "half", "array", "other archive", "other version", "torn", "flat", "deep", "report"]
)
def test_damaged_and_foreign_files(tmp_path: Path, content: str) -> None:
    path = tmp_path / "pool.npz"
    small_pool().save(path)
    whole = path.read_bytes()
    if content == "array":
        with path.open("wb") as handle:
            np.save(handle, np.ones(3))
    elif content == "other archive":
        np.savez(path, weights=np.ones(2))
    elif content in ("other version", "torn", "flat", "deep", "report"):
        with np.load(path) as data:
            arrays = dict(data)
        arrays |= {
            "other version": {"format": np.array("depthmocap posture pool 9")},
            "torn": {"clips": arrays["clips"][:-1]},
            "flat": {"postures": np.int16(3)},
            "deep": {"report": np.array(9999 * "[")},
            "report": {"report": np.array("[1]")},
        }[content]
        np.savez(path, **arrays)
    else:
        path.write_bytes({"empty": b"", "text": b"postures", "half": whole[: len(whole) // 2]}[content])
    with pytest.raises(InputError, match=r"pool\.npz is not a readable posture pool.*postures build") as raised:
        posture_source(path, "train")
    assert "pickle" not in str(raised.value)
    with pytest.raises(InputError, match=r"none\.npz does not exist: --postures is a folder"):
        posture_source(tmp_path / "none.npz", "train")


# The command

NAMES = {"train": ("02_01", "86_03", "143_22"), "test": ("05_01",)}


def clip(name: str, seed: int, simple: bool, frames: int = 80) -> Clip:
    """Small swings of all bones about a posture of the clip's own."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 3, frames)[:, None, None]
    postures = rng.normal(0, 0.12, (20, 3)) + rng.normal(0, 0.25, (20, 3)) * np.sin(time + rng.uniform(0, 6, (20, 3)))
    postures[:, [POSTURE_INDEX["shin.L"], POSTURE_INDEX["shin.R"]], 0] += 1
    return Clip(name, postures.astype(np.float32), simple, split_of(name), frames=frames, skeleton="cmu: pelvis=Hips")


class FakeFolder:
    """A folder of four readable clips, one of them walking, and one that is not."""

    results: tuple[Clip | SkippedClip, ...] = (
        *(clip(name, i, simple=name == "86_03") for i, name in enumerate(NAMES["train"] + NAMES["test"])),
        SkippedClip("bad.bvh", "it is cut off"),
    )

    def __len__(self) -> int:
        return len(self.results)

    def read(self, _: object) -> list[Clip | SkippedClip]:
        return list(self.results)


@pytest.fixture
def clips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ClipFolder, "open", lambda *_: FakeFolder())
    monkeypatch.setattr(pool_build, "anny_rest", dict)


def build(out: Path, **options: Any) -> PosturePool:
    build_pool(PoolBuild(Path("clips"), out, **options))
    return PosturePool.load(out)


def recorded_of(split: str) -> np.ndarray:
    return np.concatenate([c.postures for c in FakeFolder.results if isinstance(c, Clip) and c.split == split])


def legs_from(postures: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """Distance of every posture's legs to those of the nearest recorded frame."""
    legs = [i for i in range(1, 20) if i not in UPPER_BONES]
    return np.abs(postures[:, None, legs] - recorded[None][:, :, legs]).max((2, 3)).min(1)


@pytest.mark.usefixtures("clips")
def test_few_postures_are_the_most_dissimilar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pool = build(tmp_path / "pool.npz", count=40, spacing_m=0.02)
    counts = {split: int((pool.splits == i).sum()) for i, split in enumerate(SPLITS)}
    assert counts == {"train": 32, "valid": 0, "test": 4}
    assert (pool.kinds == 0).all()
    np.testing.assert_allclose(heading(pool.postures), 0, atol=1e-3)
    ends = joint_positions(pool.postures[pool.splits == 0]).astype(np.float32)
    among = distances(ends, ends)
    np.fill_diagonal(among, np.inf)
    stop = pool.report["distances_m"]["train"]["stop"]
    assert among.min() >= stop - 1e-3
    reach = distances_to_nearest(joint_positions(without_heading(recorded_of("train"))).astype(np.float32), ends).max()
    assert reach <= stop + 0.02 + 1e-3
    printed = capsys.readouterr().out
    assert "skipped bad.bvh: it is cut off" in printed
    assert "valid: 0 of 4 postures: no clip falls in it" in printed


@pytest.mark.usefixtures("clips")
def test_many_postures_are_made_up_within_split_and_limits(tmp_path: Path) -> None:
    pool = build(tmp_path / "pool.npz", count=700, spacing_m=0.1)
    assert pool.report["counts"]["train"] == {
        "postures": int((pool.splits == 0).sum()),
        "easy": int(((pool.splits == 0) & pool.simple).sum()),
        **{kind: int(((pool.splits == 0) & (pool.kinds == k)).sum()) for k, kind in enumerate(KINDS)},
    }
    assert (pool.splits == 0).sum() == 560
    assert set(pool.kinds[pool.splits == 0]) == {0, 1, 2, 3}
    made = pool.kinds > 0
    assert within_limits(pool.postures[made]).all()
    for split in ("train", "test"):
        mine = pool.splits == SPLITS.index(split)
        names = {pool.clip_names[i] for i in pool.clips[mine]}
        assert names <= set(NAMES[split])
        ends = joint_positions(pool.postures[mine]).astype(np.float32)
        among = distances(ends, ends)
        np.fill_diagonal(among, np.inf)
        assert among.min() > 0.098
        # Recombined: the legs of a recorded frame of this very split.
        recombined = pool.postures[mine & (pool.kinds == KINDS.index("recombined"))]
        assert len(recombined) > 10
        assert legs_from(recombined, recorded_of(split)).max() < 1e-3
        mirrored = pool.postures[mine & (pool.kinds == KINDS.index("mirrored"))]
        assert legs_from(mirror_posture(mirrored), recorded_of(split)).max() < 1e-3
    # What is easy comes from walking alone.
    assert {pool.clip_names[i] for i in pool.clips[pool.simple]} == {"86_03"}


@pytest.mark.usefixtures("clips")
def test_easy_postures_are_as_many_as_asked_for(tmp_path: Path) -> None:
    few = build(tmp_path / "a.npz", count=60, easy=30, spacing_m=0.03)
    train = few.splits == 0
    assert (train & few.simple).sum() >= 24
    assert train.sum() == 48
    many = build(tmp_path / "b.npz", count=1200, easy=1000, spacing_m=0.06)
    train = many.splits == 0
    assert (train & many.simple).sum() >= 800
    assert train.sum() == 960


@pytest.mark.usefixtures("clips")
def test_a_pool_depends_on_its_settings_alone(tmp_path: Path) -> None:
    pools = [build(tmp_path / f"{i}.npz", count=900, seed=seed) for i, seed in enumerate((4, 4, 5))]
    np.testing.assert_array_equal(pools[0].postures, pools[1].postures)
    assert pools[0].postures.shape != pools[2].postures.shape or np.abs(pools[0].postures - pools[2].postures).max() > 0
    without = build(tmp_path / "w.npz", count=900, fill=False)
    assert (without.kinds == 0).all()
    assert len(without) < len(pools[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "--count"),
        ({"easy": 10, "count": 5}, "--easy"),
        ({"shares": (0.5, 0.5, 0.5)}, "--shares"),
        ({"shares": (float("nan"), 0.5, 0.5)}, "--shares"),
        ({"spacing_m": 0.0}, "--spacing-m"),
        ({"noise_rad": float("nan")}, "--noise-rad"),
        ({"seed": -1}, "--seed must be at least 0"),
        ({"out": Path("pool.pkl")}, r"\.npz"),
        ({"preset": "paper", "count": 50}, "--preset paper tells --count"),
        ({"preset": "paper", "easy": 5}, "--preset paper tells --count and --easy"),
    ],
)
def test_impossible_settings(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        PoolBuild(Path("clips"), **{"out": Path("pool.npz"), **options})


def test_the_papers_sizes() -> None:
    settings = PoolBuild(Path("clips"), Path("pool.npz"), preset="paper")
    assert (settings.count, settings.easy) == (100_000, 10_000)


@pytest.mark.usefixtures("clips")
def test_a_file_that_cannot_be_written_is_told_before_clips_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FakeFolder, "read", None)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot write .*file: "):
        build(tmp_path / "file" / "pool.npz")
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(InputError, match=r"--out must be a file that ends in \.npz"):
        build(tmp_path / "folder.npz")


@pytest.mark.usefixtures("clips")
def test_no_clip_is_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeFolder, "results", (SkippedClip("bad.bvh", "it is cut off"),))
    with pytest.raises(InputError, match=r"none of its 1 clips is readable; bad\.bvh: it is cut off"):
        build(tmp_path / "pool.npz")
    assert not list(tmp_path.iterdir())


# The report of the prior


def test_penetration_of_known_postures() -> None:
    pytest.importorskip("anny")
    postures = np.zeros((3, 20, 3))
    postures[1, POSTURE_INDEX["upper_arm.L"]] = [0, 1.6, 0]  # the arm swung inwards through the trunk
    postures[2, POSTURE_INDEX["thigh.L"]] = [0, 0.2, 0]  # both legs crossed into one another
    postures[2, POSTURE_INDEX["thigh.R"]] = [0, -0.2, 0]
    assert is_penetrating(postures)[0] == np.False_
    np.testing.assert_array_equal(is_penetrating(postures), [False, True, True])


def test_report_tells_near_from_far(default_body: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Held-out clips that repeat the training clips are near to them; the prior is another thing."""
    train = clip("02_01", 1, simple=False)
    clips = [train, dataclasses.replace(train, name="05_01", split="test")]
    settings = PostureReport(Path("clips"), samples=60, json=tmp_path / "report.json")
    rows = compare_sources(clips, False, settings)
    assert rows["training clips"]["to_held_out_m"]["p10"] < 0.01  # half are mirrored
    assert rows["prior"]["to_held_out_m"]["p50"] > 0.1
    assert rows["training clips, varied"]["to_held_out_m"]["p50"] > rows["training clips"]["to_held_out_m"]["p50"]
    assert rows["held-out clips"]["within_limits"] == pytest.approx(within_limits(train.postures).mean(), abs=0.05)
    monkeypatch.setattr("depthmocap.synth.motion.prior_report.load_clips", lambda _: clips)
    assert report_postures(settings)["all"]["prior"] == rows["prior"]
    assert settings.json is not None
    assert settings.json.exists()
    with pytest.raises(InputError, match="valid or test split"):
        compare_sources(clips[:1], False, settings)
