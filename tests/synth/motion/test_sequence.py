"""The demo: its motion, its room and its recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.recordings.recording import Recording
from depthmocap.synth.body.bones import mirror_posture
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.demo_scene import DEPTH_STEP, LEARNT_CAMERA, ROOM, demo_body, demo_frames, demo_rig, write_demo
from depthmocap.synth.motion import sequence
from depthmocap.synth.motion.perform import Motion, Step, pose_sequence
from depthmocap.synth.motion.sequence import DEMO_SECONDS, demo_motion
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import PosedPerson
from depthmocap.synth.scenes.room import Box, Room, render_room, shelf, table

FPS = 30


@pytest.fixture(scope="module")
def body(body_model: BodyModel) -> DressedBody:
    return demo_body()


@pytest.fixture(scope="module")
def motion(body: DressedBody) -> Motion:
    return demo_motion(body, np.arange(round(DEMO_SECONDS * FPS)) / FPS)


@pytest.fixture(scope="module")
def posed(body: DressedBody, motion: Motion) -> list[PosedPerson]:
    return list(pose_sequence(body, motion))


@pytest.fixture(scope="module")
def joints(posed: list[PosedPerson]) -> np.ndarray:
    return np.stack([p.joints for p in posed])


def at(joints: np.ndarray, name: str) -> np.ndarray:
    return joints[:, JOINT_INDEX[name]]


def test_motion_is_continuous(joints: np.ndarray) -> None:
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * FPS
    assert speed.max() < 4.0  # m/s, of a hand or a foot
    assert speed[:, JOINT_INDEX["Hip"]].max() < 1.5
    acceleration = np.linalg.norm(np.diff(joints, 2, axis=0), axis=-1) * FPS**2
    assert acceleration.max() < 90  # a jump of 1 cm would be 9 m/s² × FPS


def test_bones_keep_their_lengths(body: DressedBody, joints: np.ndarray) -> None:
    rest = body.body.rest_heads[body.body.model.joint_bones]
    for parent, child in BONES:
        if {parent, child} & {"RShoulder", "LShoulder", "Head", "Neck", "Spine2", "Spine1", "Spine", "Hip"}:
            continue  # more than one bone of the rig
        length = np.linalg.norm(at(joints, parent) - at(joints, child), axis=1)
        expected = np.linalg.norm(rest[JOINT_INDEX[parent]] - rest[JOINT_INDEX[child]])
        np.testing.assert_allclose(length, expected, rtol=1e-4)


def test_the_person_stays_on_the_floor(posed: list[PosedPerson], joints: np.ndarray) -> None:
    lowest = np.array([p.lowest_m for p in posed])
    assert lowest.min() > -0.006 and lowest.max() < 0.008
    ankles = np.stack([at(joints, "LFoot")[:, 2], at(joints, "RFoot")[:, 2]])
    standing = ankles[:, 0].mean()
    assert np.abs(ankles.min(0) - standing).max() < 0.01  # a foot is always down
    assert (ankles.max(0) > standing + 0.05).mean() > 0.2  # and steps are taken


def test_a_foot_that_carries_does_not_slide(joints: np.ndarray) -> None:
    left, right = at(joints, "LFoot"), at(joints, "RFoot")
    speed = np.stack([np.linalg.norm(np.diff(foot, axis=0)[:, :2], axis=1) for foot in (left, right)]) * FPS
    assert speed.min(0).max() < 0.1


def test_knees_and_elbows_bend_their_own_way(joints: np.ndarray) -> None:
    hips = at(joints, "LHip") - at(joints, "RHip")
    left = hips / np.linalg.norm(hips, axis=1, keepdims=True)
    for side in "LR":
        thigh = at(joints, f"{side}Knee") - at(joints, f"{side}Hip")
        shin = at(joints, f"{side}Foot") - at(joints, f"{side}Knee")
        flexion = (np.cross(thigh, shin) * left).sum(1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shin, axis=1)
        assert flexion.min() > 0 and flexion.max() > 0.6
        upper = at(joints, f"{side}Elbow") - at(joints, f"{side}Shoulder")
        fore = at(joints, f"{side}Hand") - at(joints, f"{side}Elbow")
        cos = (upper * fore).sum(1) / np.linalg.norm(upper, axis=1) / np.linalg.norm(fore, axis=1)
        assert np.rad2deg(np.arccos(cos.min())) < 60


def test_what_the_motion_shows(motion: Motion, joints: np.ndarray) -> None:
    head, hands = at(joints, "Head")[:, 2], np.stack([at(joints, f"{s}Hand")[:, 2] for s in "LR"])
    assert (hands.min(0) > head + 0.3).any()  # both arms overhead
    assert head.min() < 0.75 * head[0]  # bent forward
    hips = at(joints, "LHip") - at(joints, "RHip")
    turned = np.unwrap(np.arctan2(hips[:, 1], hips[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(2 * np.pi, abs=1e-3)
    np.testing.assert_allclose(hands[:, 0], head[0] / 2, atol=0.15)  # arms hang at the sides at the start
    assert motion.offsets[:, 1].max() - motion.offsets[:, 1].min() > 0.6  # walks, so that the room behind is seen


def test_left_and_right_are_treated_alike(body: DressedBody, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mirrored score gives the mirror image (on a body that is symmetric itself)."""
    times_s = np.arange(0, DEMO_SECONDS, 0.25)
    plain = demo_motion(body, times_s)
    other = {"L": "R", "R": "L"}
    score = {
        f"{name[:-1]}{other[name[-1]]}" if name[-2] == "." else name: (
            [(t, -v) for t, v in keys] if name in ("sway", "twist", "look") else keys
        )
        for name, keys in sequence._SCORE.items()
    }
    steps = [
        Step(other[s.side], s.start_s, s.end_s, (-s.place[0], s.place[1]), -s.yaw_deg, s.detour, s.toes_deg,
             s.weight)
        for s in sequence._demo_steps()
    ]  # fmt: skip
    monkeypatch.setattr(sequence, "_SCORE", score)
    monkeypatch.setattr(sequence, "_demo_steps", lambda: steps)
    mirrored = demo_motion(body, times_s)
    np.testing.assert_allclose(mirrored.offsets * [-1, 1, 1], plain.offsets, atol=2e-3)
    expected = Motion(times_s, mirror_posture(plain.postures), plain.offsets * [-1, 1, 1])
    for a, b in zip(pose_sequence(body, mirrored), pose_sequence(body, expected), strict=True):
        np.testing.assert_allclose(a.joints, b.joints, atol=5e-3)
    first, second = (next(pose_sequence(body, m)).joints for m in (plain, mirrored))
    np.testing.assert_allclose(first[MIRROR] * [-1, 1, 1], second, atol=5e-3)


def test_a_known_wall_has_its_exact_depth() -> None:
    room = Room(Box((-2.0, -3.0, 0.0), (2.0, 3.0, 2.5)), (Box((-0.2, 0.5, 0.0), (0.4, 1.0, 1.2)),))
    pose = look_at(np.array([0.0, -1.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    camera = DepthCamera("cam", 80, 60, 60.0, 60.0, 39.5, 29.5, pose)
    depth = render_room(room, camera)
    assert depth.dtype == np.float32
    points = camera.unproject(depth) @ pose[:3, :3].T + pose[:3, 3]
    depth_rows = points.reshape(60, 80, 3)
    assert depth[0, 40] == pytest.approx(1.5 / (29.5 / 60), rel=1e-5)  # the ceiling, 1.5 m above the camera
    assert depth[20, 39] == pytest.approx(4.0)  # above the box: the wall behind, everywhere 4 m away in z
    assert depth[30, 40] == pytest.approx(1.5)  # the box
    on_something = np.abs(
        np.stack([depth_rows[..., 0] - 2, depth_rows[..., 0] + 2, depth_rows[..., 1] - 3, depth_rows[..., 2],
                  depth_rows[..., 2] - 2.5, depth_rows[..., 1] - 0.5, depth_rows[..., 2] - 1.2])
    ).min(0)  # fmt: skip
    assert on_something.max() < 1e-5
    outside = DepthCamera("out", 80, 60, 60.0, 60.0, 39.5, 29.5, look_at(np.array([0.0, -4.0, 1.0]), np.zeros(3)))
    with pytest.raises(ValueError, match="inside the room's shell"):
        render_room(room, outside)


def test_rays_along_the_axes_of_a_box() -> None:
    """A camera square to the room looks along its faces: no division by zero escapes."""
    pose = look_at(np.array([0.0, -1.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    camera = DepthCamera("cam", 3, 3, 50.0, 50.0, 1.0, 1.0, pose)
    edge_on_the_axis = Box((0.0, 0.5, 1.0), (1.0, 1.0, 2.0))
    room = Room(Box((-2.0, -3.0, 0.0), (2.0, 3.0, 2.5)), (edge_on_the_axis,))
    depth = render_room(room, camera)
    assert np.isin(depth.round(5), [np.float32(1.5), np.float32(4.0)]).all()
    assert (depth[2] == 4).all() and depth[0, 2] == 1.5


def test_furniture_stands_in_the_room() -> None:
    for box in (*ROOM.boxes, *table((0.0, 0.0), (1.0, 1.0), 0.7), *shelf((0.0, 0.0), (0.3, 1.0), 1.8, 4)):
        assert np.all(np.array(box.low) < box.high)
    for box in ROOM.boxes:
        assert np.all(np.array(box.low) >= ROOM.shell.low) and np.all(np.array(box.high) <= ROOM.shell.high)


def test_the_person_does_not_touch_the_furniture(posed: list[PosedPerson]) -> None:
    for p in posed[::5]:
        for box in ROOM.boxes:
            assert not np.all((p.vertices > box.low) & (p.vertices < box.high), axis=1).any()


@pytest.mark.usefixtures("body")
def test_demo_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "demo"
    write_demo(path, seed=3, sets=3)
    recording = Recording(path)
    assert len(recording) == 3 and recording.problems == []
    assert recording.rig.names == demo_rig().names
    for name in recording.rig.names:
        assert (recording.background(name) is None) == (name == LEARNT_CAMERA)
    assert len({(camera.width, camera.height) for camera in recording.rig.cameras}) > 1
    for got, (stamps, expected) in zip(recording, demo_frames(seed=3, sets=3), strict=True):
        assert got.timestamp_ns == expected.timestamp_ns == sorted(stamps.values())[1]
        assert got.true_joints is not None and expected.true_joints is not None
        np.testing.assert_allclose(got.true_joints, expected.true_joints, atol=1e-5)
        uvz = [view.camera.project(expected.true_joints) for view in expected.views]
        for a, b, projected in zip(got.views, expected.views, uvz, strict=True):
            np.testing.assert_allclose(a.depth_m, b.depth_m, atol=(DEPTH_STEP / 2 + 0.1) * a.camera.depth_unit_m)
            assert b.mask is not None and 0.02 < b.mask.mean() < 0.3
            assert projected.shape == (len(JOINTS), 3)
            u, v = projected[JOINT_INDEX["Spine1"], :2].round().astype(int)
            assert b.mask[v - 2 : v + 3, u - 2 : u + 3].mean() > 0.9
    with pytest.raises(InputError, match="exists already"):
        write_demo(path, sets=1)
    with pytest.raises(ValueError, match="sets must be in 1 to"):
        next(demo_frames(sets=0))
