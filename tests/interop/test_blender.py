"""Blender's module opens every animated file: bones where joints are, people at their size, upright.

``make interop`` runs this; it brings Blender's module in an environment of its own (hundreds of megabytes).
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_people_take import FRAME_NS, LONG, LOST, SECOND, SHORT, write_take

from depthmocap.body.skeleton import BONES, JOINTS
from depthmocap.exporting.export_command import ExportSettings, export
from depthmocap.exporting.target_skeleton import RestPose, SkeletonName, bones_of
from depthmocap.offline.run import RunSettings, run
from depthmocap.recordings.open_recording import packaged_recording

BLENDER = os.environ.get("DEPTHMOCAP_BLENDER_PYTHON", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not BLENDER, reason="no Blender: make interop brings its module"),
]
RATE = 1e9 / FRAME_NS
#: Frames in which everybody was seen.
WHOLE = [i for i in SECOND if i not in SHORT and i not in LONG and i not in LOST]


def look(path: Path, rate: float, seconds: list[float]) -> list[dict[str, Any]]:
    """What Blender says of a file at some times."""
    script = Path(__file__).with_name("open_in_blender.py")
    command = [BLENDER, str(script), str(path), str(rate), *map(str, seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    answer = next(line for line in done.stdout.splitlines() if line.startswith("ANSWER "))
    return json.loads(answer.removeprefix("ANSWER "))["looks"]


def joints_of(armature: dict[str, Any], skeleton: SkeletonName, which: str = "bones") -> np.ndarray:
    """Heads of bones in the order of our joints (18, 3)."""
    heads = {name.replace(":", "_"): at for name, at in armature[which].items()}  # USD has no ":" in names
    names = {bone.joint: bone.name.replace(":", "_") for bone in bones_of(skeleton)}
    return np.array([heads[names[joint]] for joint in JOINTS])


def names(joint: str) -> int:
    return JOINTS.index(joint)


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    folder = tmp_path_factory.mktemp("take")
    return folder, write_take(folder)


@pytest.mark.parametrize(
    ("skeleton", "rest"), [("depthmocap", "t"), ("unity", "t"), ("unreal", "a"), ("mixamo", "a"), ("vrm", "t")]
)
@pytest.mark.parametrize("name", ["glb", "usd", "bvh", "fbx"])
def test_a_take_of_two_people_with_gaps(
    taken: tuple[Path, np.ndarray], tmp_path: Path, name: Any, skeleton: SkeletonName, rest: RestPose
) -> None:
    export(ExportSettings(taken[0], tmp_path, formats=(name,), skeleton=skeleton, rest=rest, bvh_unit="m"))
    files = sorted(tmp_path.rglob(f"pose.{name}"))
    starts = [0, SECOND[0]] if name == "bvh" else [0]
    assert len(files) == len(starts)
    bodies = []
    for path, start in zip(files, starts, strict=True):
        looks = look(path, RATE, [(frame - start) / RATE for frame in WHOLE])
        bodies += [[each["armatures"][label] for each in looks] for label in sorted(looks[0]["armatures"])]
        heights = [each["meshes"] for each in looks]
        for meshes in heights:
            assert len(meshes) == (0 if name == "bvh" else 2)
    assert len(bodies) == 2
    for person, seen in enumerate(bodies):
        found = np.array([joints_of(armature, skeleton) for armature in seen])
        # Blender's world is Z up as ours.
        np.testing.assert_allclose(found, taken[1][person, WHOLE], atol=1e-3)
        rest_at = joints_of(seen[0], skeleton, "rest")
        left, right = rest_at[names("LHand")] - rest_at[names("LShoulder")], rest_at[names("RHand")]
        assert left[0] > 0 > right[0]  # the subject's left at +X, who faces -Y
        assert left[2] == pytest.approx(0 if rest == "t" else -left[0], abs=2e-3)
        for parent, child in BONES:
            length = np.linalg.norm(rest_at[names(child)] - rest_at[names(parent)])
            true = np.linalg.norm(taken[1][person, 0, names(child)] - taken[1][person, 0, names(parent)])
            assert length == pytest.approx(true, abs=1e-3), child


def test_the_demo(tmp_path: Path) -> None:
    run(RunSettings(packaged_recording(), tmp_path / "take", report=False))
    export(ExportSettings(tmp_path / "take", tmp_path, formats=("npz", "glb", "usd", "bvh", "fbx"), bvh_unit="m"))
    arrays = np.load(tmp_path / "pose.npz")
    apart_m = np.linalg.norm(arrays["joints"] - arrays["skeleton_joints"], axis=-1)
    rate = float(arrays["frames_per_second"])
    frames = [0, 20, 45, 66]
    for name in ("glb", "usd", "bvh", "fbx"):
        looks = look(tmp_path / f"pose.{name}", rate, [frame / rate for frame in frames])
        for frame, each in zip(frames, looks, strict=True):
            (armature,) = each["armatures"].values()
            found = joints_of(armature, "depthmocap")
            np.testing.assert_allclose(found, arrays["skeleton_joints"][frame], atol=1e-3)
            for bounds in each["meshes"].values():
                assert abs(bounds[2][0]) < 0.05 and 0.1 < bounds[2][1] - found[names("Head"), 2] < 0.6
    print(f"constant bones differ from pose.csv by {apart_m.mean() * 1e3:.1f} mm, at most {apart_m.max() * 1e3:.1f}")
    assert apart_m.mean() < 0.01


def test_bvh_in_centimetres_is_a_hundred_times_too_large(taken: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    export(ExportSettings(taken[0], tmp_path, formats=("bvh",)))
    (each,) = look(tmp_path / "person-1" / "pose.bvh", RATE, [0.0])
    (armature,) = each["armatures"].values()
    np.testing.assert_allclose(joints_of(armature, "depthmocap"), 100 * taken[1][0, 0], atol=0.1)
