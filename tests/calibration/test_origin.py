"""The lab's frame by standing and walking, by points of the floor, and by a C3D file of the same movement."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation
from walker import REST, errors, stand, wander

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.calibration.calibrate import CalibrateSettings
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.origin import by_points, by_walk, find_lab
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, rigid_inverse, transform_points, z_up_from

RNG = np.random.default_rng(0)
TIMES_S = np.arange(0, 24, 0.1)
#: Places where the person stands, and when they set off and arrive (seconds).
PLACES, WALKS = ([0.4, -0.7], [1.6, 0.9], [-1.0, 0.5]), ((2.0, 5.0), (8.0, 12.0))
RIG = Rig(tuple(DepthCamera(f"cam{i}", 320, 240, 250.0, 250.0, 159.5, 119.5, stand(100 * i)) for i in range(2)))


def person(noise_m: float = 0.01) -> JointTrack:
    """Stands, walks, stands, walks, stands; nothing is known of them at first."""
    along = np.stack([np.interp(TIMES_S, [0, *np.ravel(WALKS)], [0, 0, 1, 1, 2])] * 2, 1)
    place = np.stack([np.interp(along[:, i], [0, 1, 2], np.array(PLACES)[:, i]) for i in (0, 1)], 1)
    joints = np.tile(REST, (len(TIMES_S), 1, 1)) + np.append(place, 0 * along[:, :1], 1)[:, None]
    joints += RNG.normal(0, noise_m, joints.shape)
    joints[:3] = np.nan
    return JointTrack(TIMES_S + 1000, joints, np.full(joints.shape[:2], 0.03))


def test_from_where_the_person_stands_and_walks_to() -> None:
    lab = by_walk(person())
    ends = transform_points(lab.lab_from_world, np.array([[*place, 0.0] for place in PLACES[:2]]))
    np.testing.assert_allclose(ends, [[0, 0, 0], [2.0, 0, 0]], atol=0.03)
    assert "2.00 m away" in lab.lines[0] and lab.up == "z"
    moved = lab.rig(RIG)
    step = lab.lab_from_world @ RIG.cameras[1].world_from_camera
    np.testing.assert_allclose(moved.cameras[1].world_from_camera, step)


def test_who_does_not_stand_or_walk_is_told() -> None:
    track = person()
    drifting = track.joints + np.linspace(0, 8, len(TIMES_S))[:, None, None] * np.array([1.0, 0, 0])
    with pytest.raises(InputError, match="never stands still"):
        by_walk(JointTrack(track.times_s, drifting, track.sigma_m))
    with pytest.raises(InputError, match=r"stands once, .* walk a metre or more"):
        by_walk(JointTrack(track.times_s[:35], track.joints[:35], track.sigma_m[:35]))


def write_points(path: Path, points: list[dict]) -> Path:
    path.write_text(json.dumps({"points": points}))
    return path


def lab_places() -> np.ndarray:
    """The places in a lab that is turned by 50° and elsewhere."""
    turn = Rotation.from_euler("z", 50, degrees=True).as_matrix()[:2, :2]
    return np.array(PLACES) @ turn.T + [3.0, -1.0]


def test_from_points_of_the_floor(tmp_path: Path) -> None:
    seen = RIG.cameras[1].project(np.array([[*PLACES[2], 0.0]]))[0, :2]
    a, b, c = lab_places().tolist()
    points = [
        {"name": "A", "at_m": a, "time_s": 1.0}, {"name": "B", "at_m": b, "time_s": 6.5},
        {"name": "C", "at_m": c, "camera": "cam1", "pixel": seen.tolist()},
    ]  # fmt: skip
    lab = by_points(write_points(tmp_path / "p.json", points), person(), RIG)
    found = transform_points(lab.lab_from_world, np.array([[*place, 0.0] for place in PLACES]))
    np.testing.assert_allclose(found[:, :2], lab_places(), atol=0.03)
    assert "point 'A' " in lab.lines[0] and " cm" in lab.lines[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"at_m": [1.0]}, "at_m must be 2 numbers"),
        ({"at_m": [50.0, 0.0]}, "do not fit each other"),
        ({"time_s": 3.5}, "does not stand 3.5 s after the start"),
        ({"time_s": 99}, "nobody is seen 99 s after the start"),
        ({"camera": "x", "time_s": None}, "there is no camera 'x'"),
        ({"camera": "cam0", "pixel": [160, 3], "time_s": None}, "does not show the floor"),
        ({"time_s": None}, "lacks camera"),
        ({"time_s": 1.0}, "within 50 cm of each other by where they are seen"),
    ],
)
def test_bad_points(tmp_path: Path, change: dict, message: str) -> None:
    a, b, _ = lab_places().tolist()
    second = {"name": "B", "at_m": b, "time_s": 6.5} | change
    second = {key: value for key, value in second.items() if value is not None}
    path = write_points(tmp_path / "p.json", [{"name": "A", "at_m": a, "time_s": 1.0}, second])
    with pytest.raises(InputError, match=message):
        by_points(path, person(), RIG)


@pytest.mark.parametrize("up", ["z", "y"])
def test_from_a_c3d_file_of_the_same_movement(tmp_path: Path, up: str) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    rng, late_s = np.random.default_rng(1), 7.25
    fine_s, times_s = np.arange(0, 25.01, 0.05), np.arange(0, 25, 0.1)
    movement = interp1d(fine_s, wander(fine_s), axis=0)
    joints = movement(times_s) + rng.normal(0, 0.015, (len(times_s), 18, 3))
    ours = JointTrack(times_s + 500, joints, np.full(joints.shape[:2], 0.03))
    lab = np.eye(4)
    lab[:3, :3] = z_up_from(up).T @ Rotation.from_euler("z", 110, degrees=True).as_matrix()
    lab[:3, 3] = (2.0, -1.0, 0.5)
    begun_s = np.arange(late_s, 24, 0.01)
    theirs = transform_points(lab, movement(begun_s))
    file = ezc3d.c3d()
    used = [joint for joint in JOINTS if joint not in ("Spine", "Hip")]
    hip = [f"{side}{name}" for side in "LR" for name in ("ASI", "PSI")]
    points = [theirs[:, JOINT_INDEX[joint]] for joint in used] + [theirs[:, JOINT_INDEX["Hip"]]] * 4
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = [*(f"Anna:{joint}" for joint in used), *hip]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    stacked = 1000 * np.stack(points).transpose(2, 0, 1)
    file["data"]["points"] = np.concatenate([stacked, np.ones_like(stacked[:1])])
    file.write(str(tmp_path / "lab.c3d"))
    found = find_lab(str(tmp_path / "lab.c3d"), ours, RIG, rng)
    assert found.up == up
    metres, turned = errors(found.lab_from_world @ rigid_inverse(lab), np.eye(4), (2.0, -1.0, 0.5))
    assert metres < 0.01 and np.rad2deg(turned) < 0.5
    (line,) = found.lines
    begins_s = float(line.split("begins ")[1].split(" s ")[0])
    assert begins_s == pytest.approx(late_s, abs=0.01) and "17 joints" in line
    other = JointTrack(ours.times_s, wander(times_s, seed=9), ours.sigma_m)
    with pytest.raises(InputError, match="it cannot be told when it was captured"):
        find_lab(str(tmp_path / "lab.c3d"), other, RIG, rng)
    (tmp_path / "bad.c3d").write_bytes(b"something else" * 100)
    with pytest.raises(InputError, match="is no C3D file that can be read"):
        find_lab(str(tmp_path / "bad.c3d"), ours, RIG, rng)


def test_settings_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--origin takes walk"):
        CalibrateSettings(tmp_path, origin="here")
    with pytest.raises(InputError, match="not found"):
        CalibrateSettings(tmp_path, origin=str(tmp_path / "x.c3d"))
