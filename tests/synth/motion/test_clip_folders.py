"""Folders of clips with bad ones in them."""

from __future__ import annotations

from pathlib import Path

import pytest
from clip_files import amc_text, heads, skeleton, write_bvh

from depthmocap.body.model import Body
from depthmocap.errors import InputError
from depthmocap.synth.motion.mocap import Clip, ClipFolder, SkippedClip
from depthmocap.synth.motion.postures import load_clips

pytest.importorskip("bvhio")


def test_bad_clips_are_skipped_and_counted(tmp_path: Path, default_body: Body) -> None:
    joints = skeleton("mixamo")
    write_bvh(tmp_path / "good.bvh", joints, [{}] * 3)
    spoils = {
        "nan": "0.000000=>nan",
        "no_length": "OFFSET 28.0 0.0 0.0=>OFFSET 0 0 0",
        "no_frames": "Frames: 3=>Frames: 30",
        "no_trunk": "OFFSET 0.0=>OFFSET x",
        "no_offset": "OFFSET 28.0=>OFFSET nan",
    }
    for name, spoil in spoils.items():
        write_bvh(tmp_path / f"{name}.bvh", joints, [{}] * 3, spoil)
    unknown = [(key, f"j{i}", parent, offset) for i, (key, _, parent, offset) in enumerate(joints)]
    write_bvh(tmp_path / "unknown.bvh", unknown, [{}])
    (tmp_path / "bytes.bvh").write_bytes(bytes(range(256)))
    (tmp_path / "folder.bvh").mkdir()
    (tmp_path / "08_01.amc").write_text(amc_text([{}]))
    (tmp_path / "good.amc").write_text("")
    results = list(ClipFolder.open(tmp_path).read(heads(default_body)))
    clips = [result for result in results if isinstance(result, Clip)]
    skipped = {result.name: result.reason for result in results if isinstance(result, SkippedClip)}
    assert [clip.name for clip in clips] == ["good"]
    assert len(clips[0].postures) == clips[0].frames == 3
    assert clips[0].skeleton.startswith("mixamo: pelvis=mixamorig:Hips")
    reasons = {
        "nan.bvh": "not finite", "no_length.bvh": "has no length", "no_frames.bvh": "3 of its 30 frames",
        "no_trunk.bvh": "numerics", "unknown.bvh": "--mapping", "bytes.bvh": "it is not text",
        "no_offset.bvh": "skeleton has a number that is not finite", "folder.bvh": "BVH file: Is a directory",
        "08_01.amc": "08.asf is missing", "good.amc": "of this name",
    }  # fmt: skip
    assert set(skipped) == set(reasons)
    for name, reason in reasons.items():
        assert reason in skipped[name], name
        assert "\n" not in skipped[name]
        assert str(tmp_path) not in skipped[name]
    (tmp_path / "good.bvh").unlink()
    with pytest.raises(InputError, match=r"none of its 10 clips is readable; 08_01\.amc"):
        load_clips(tmp_path)


@pytest.mark.parametrize(
    ("words", "simple"),
    [("Slow walk/stride", True), ("jogging", True), ("run, jump", True), ("crunches", False), ("trunk twist", False)],
)
def test_which_descriptions_are_easy(tmp_path: Path, default_body: Body, words: str, simple: bool) -> None:
    write_bvh(tmp_path / "a.bvh", skeleton("mixamo"), [{}])
    (tmp_path / "manifest.csv").write_text(f'file,description\na.bvh,"{words}"\n')
    (clip,) = load_clips(tmp_path)
    assert clip.simple is simple


def test_impossible_frames_are_left_out(tmp_path: Path, default_body: Body) -> None:
    """A foot turned backwards, a knee bent forwards, a head turned right round."""
    still = [{}] * 3
    bad = [{"foot.L": (0, 170, 0)}, {"shin.R": (-60, 0, 0)}, {"head": (0, 170, 0)}]
    for i, frame in enumerate(bad):
        write_bvh(tmp_path / f"{i}.bvh", skeleton("mixamo"), [frame] * 3)
    write_bvh(tmp_path / "good.bvh", skeleton("mixamo"), still)
    counts = {clip.name: (len(clip.postures), clip.impossible) for clip in load_clips(tmp_path)}
    assert counts == {"0": (0, 3), "1": (0, 3), "2": (0, 3), "good": (3, 0)}
