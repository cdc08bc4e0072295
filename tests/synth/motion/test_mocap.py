"""Motion capture files: postures of BVH files in three naming schemes, against the files' own joint positions."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import heading, turn_posture
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.mocap import SPLITS, read_bvh, split_of, without_heading
from depthmocap.synth.motion.postures import load_clips

pytest.importorskip("bvhio")
#: BVH files have Y up and face +Z; the body has Z up and faces −Y.
BODY_FROM_BVH = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
#: Where the limbs of our body begin and end, and the joints of a file that should lie in the same direction.
LIMBS = {
    ("{}Shoulder", "{}Elbow"): ("upper arm", "forearm"),
    ("{}Elbow", "{}Hand"): ("forearm", "hand"),
    ("{}Hip", "{}Knee"): ("thigh", "shin"),
    ("{}Knee", "{}Foot"): ("shin", "foot"),
}
LEFT = np.array([1.0, 0, 0])


@dataclasses.dataclass(frozen=True)
class Joint:
    """One joint of a BVH skeleton; ``key`` is what this test calls it."""

    key: str
    name: str
    parent: str | None
    offset: tuple[float, float, float]


def skeleton(scheme: str, arms: str) -> list[Joint]:
    """A skeleton of a naming scheme, in centimetres, its arms stretched out ("T") or hanging ("down") at rest."""
    joints: list[Joint] = []

    def add(key: str, name: str, parent: str | None, offset: Sequence[float] | np.ndarray) -> None:
        x, y, z = offset
        joints.append(Joint(key, name, parent, (x, y, z)))

    trunk = {
        "cmu": ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"),
        "daz": ("hip", "abdomen", "chest", "neck", "head"),
        "motionbuilder": ("Hips", "lowerback", "Chest", "Chest2", "Neck", "Head"),
    }[scheme]
    for i, name in enumerate(trunk):
        add("pelvis" if i == 0 else name, name, joints[-1].key if i else None, (0, 10 if i else 90, 0))
    chest = {"cmu": "Spine1", "daz": "chest", "motionbuilder": "Chest2"}[scheme]
    arm_names, leg_names = {
        "cmu": (("Shoulder", "Arm", "ForeArm", "Hand", "FingerBase"), ("UpLeg", "Leg", "Foot", "ToeBase")),
        "daz": (("Collar", "Shldr", "ForeArm", "Hand", "Mid1"), ("Thigh", "Shin", "Foot", "Toe")),
        "motionbuilder": (("Collar", "Shoulder", "Elbow", "Wrist", "Mid"), ("Hip", "Knee", "Ankle", "Toe")),
    }[scheme]
    for side, sign in (("R", -1), ("L", 1)):
        word = {"R": "r", "L": "l"}[side] if scheme == "daz" else {"R": "Right", "L": "Left"}[side]
        along = np.array([sign, 0, 0]) if arms == "T" else np.array([0, -1, 0])
        offsets = ([sign * 4, 8, 0], [sign * 12, 2, 0], along * 28, along * 25, along * 9)
        parent = chest
        for part, name, offset in zip(
            ("collar", "upper arm", "forearm", "hand", "finger"), arm_names, offsets, strict=True
        ):
            add(f"{part} {side}", word + name, parent, offset)
            parent = f"{part} {side}"
        parent = "pelvis"
        if scheme == "cmu":  # its hips have a joint of no length before the thigh
            add(f"hip {side}", f"{side}HipJoint", parent, (0, 0, 0))
            parent = f"hip {side}"
        offsets = ([sign * 9, -6, 0], [sign * 2, -42, 1], [0, -41, -2], [0, -6, 14])
        for part, name, offset in zip(("thigh", "shin", "foot", "toe"), leg_names, offsets, strict=True):
            add(f"{part} {side}", word + name, parent, offset)
            parent = f"{part} {side}"
    return joints


Frame = dict[str, tuple[float, float, float]]


def write(path: Path, joints: list[Joint], frames: list[Frame], order: str = "ZXY", frame_time: float = 1 / 30) -> None:
    """A BVH file; a frame gives Euler angles (degrees, in ``order``) by joint key, 0 where it has none."""
    lines = ["HIERARCHY"]
    written: list[str] = []

    def joint_lines(joint: Joint, depth: int) -> None:
        pad = "  " * depth
        rotations = " ".join(f"{axis}rotation" for axis in order)
        lines.append(f"{pad}{'JOINT' if depth else 'ROOT'} {joint.name}\n{pad}{{")
        lines.append(f"{pad}  OFFSET {joint.offset[0]} {joint.offset[1]} {joint.offset[2]}")
        position = "" if depth else "Xposition Yposition Zposition "
        lines.append(f"{pad}  CHANNELS {3 if depth else 6} {position}{rotations}")
        written.append(joint.key)
        children = [child for child in joints if child.parent == joint.key]
        for child in children:
            joint_lines(child, depth + 1)
        if not children:
            lines.append(f"{pad}  End Site\n{pad}  {{\n{pad}    OFFSET 0 3 0\n{pad}  }}")
        lines.append(f"{pad}}}")

    joint_lines(joints[0], 0)
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {frame_time:.6f}"]
    for frame in frames:
        angles = [angle for key in written for angle in frame.get(key, (0.0, 0.0, 0.0))]
        lines.append(" ".join(f"{number:.6f}" for number in (1, 92, 3, *angles)))
    path.write_text("\n".join(lines) + "\n")


def positions(joints: list[Joint], frame: Frame, order: str = "ZXY") -> dict[str, np.ndarray]:
    """Joint positions of a frame by this test's own forward kinematics, in the body's axes."""
    world: dict[str | None, tuple[Rotation, np.ndarray]] = {None: (Rotation.identity(), np.zeros(3))}
    for joint in joints:
        turn, origin = world[joint.parent]
        local = Rotation.from_euler(order, frame.get(joint.key, (0, 0, 0)), degrees=True)
        world[joint.key] = (turn * local, origin + turn.apply(joint.offset))
    return {key: BODY_FROM_BVH @ place for key, (_, place) in world.items() if key}


def heads(body: Body) -> dict[str, np.ndarray]:
    return dict(zip(body.model.bone_names, body.rest_heads, strict=True))


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def limb(joints: np.ndarray, start: str, end: str) -> np.ndarray:
    return unit(joints[JOINT_INDEX[end]] - joints[JOINT_INDEX[start]])


@pytest.mark.parametrize("arms", ["T", "down"])
@pytest.mark.parametrize("scheme", ["cmu", "daz", "motionbuilder"])
def test_limbs_point_as_in_the_file(tmp_path: Path, default_body: Body, scheme: str, arms: str) -> None:
    rng = np.random.default_rng(0)
    joints = skeleton(scheme, arms)
    order = "ZXY" if arms == "T" else "XYZ"

    def angles() -> tuple[float, float, float]:
        a, b, c = rng.uniform(-70, 70, 3)
        return (a, b, c)

    frames: list[Frame] = [{}, *({joint.key: angles() for joint in joints} for _ in range(6))]
    path = tmp_path / "clip.bvh"
    write(path, joints, frames, order, 1 / 120)
    postures, frame_time = read_bvh(path, heads(default_body))
    assert postures.shape == (7, 20, 3)
    assert frame_time == pytest.approx(1 / 120, abs=1e-6)
    for posture, frame in zip(postures, frames, strict=True):
        expected = positions(joints, frame, order)
        posed = default_body.pose(posture.astype(np.float64)).joints
        for (start, end), (a, b) in LIMBS.items():
            for side in "RL":
                direction = unit(expected[f"{b} {side}"] - expected[f"{a} {side}"])
                actual = limb(posed, start.format(side), end.format(side))
                np.testing.assert_allclose(actual, direction, atol=1e-3)


def test_known_motions(tmp_path: Path, default_body: Body) -> None:
    joints = skeleton("cmu", "T")
    frames: list[Frame] = [
        {},  # arms stretched out
        {"upper arm R": (90, 0, 0), "upper arm L": (-90, 0, 0)},  # hanging
        {"forearm R": (0, 0, 90)},  # the right elbow bent, its forearm forward
        {"pelvis": (0, 0, 90)},  # all turned to the subject's left
        {"shin L": (0, 90, 0)},  # the left heel behind
    ]
    path = tmp_path / "clip.bvh"
    write(path, joints, frames)
    postures = read_bvh(path, heads(default_body))[0].astype(np.float64)
    stretched, hanging, bent, turned, kneeling = (default_body.pose(posture).joints for posture in postures)
    down, forward = np.array([0.0, 0, -1]), np.array([0.0, -1, 0])
    for side, out in (("R", -LEFT), ("L", LEFT)):
        for start, end in (("Shoulder", "Elbow"), ("Elbow", "Hand")):
            np.testing.assert_allclose(limb(stretched, side + start, side + end), out, atol=1e-3)
            np.testing.assert_allclose(limb(hanging, side + start, side + end), down, atol=1e-3)
    np.testing.assert_allclose(limb(bent, "RShoulder", "RElbow"), -LEFT, atol=1e-3)
    np.testing.assert_allclose(limb(bent, "RElbow", "RHand"), forward, atol=1e-3)
    np.testing.assert_allclose(limb(bent, "LElbow", "LHand"), LEFT, atol=1e-3)
    # Left was +X; turned by a quarter to the left, it is +Y, and the body faces +X.
    np.testing.assert_allclose(limb(turned, "RHip", "LHip"), [0, 1, 0], atol=0.02)
    assert heading(postures)[3] == pytest.approx(np.pi / 2, abs=1e-3)
    assert limb(kneeling, "LKnee", "LFoot")[1] > 0.95
    assert limb(kneeling, "RKnee", "RFoot")[2] < -0.95


def test_a_foot_without_length_follows_the_shin(tmp_path: Path, default_body: Body) -> None:
    joints = [joint for joint in skeleton("daz", "T") if not joint.key.startswith(("toe", "finger"))]
    path = tmp_path / "clip.bvh"
    write(path, joints, [{}])
    path.write_text(path.read_text().replace("OFFSET 0 3 0", "OFFSET 0 0 0"))
    postures, _ = read_bvh(path, heads(default_body))
    assert np.isfinite(postures).all()


def spoilt_files() -> dict[str, tuple[str, str]]:
    """What is replaced in a good file, and by what."""
    return {
        "no hierarchy": ("ROOT", "START"),
        "offset of two numbers": ("OFFSET 0 90 0", "OFFSET 0 90"),
        "word for a number": ("OFFSET 0 90 0", "OFFSET 0 high 0"),
        "wrong channel count": ("CHANNELS 6", "CHANNELS 5"),
        "frames are missing": ("Frames: 3", "Frames: 30"),
        "no frames": ("Frames: 3", "Frames: 0"),
        "no frame time": ("Frame Time: 0.033333", "Frame Time: 0"),
        "no motion": ("MOTION", ""),
        "short rows": (" 0.000000 0.000000 0.000000 0.000000 0.000000 0.000000\n", "\n"),
        "not a number": ("1.000000 92.000000 3.000000 0.000000", "1.000000 92.000000 3.000000 nan"),
    }


@pytest.mark.parametrize("case", spoilt_files())
def test_malformed_files(tmp_path: Path, default_body: Body, case: str) -> None:
    path = tmp_path / "clip.bvh"
    write(path, skeleton("cmu", "T"), [{}] * 3)
    old, new = spoilt_files()[case]
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match="not a readable BVH file") as raised:
        read_bvh(path, heads(default_body))
    assert str(path) in str(raised.value)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99])
def test_truncated_files(tmp_path: Path, default_body: Body, share: float) -> None:
    path = tmp_path / "clip.bvh"
    write(path, skeleton("daz", "T"), [{}] * 3)
    text = path.read_text()
    path.write_text(text[: int(len(text) * share)])
    with pytest.raises(InputError, match="not a readable BVH file"):
        read_bvh(path, heads(default_body))


def test_missing_and_binary_files(tmp_path: Path, default_body: Body) -> None:
    with pytest.raises(InputError, match=r"none\.bvh not found"):
        read_bvh(tmp_path / "none.bvh", heads(default_body))
    path = tmp_path / "clip.bvh"
    path.write_bytes(bytes(range(256)) * 10)
    with pytest.raises(InputError, match="not text in UTF-8"):
        read_bvh(path, heads(default_body))


def test_unknown_joint_names(tmp_path: Path, default_body: Body) -> None:
    joints = [dataclasses.replace(joint, name=f"bone{i}") for i, joint in enumerate(skeleton("cmu", "T"))]
    write(tmp_path / "clip.bvh", joints, [{}])
    with pytest.raises(InputError, match=r"clip\.bvh: joints.*bone0.*fit no known naming scheme.*cmu.*--mapping"):
        read_bvh(tmp_path / "clip.bvh", heads(default_body))


def test_clips_of_a_folder(tmp_path: Path, default_body: Body) -> None:
    joints = skeleton("motionbuilder", "down")
    swing: list[Frame] = [{"thigh R": (0, 20 * np.sin(i / 10), 0)} for i in range(121)]
    write(tmp_path / "02_01.bvh", joints, swing, frame_time=1 / 120)
    write(tmp_path / "05_02.bvh", joints, swing[:7], frame_time=1 / 30)
    (tmp_path / "manifest.csv").write_text("file,description\n02_01.bvh,Walking slowly\n05_02.bvh,salsa dance\n")
    walk, dance = load_clips(tmp_path)
    assert (walk.name, walk.simple, len(walk.postures)) == ("02_01", True, 31)
    assert (dance.name, dance.simple, len(dance.postures)) == ("05_02", False, 7)
    assert [walk.split, dance.split] == [split_of("02_01"), split_of("05_02")]
    (tmp_path / "manifest.csv").unlink()
    assert not any(clip.simple for clip in load_clips(tmp_path))


def test_folder_errors(tmp_path: Path, default_body: Body) -> None:
    for folder, message in ((tmp_path, r"no \.bvh or \.amc files"), (tmp_path / "none", "is not a folder")):
        with pytest.raises(InputError, match=message):
            load_clips(folder)
    write(tmp_path / "a.bvh", skeleton("daz", "T"), [{}])
    (tmp_path / "manifest.csv").write_text("clip,words\na.bvh,walk\n")
    with pytest.raises(InputError, match=r"manifest\.csv.*columns file and description"):
        load_clips(tmp_path)
    (tmp_path / "manifest.csv").write_bytes("file,description\na.bvh,läuft\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"manifest\.csv is not text in UTF-8"):
        load_clips(tmp_path)
    (tmp_path / "manifest.csv").write_text("file,description\na.bvh," + 200_000 * "x" + "\n")
    with pytest.raises(InputError, match=r"manifest\.csv cannot be read as CSV"):
        load_clips(tmp_path)
    if hasattr(os, "mkfifo"):
        (tmp_path / "manifest.csv").unlink()
        (tmp_path / "a.bvh").unlink()
        os.mkfifo(tmp_path / "a.bvh")  # to which nobody writes
        with pytest.raises(InputError, match=r"none of its 1 clips is readable; a\.bvh: cannot be read: it is a pipe"):
            load_clips(tmp_path)


def test_flips_are_left_out(tmp_path: Path, default_body: Body) -> None:
    def frame(i: int) -> Frame:
        # A gentle swing; at frame 20 the forearm jumps by 120 degrees and stays there.
        return {"thigh L": (0, float(i), 0), "forearm R": (0, 0, 120.0 if i >= 20 else 0.0)}

    path = tmp_path / "clip.bvh"
    write(path, skeleton("cmu", "T"), [frame(i) for i in range(40)])
    everything, _ = read_bvh(path, heads(default_body))
    (clip,) = load_clips(tmp_path)
    kept = [i for i, posture in enumerate(everything) if (np.abs(clip.postures - posture).max((1, 2)) < 1e-6).any()]
    assert len(kept) == len(clip.postures)
    dropped = set(range(40)) - set(kept)
    assert {19, 20} < dropped
    assert max(dropped) - min(dropped) < 8


def test_splits() -> None:
    names = [f"{subject:02}_{take:02}" for subject in range(1, 145) for take in range(1, 20)]
    splits = [split_of(name) for name in names]
    assert splits == [split_of(name) for name in names]
    shares = {split: splits.count(split) / len(names) for split in SPLITS}
    assert shares == pytest.approx({"train": 0.8, "valid": 0.1, "test": 0.1}, abs=0.03)
    # These may never change: a network trained on one version must not be tested on what it saw.
    assert [split_of(name) for name in ("02_01", "05_01", "86_03", "143_22")] == ["train", "test", "train", "train"]


def test_without_heading() -> None:
    rng = np.random.default_rng(4)
    postures = rng.uniform(-0.5, 0.5, (6, 20, 3))
    straight = without_heading(postures)
    np.testing.assert_allclose(heading(straight), 0, atol=1e-9)
    np.testing.assert_allclose(turn_posture(straight, heading(postures)), postures, atol=1e-9)
