"""A small CMU Panoptic sequence in its true layout, with the people of ``mhad_files``."""

from __future__ import annotations

import json

import numpy as np
from mhad_files import render
from scipy.spatial.transform import Rotation

from depthmocap.datasets.mhad import MHAD_JOINTS
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import look_at, rigid_inverse, z_up_from

#: Half a turn about x: from a world with Y up to the dome's.
DOME = np.diag([1.0, -1.0, -1.0])
EYES = {1: (2.4, 1.2, 1.5), 2: (-2.6, 0.9, 0.8), 3: (0.1, 1.6, -2.7)}
LENS = (0.09, -0.27, 0.001, -0.001, 0.09)
_FROM = {
    "Neck": "Neck", "Nose": "Head", "BodyCenter": "Hips", "Shoulder": "Shoulder", "Elbow": "Elbow", "Wrist": "Hand",
    "Hip": "Hip", "Knee": "Knee", "Ankle": "Foot", "Eye": "HeadEnd", "Ear": "Head",
}  # fmt: skip
_ORDER = (
    "Neck", "Nose", "BodyCenter", *(f"L{n}" for n in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")),
    *(f"R{n}" for n in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")), "LEye", "LEar", "REye", "REar",
)  # fmt: skip


def _theirs(name):
    if name in _FROM:
        return _FROM[name]
    ours = _FROM[name[1:]]
    return ours if ours.startswith("Head") else name[0] + ours


PICK = [MHAD_JOINTS.index(_theirs(name)) for name in _ORDER]


def pose(rotation_vector, shift):
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    found[:3, 3] = shift
    return found


M_COLOR, M_DEPTH = pose([0.002, -0.004, 0.001], [0.052, 0.001, -0.002]), pose([0.0, 0.01, 0.0], [0.0, 0.003, 0.0])


def camera(kinect, up="-y"):
    z_up = z_up_from("y")
    world_from_camera = look_at(z_up @ np.array(EYES[kinect]), z_up @ np.array([0.0, 0.9, 0.0]))
    world_from_camera[:3] = (DOME if up == "-y" else np.eye(3)) @ z_up.T @ world_from_camera[:3]
    return DepthCamera(f"Kinect {kinect}", 512, 424, 366.0, 366.2, 258.0, 205.0, world_from_camera, LENS)


def true_joints19(joints):
    """Joints of the dome, metres, of MHAD's 35 in a world with Y up."""
    return joints[..., PICK, :] @ DOME


def write_panoptic(folder, joints, first=100):
    """``joints`` (n, 35, 3): metres, Y up. Frames of joints are ``first`` and so on, at 33.4 ms; each Kinect is 4 ms
    later than the one before, and has ten frames before the first."""
    name = folder.name
    folder.mkdir(parents=True)
    sensors, cameras, times = [], [{"name": "00_00", "R": np.eye(3).tolist(), "t": [[0], [0], [0]]}], {}
    count = len(joints)
    for kinect in EYES:
        own = camera(kinect)
        colour_from_world = M_COLOR @ rigid_inverse(M_DEPTH) @ rigid_inverse(own.world_from_camera)
        sensors.append({
            "K_depth": own.matrix.tolist(), "distCoeffs_depth": [*LENS, 1000, 0, 0], "M_depth": M_DEPTH.tolist(),
            "M_color": M_COLOR.tolist(), "K_color": own.matrix.tolist(), "M_world2sensor": np.eye(4).tolist(),
        })  # fmt: skip
        cameras.append({
            "name": f"50_{kinect:02d}", "type": "kinect-color", "R": colour_from_world[:3, :3].tolist(),
            "t": (colour_from_world[:3, 3:] * 100).tolist(),
        })  # fmt: skip
        times[f"KINECTNODE{kinect}"] = {"univ_time": (5000 + 33.4 * np.arange(-10, count) + 4 * (kinect - 1)).tolist()}
        path = folder / "kinect_shared_depth" / f"KINECTNODE{kinect}" / "depthdata.dat"
        path.parent.mkdir(parents=True)
        seen = camera(kinect, "y")
        empty = np.zeros((10, 424, 512), np.uint16)
        frames = np.concatenate([empty, *(render(seen, each)[None] for each in joints)])
        path.write_bytes(np.ascontiguousarray(frames[:, :, ::-1]).astype("<u2").tobytes())
    hd_ms = (5000 + 33.4 * (np.arange(first + count + 1) - first - 1)).tolist()
    for kind, document in (
        ("kcalibration", {"sensors": sensors}),
        ("calibration", {"cameras": cameras}),
        ("ksynctables", {"kinect": {"depth": times}}),
        ("synctables", {"hd": {"univ_time": hd_ms}}),
    ):
        (folder / f"{kind}_{name}.json").write_text(json.dumps(document))
    bodies = folder / "hdPose3d_stage1_coco19"
    bodies.mkdir()
    for i, each in enumerate(true_joints19(joints)):
        table = np.concatenate([each * 100, np.full((19, 1), 0.6)], 1)
        table[15] = [0, 0, 0, -1]  # the left eye is never found
        person = {"id": 0, "joints19": table.ravel().tolist()}
        (bodies / f"body3DScene_{first + i:08d}.json").write_text(json.dumps({"bodies": [person]}))
