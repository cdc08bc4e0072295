"""Folders in the layouts of TUM's and ICL's sets and of LiveScan3D's raw takes, written here: no file of theirs."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from mkv_file import LENS, calibration

from depthmocap.errors import InputError
from depthmocap.geometry import look_at
from depthmocap.recordings.convert import recording_info
from depthmocap.recordings.open_recording import open_recording


def depth(size: tuple[int, int], seed: int) -> np.ndarray:
    small = np.random.default_rng(seed).integers(1500, 2500, (size[1] // 8, size[0] // 8))
    return small.repeat(8, 0).repeat(8, 1).astype(np.uint16)


def write_tum(
    folder: Path, times: list[str], listing: str = "depth.txt", pairs: str = "{time} depth/{time}.png"
) -> None:
    (folder / "depth").mkdir(parents=True)
    for i, time in enumerate(times):
        cv2.imwrite(str(folder / "depth" / f"{time}.png"), 5 * depth((640, 480), i))
    lines = ["# depth maps", *(pairs.format(time=time) for time in times)]
    (folder / listing).write_text("\n".join(lines) + "\n")


def test_a_folder_of_tum(tmp_path: Path) -> None:
    times = ["1305031102.160407", "1305031102.194330", "1305031102.226738"]
    write_tum(tmp_path / "fr1 desk", times)
    (tmp_path / "fr1 desk" / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n")
    recording = open_recording(tmp_path / "fr1 desk")
    camera = recording.rig["fr1 desk"]
    assert (camera.fx, camera.cx, camera.depth_unit_m, recording.up) == (525.0, 319.5, 1 / 5000, "-y")
    stamps = recording.stamps("fr1 desk")
    assert [round(stamp / 1e3) for stamp in stamps] == [1305031102160407, 1305031102194330, 1305031102226738]
    np.testing.assert_allclose(recording[1].views[0].depth_m, 1e-3 * depth((640, 480), 1), atol=1e-6)
    told = " ".join(recording.problems)
    assert "does not tell its intrinsics: taken are those of the sets of TUM" in told
    assert "a camera that moves" in told
    assert recording_info(recording)["sets"] == 3


def test_a_folder_of_icl(tmp_path: Path) -> None:
    write_tum(tmp_path / "lr", ["0", "1", "2"], "associations.txt", "{time} depth/{time}.png {time} rgb/{time}.png")
    recording = open_recording(tmp_path / "lr")
    assert (recording.rig["lr"].fx, recording.rig["lr"].fy) == (481.2, 480.0)
    assert recording.stamps("lr") == [0, 33_333_333, 66_666_666]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "lists no depth picture"),
        ("1.5 depth/../../x.png", r"line 1 must be a time and a file in depth/"),
        ("soon depth/1.5.png", "time must be a finite number"),
        ("-7.5 depth/1.5.png", "is no time in seconds"),
        ("1.5 depth/2.5.png", "2.5.png not found"),
    ],
)
def test_bad_folders_of_tum(tmp_path: Path, text: str, message: str) -> None:
    write_tum(tmp_path / "a", ["1.5"])
    (tmp_path / "a" / "depth.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        open_recording(tmp_path / "a")


SIZE = (320, 288)


def write_livescan(take: Path, clients: int = 2, frames: int = 3) -> list[np.ndarray]:
    """A raw take; returns the poses of its colour cameras."""
    turned = [1, 0, 0, 0, 0, 1, 0, -1, 0]  # of the colour camera: its y is the depth camera's z
    document = json.loads(calibration().rstrip(b"\0"))
    for camera in document["CalibrationInformation"]["Cameras"]:
        colour = camera["Location"].endswith("PV0")
        rotation, translation = (turned, [0.1, 0.0, 0.0]) if colour else (np.eye(3).ravel().tolist(), [0.0] * 3)
        camera["Rt"] = {"Rotation": rotation, "Translation": translation}
    poses, log = [], []
    for i in range(clients):
        folder = take / f"client_{i}"
        folder.mkdir(parents=True)
        (folder / f"Intrinsics_Calib_{i}.json").write_bytes(json.dumps(document).encode() + b"\0")
        lines = [f"{k}\t{1_000_000 + 33_333 * k + 100 * i}" for k in range(frames)]
        (folder / f"Timestamps_Client{i}.txt").write_text("\n".join(lines) + "\n")
        for k in range(frames):
            cv2.imwrite(str(folder / f"Depth_{k}.tiff"), depth(SIZE, 10 * i + k))
        poses.append(look_at(np.array([2.0 - 4 * i, 1.0, 0.5]), np.array([0.0, 0.0, 1.0])))
        log.append(f"0\t00012{i}\t{i}\n" + "".join(f"{value:.11g}\t" for value in poses[-1].ravel()) + "\n")
    (take / "Extrinsics_Open3D.log").write_text("".join(log))
    return poses


def test_a_raw_take_of_livescan3d(tmp_path: Path) -> None:
    poses = write_livescan(tmp_path / "take")
    recording = open_recording(tmp_path / "take")
    assert recording.rig.names == ("client_0", "client_1")
    assert recording.stamps("client_1") == [1_000_100_000, 1_033_433_000, 1_066_766_000]
    colour_from_depth = np.array([[1, 0, 0, 0.1], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    for i, camera in enumerate(recording.rig.cameras):
        np.testing.assert_allclose(camera.world_from_camera, poses[i] @ colour_from_depth, atol=1e-9)
        assert camera.fx == pytest.approx(LENS[2] * 512)
        np.testing.assert_array_equal(
            recording.raw(camera.name, recording.stamps(camera.name)[2]), depth(SIZE, 10 * i + 2)
        )
    assert len(recording) == 3 and len(recording[0].views) == 2
    assert recording.problems == []
    assert open_recording(tmp_path / "take" / "client_1").rig.names == ("client_1",)


def test_a_take_without_poses_stands_nowhere(tmp_path: Path) -> None:
    write_livescan(tmp_path / "take", clients=1)
    (tmp_path / "take" / "Extrinsics_Open3D.log").unlink()
    recording = open_recording(tmp_path / "take")
    np.testing.assert_array_equal(recording.rig["client_0"].world_from_camera, np.eye(4))
    assert recording.up == "-y"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("Extrinsics_Open3D.log", "0 1 0 1 2 3", "must have three words and a 4×4 matrix"),
        ("Extrinsics_Open3D.log", "0 a 0" + " 2" * 16, "the pose of client_0 is not rigid"),
        ("client_0/Timestamps_Client0.txt", "0 soon", "must be a picture's number and microseconds"),
        ("client_0/Timestamps_Client0.txt", "7 1000", "has no time of a depth picture that is there"),
        ("client_0/Intrinsics_Calib_0.json", "{}", "calibration of the depth camera cannot be read"),
        ("client_0/Depth_0.tiff", "x", "is not a readable picture"),
    ],
)
def test_bad_takes_of_livescan3d(tmp_path: Path, name: str, text: str, message: str) -> None:
    write_livescan(tmp_path / "take")
    (tmp_path / "take" / name).write_text(text)
    with pytest.raises(InputError, match=message):
        open_recording(tmp_path / "take")


def test_point_clouds_are_told(tmp_path: Path) -> None:
    (tmp_path / "recording_0.bin").write_bytes(b"n_points= 3\nframe_timestamp= 7\n" + bytes(30))
    with pytest.raises(InputError, match=r"LiveScan3D's point clouds.*record raw frames"):
        open_recording(tmp_path / "recording_0.bin")
    (tmp_path / "a.ply").write_bytes(b"ply\n")
    with pytest.raises(InputError, match="a point cloud or something else"):
        open_recording(tmp_path / "a.ply")
