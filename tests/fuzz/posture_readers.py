"""Clips of motion capture, and the postures that are made of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from reader import Reader


def _pool(folder: Path) -> None:
    from depthmocap.synth.motion.pool import PosturePool

    rng, n = np.random.default_rng(0), 6
    kinds = np.zeros(n, np.uint8)
    postures, clips = rng.normal(0, 0.3, (n, 20, 3)).astype(np.float32), np.arange(n) % 2
    PosturePool(postures, clips, kinds, kinds > 0, kinds, ("a", "b"), {"read": 2}).save(folder / "pool.npz")


def _read_pool(folder: Path) -> None:
    from depthmocap.synth.motion.pool import PosturePool

    pool = PosturePool.load(folder / "pool.npz")
    assert pool.select("train", False).shape == (len(pool),) or len(pool)


def _prior(folder: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {
        "weights": np.full(3, 1 / 3), "simple_weights": np.full(3, 1 / 3), "means": rng.normal(0, 0.1, (3, 60)),
        "factors": rng.normal(0, 0.1, (3, 60, 2)),
    }  # fmt: skip
    np.savez_compressed(folder / "prior.npz", **{name: array.astype(np.float16) for name, array in arrays.items()})


def _read_prior(folder: Path) -> None:
    from depthmocap.synth.motion.postures import PosturePrior

    PosturePrior.load(folder / "prior.npz").sample(np.random.default_rng(0))


def _clips(*names: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        from clip_files import POSE, amc_text, asf_text, skeleton, write_bvh

        frames = [{}, POSE, {}]
        texts = {
            "07.asf": asf_text(), "07_01.amc": amc_text(frames),
            "manifest.csv": "file,description,fps\nwalk.bvh,walk,\n07_01.amc,\"run, jump\",60\n",
            "mapping.json": json.dumps({"pelvis": "mixamorig:Hips", "head": "mixamorig:Head"}),
        }  # fmt: skip
        for name in names:
            if name in texts:
                (folder / name).write_text(texts[name])
        write_bvh(folder / "walk.bvh", skeleton("mixamo"), frames)

    return make


class _Rest(dict[str, np.ndarray]):
    """Bones of a body at rest, without making the body: every one is somewhere."""

    def __missing__(self, bone: str) -> np.ndarray:
        return np.array([0.1 * (len(bone) % 7), 0.02 * len(bone), 0.1 * (sum(bone.encode()) % 11)])


def _read_clips(folder: Path) -> None:
    from depthmocap.synth.motion.clips.skeletons import read_mapping
    from depthmocap.synth.motion.mocap import ClipFolder, ClipReading

    mapping = read_mapping(folder / "mapping.json") if (folder / "mapping.json").exists() else {}
    list(ClipFolder.open(folder, ClipReading(mapping)).read(_Rest()))


def _read_bvh_joints(folder: Path) -> None:
    from depthmocap.datasets.bvh_joints import read_bvh_joints

    read_bvh_joints(folder / "walk.bvh").positions()


_AMC = ("07.asf", "07_01.amc")
POSTURES: dict[str, Reader] = {
    "pool": Reader(_pool, _read_pool),
    "prior": Reader(_prior, _read_prior),
    "bvh": Reader(_clips(), _read_clips, needs=("bvhio",)),
    "bvh joints": Reader(_clips(), _read_bvh_joints),
    "amc": Reader(_clips(*_AMC), _read_clips, _AMC, ("bvhio",)),
    "manifest": Reader(_clips(*_AMC, "manifest.csv", "mapping.json"), _read_clips, ("manifest", "mapping"), ("bvhio",)),
}
