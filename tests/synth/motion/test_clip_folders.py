"""Folders of clips with bad ones in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clip_files import POSE, amc_text, check_pose, heads, skeleton, write_bvh

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.mocap import Clip, ClipFolder, ClipReading, SkippedClip, read_bvh
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
        "no_trunk.bvh": "numerics", "unknown.bvh": "--mapping", "bytes.bvh": "is not text",
        "no_offset.bvh": "skeleton has a number that is not finite", "folder.bvh": "it is a folder, not a file",
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
    """A knee bent forwards says that a frame is wrong; a head, hand or foot turned right round that it alone is."""
    still = [{}] * 3
    bad = [{"foot.L": (0, 170, 0)}, {"shin.R": (-60, 0, 0)}, {"head": (0, 170, 0)}]
    for i, frame in enumerate(bad):
        write_bvh(tmp_path / f"{i}.bvh", skeleton("mixamo"), [frame] * 3)
    write_bvh(tmp_path / "good.bvh", skeleton("mixamo"), still)
    clips = {clip.name: clip for clip in load_clips(tmp_path)}
    counts = {name: (len(clip.postures), clip.impossible) for name, clip in clips.items()}
    assert counts == {"0": (3, 0), "1": (0, 3), "2": (3, 0), "good": (3, 0)}
    for name, bone in (("0", "foot.L"), ("2", "head")):
        assert not clips[name].postures[:, POSTURE_INDEX[bone]].any()


def test_one_twisted_hand_costs_itself_alone(tmp_path: Path, default_body: Body) -> None:
    frames = [{"thigh.L": (-i, 0, 0), **({"hand.R": (0, 178, 0)} if i == 10 else {})} for i in range(20)]
    write_bvh(tmp_path / "clip.bvh", skeleton("mixamo"), frames)
    (clip,) = load_clips(tmp_path)
    assert (len(clip.postures), clip.flipped, clip.impossible) == (20, 0, 0)


def test_kicks_are_no_flips(tmp_path: Path, default_body: Body) -> None:
    """A shin that turns by 65 degrees in a thirtieth of a second, and fast before and afterwards; one that jumps."""
    kick = [0, 5, 20, 55, 110, 62, 30, 10, 0, 0, 0, 0]
    jump = [0, 1, 2, 3, 4, 70, 71, 72, 73, 74, 75, 76]
    for name, angles in (("kick", kick), ("jump", jump)):
        write_bvh(tmp_path / f"{name}.bvh", skeleton("mixamo"), [{"shin.R": (angle, 0, 0)} for angle in angles])
    flipped = {clip.name: clip.flipped for clip in load_clips(tmp_path)}
    assert flipped["kick"] == 0 and flipped["jump"] > 0


def test_an_end_that_cannot_be_is_no_end(tmp_path: Path, default_body: Body) -> None:
    path = tmp_path / "clip.bvh"
    for tip in ("nan", "1e30"):
        write_bvh(path, skeleton("mixamo"), [{}, POSE], spoil=f"OFFSET 9.0 0 0=>OFFSET {tip} 0 0")
        assert tip in path.read_text()
        check_pose(default_body, read_bvh(path, heads(default_body))[0])


#: Who walks, or stands, in a world whose up is Z, on a skeleton that stands along Y at rest; who walks, or lies, in a
#: world whose up is Y as that of the rest pose.
WORLDS = {
    "z, walking": ([{"hips": (90, 0, 0), "at": (4.0 * i, 60, 95)} for i in range(30)], "z", False),
    "z, in place": ([{"hips": (90, 0, 0), "at": (0, 0, 95 + 0.1 * i)} for i in range(30)], "z", False),
    "y, walking": ([{"at": (4.0 * i, 95, 30)} for i in range(30)], None, False),
    "y, lying": ([{"hips": (90, 0, 0), "at": (0, 14, 95 + 0.1 * i)} for i in range(30)], None, True),
}


@pytest.mark.parametrize("world", WORLDS)
def test_which_way_is_up(tmp_path: Path, default_body: Body, world: str) -> None:
    frames, up, lies = WORLDS[world]
    write_bvh(tmp_path / "clip.bvh", skeleton("mixamo"), frames)
    (clip,) = load_clips(tmp_path)
    assert (clip.up, clip.lies) == (up, lies)
    joints = default_body.pose(clip.postures[0].astype(np.float64)).joints
    trunk = joints[JOINT_INDEX["Neck"]] - joints[JOINT_INDEX["Hip"]]
    assert (trunk[2] > 0.9 * np.linalg.norm(trunk)) != lies
    # What is told decides.
    told = ClipFolder.open(tmp_path, ClipReading(up="z" if lies else "y"))
    (clip,) = told.read(heads(default_body))
    assert isinstance(clip, Clip)
    assert clip.lies == (world.startswith("z"))
