"""A small Berkeley MHAD in its true layout: people of spheres around a known skeleton, in a room of two Kinects."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import look_at, rigid_inverse, z_up_from

#: Rest pose (cm) of somebody who faces +z with hanging arms; the right side is at -x. Depth first, as in the set.
_TRUNK = [(0, 95, 0), (0, 10, 0), (0, 15, 0), (0, 15, 0), (0, 15, 0), (0, 10, 0), (0, 18, 0)]
_ARM = [(-4, -4, 0), (-14, 0, 0), (-3, -14, 0), (-3, -14, 0), (-1, -13, 0), (-1, -12, 0), (0, -15, 0)]
_LEG = [(-9, -3, 0), (0, -22, 0), (0, -22, 0), (0, -21, 0), (0, -20, 0), (0, -6, 12), (0, 0, 8)]
_PARENT_OF_LIMB = (3, 3, 0, 0)  # arms hang from Spine3, legs from Hips
JOINT_COUNT = 35
EYES = {1: (0.3, 1.3, 3.2), 2: (-0.2, 1.2, -3.3)}
LENS = {1: (0.19607373, -0.36734107, -0.0024796, -0.0018977), 2: (0.0, 0.0, 0.0, 0.0)}
MATRIX = {1: (531.49, 532.39, 314.64, 252.53), 2: (532.34, 532.80, 323.22, 265.27)}
_COARSE = 4


@dataclasses.dataclass(frozen=True)
class Clip:
    """A sequence: where the person stands (m), which way they face (degrees), and how large they are."""

    subject: int
    action: int
    repetition: int
    path: np.ndarray  # (n, 3): x, z in metres, heading in degrees
    size: float = 1.0

    @property
    def name(self) -> str:
        return f"s{self.subject:02d}_a{self.action:02d}_r{self.repetition:02d}"


def make_clips(subjects=(1, 2), actions=(1, 2), frames=6, seed=0):
    """Clips of people who stand about here and there."""
    rng = np.random.default_rng(seed)
    return [
        Clip(s, a, 1, rng.uniform((-0.5, -0.5, -40), (0.5, 0.5, 40), (frames, 3)), 1.0 + 0.04 * s)
        for s in subjects
        for a in actions
    ]


def limbs(left_first=False):
    """Offsets of both arms, then both legs."""
    mirror = np.array([-1.0, 1, 1])
    right, left = (np.array(_ARM, float), np.array(_LEG, float)), (np.array(_ARM) * mirror, np.array(_LEG) * mirror)
    first, second = (left, right) if left_first else (right, left)
    return [first[0], second[0], first[1], second[1]]


def rest_joints(size=1.0):
    """Joints (35, 3) in metres of the standing person, in the order of the set."""
    places = [*np.cumsum(_TRUNK, 0)]
    for parent, offsets in zip(_PARENT_OF_LIMB, limbs(), strict=True):
        places += [*(places[parent] + np.cumsum(offsets, 0))]
    return np.array(places) / 100 * size


def true_joints(clip):
    """(n, 35, 3) metres."""
    angle = np.radians(clip.path[:, 2])
    cos, sin, zero, one = np.cos(angle), np.sin(angle), np.zeros(len(angle)), np.ones(len(angle))
    turn = np.stack([cos, zero, sin, zero, one, zero, -sin, zero, cos], -1).reshape(-1, 3, 3)
    rest = rest_joints(clip.size)
    moved = (rest - rest[0]) @ turn.transpose(0, 2, 1) + rest[0]
    return moved + np.stack([clip.path[:, 0], zero, clip.path[:, 1]], -1)[:, None]


def camera(kinect):
    z_up = z_up_from("y")
    world_from_camera = look_at(z_up @ np.array(EYES[kinect]), z_up @ np.array([0.0, 0.9, 0.0]))
    world_from_camera[:3] = z_up.T @ world_from_camera[:3]
    k1, k2, p1, p2 = LENS[kinect]
    return DepthCamera(f"Kinect {kinect}", 640, 480, *MATRIX[kinect], world_from_camera, (k1, k2, p1, p2, 0.0))


def render(kinect_camera, joints):
    """Raw depth (mm) of the person and the room, at a quarter of the size and enlarged."""
    rays = kinect_camera.rays[_COARSE // 2 :: _COARSE, _COARSE // 2 :: _COARSE].astype(float)
    rays = np.nan_to_num(np.concatenate([rays, np.ones_like(rays[..., :1])], -1), nan=100.0)
    rays = rays @ kinect_camera.world_from_camera[:3, :3].T
    eye = kinect_camera.world_from_camera[:3, 3]
    depth = np.full(rays.shape[:2], np.inf)
    for axis, at in ((1, 0.0), (2, 4.5), (2, -4.5), (0, 4.0), (0, -4.0)):
        with np.errstate(divide="ignore"):
            z = (at - eye[axis]) / rays[..., axis]
        depth = np.minimum(depth, np.where(z > 0, z, np.inf))
    pixels = kinect_camera.project(np.array([centre for centre, _ in spheres(joints)])) / _COARSE
    for (centre, radius), (u, v, z) in zip(spheres(joints), pixels, strict=True):
        reach = 1.3 * radius / z * kinect_camera.fx / _COARSE + 2
        box = np.s_[max(int(v - reach), 0) : int(v + reach) + 1, max(int(u - reach), 0) : int(u + reach) + 1]
        offset = eye - centre
        a, b, c = (rays[box] ** 2).sum(-1), rays[box] @ offset, offset @ offset - radius**2
        root = b * b - a * c
        near = (-b - np.sqrt(np.maximum(root, 0))) / a
        depth[box] = np.where(root > 0, np.minimum(depth[box], near), depth[box])
    raw = np.round(np.where(depth < 8, depth, 0) * 1000).astype(np.uint16)
    return np.repeat(np.repeat(raw, _COARSE, 0), _COARSE, 1)


def spheres(joints):
    """Centres and radii (m) of what the body is made of."""
    parts = [(joint, 0.13) for joint in joints[:5]] + [(joints[5:7].mean(0), 0.12)]
    for first, radius in ((7, 0.05), (14, 0.05), (21, 0.08), (28, 0.08)):
        chain = joints[first : first + 7]
        steps = np.concatenate([chain, (chain[1:] + chain[:-1]) / 2])
        parts += [(place, radius) for place in steps]
    return parts


def write_bvh(path, clip, times=1, left_first=False, drop_end=False):
    """The clip's skeleton, every frame ``times`` times; Y, then X, then Z rotations."""
    scale = clip.size
    trunk = np.array(_TRUNK, float) * scale

    def joint(name, offset, inside, end=False):
        kind = "End Site" if end else f"{'ROOT' if name == 'hips' else 'JOINT'} {name}"
        x, y, z = offset
        lines = [kind, "{", f"OFFSET {x:.5f} {y:.5f} {z:.5f}"]
        if not end:
            position = "6 Xposition Yposition Zposition" if name == "hips" else "3"
            lines.append(f"CHANNELS {position} Yrotation Xrotation Zrotation")
        return [*lines, *inside, "}"]

    def limb(prefix, offsets):
        inside = []
        for i in reversed(range(7)):
            if not (drop_end and i == 6):
                inside = joint(f"{prefix}{i}", offsets[i] * scale, inside, end=i == 6)
        return inside

    arm_a, arm_b, leg_a, leg_b = limbs(left_first)
    inside = joint("neck", trunk[4], joint("head", trunk[5], joint("", trunk[6], [], end=True)))
    inside = joint("spine2", trunk[3], inside + limb("arm_a", arm_a) + limb("arm_b", arm_b))
    inside = joint("spine", trunk[1], joint("spine 1", trunk[2], inside))
    hierarchy = ["HIERARCHY", *joint("hips", trunk[0], inside + limb("leg_a", leg_a) + limb("leg_b", leg_b))]
    rows = []
    for x, z, heading in np.repeat(clip.path, times, 0):
        rows.append([100 * x, 0, 100 * z, heading, 0, 0] + [0] * (3 * 29))
    text = "\n".join(" ".join(f"{value:.5f}" for value in row) for row in rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([*hierarchy, "MOTION", f"Frames: {len(rows)}", "Frame Time: 0.0020833", text]) + "\n")


def write_calibration(root: Path):
    folder = root / "Calibration"
    folder.mkdir(parents=True)
    for kinect in (1, 2):
        fx, fy, cx, cy = MATRIX[kinect]

        def matrix(rows, values):
            data = ", ".join(f"{value:.9e}" for value in values)
            size = f"      rows: {rows}\n      cols: {len(values) // rows}\n"
            return f"!!opencv-matrix\n{size}      dt: d\n      data: [ {data} ]"

        (folder / f"camcfg_k{kinect:02d}.yml").write_text(
            f"%YAML:1.0\nCamera_1:\n   K: {matrix(3, [fx, 0, cx, 0, fy, cy, 0, 0, 1])}\n"
            f"   Dist: {matrix(1, LENS[kinect])}\n   PosRel: {matrix(1, [0] * 6)}\n"
        )
        pose = rigid_inverse(camera(kinect).world_from_camera)
        rotation = " ".join(f"{x:.9f}" for x in pose[:3, :3].ravel())
        (folder / f"RwTw_k{kinect:02d}.txt").write_text(
            f"Rw={rotation}\nTw={' '.join(f'{x:.5f}' for x in pose[:3, 3] * 1000)}\n"
        )


def write_mhad(root: Path, clips=None, times=16):
    """Write everything; the second Kinect's frames are 3 marker frames later. Returns the clips."""
    clips = make_clips() if clips is None else clips
    write_calibration(root)
    for clip in clips:
        write_bvh(root / "Mocap" / "SkeletalData" / f"skl_{clip.name}.bvh", clip, times)
        for kinect in (1, 2):
            moments = np.arange(len(clip.path)) * times + 3 * (kinect - 1) + 1
            table = np.stack([np.arange(len(moments)), moments / 480, moments], 1)
            path = root / "Kinect" / "Correspondences" / f"corr_moc_kin{kinect:02d}_{clip.name}.txt"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savetxt(path, table, fmt=("%d", "%.4f", "%d"))
            folder = root / "Kinect" / f"Kin{kinect:02d}"
            folder = folder / f"S{clip.subject:02d}" / f"A{clip.action:02d}" / f"R{clip.repetition:02d}"
            folder.mkdir(parents=True, exist_ok=True)
            for i, joints in enumerate(true_joints(clip)):
                raw = render(camera(kinect), joints)
                data = b"P5\n640 480\n65535\n" + raw.astype(">u2").tobytes()
                (folder / f"kin_k{kinect:02d}_{clip.name}_depth_{i:05d}.pgm").write_bytes(data)
    return clips
