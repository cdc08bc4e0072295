"""Writes the packaged demo recording: a person moves in a furnished room among three different depth cameras.

    python -m depthmocap.synth.demo_scene OUT

The packaged one shows the same motion to within a centimetre, with other draws of noise.

Everything in it is procedural (body, clothes, motion, room and noise), so it may be copied freely.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float, UInt16
from numpy import ndarray

from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.synth.body.mesh import BodyModel, Phenotype
from depthmocap.synth.motion.perform import pose_sequence
from depthmocap.synth.motion.sequence import DEMO_SECONDS, demo_motion
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.wardrobe import ORDINARY_CLOTHES
from depthmocap.synth.render import Material, render_person
from depthmocap.synth.scenes.room import Box, Room, render_room, shelf, table
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS, SensorPreset

FPS = 8.0
#: To where the person has risen from the squat: the rest of the motion would be a ninth of the package's size.
SETS = 67
START_NS = 1_700_000_000_000_000_000
#: Cameras are not triggered together: each is late or early by this much in every set.
JITTER_S = 0.003
#: Depth is written in steps of so many of its units (mm), below the noise: a third of the recording's size.
DEPTH_STEP = 4
#: The camera without a background frame; its empty scene has to be learnt from the recording.
LEARNT_CAMERA = "cam2"

PERSON = Phenotype(gender=0.25, age=0.68, muscle=0.5, weight=0.45, height=0.55)
ROOM = Room(
    Box((-2.9, -3.0, 0.0), (2.9, 2.7, 4.0)),
    (
        *table((-0.75, 1.75), (0.75, 2.45), 0.74),
        *shelf((-2.9, -1.1), (-2.55, 0.3), 1.8, 5),
        Box((2.3, -1.9, 0.0), (2.9, -1.1, 1.1)),  # a chest of drawers
        Box((1.2, -1.9, 0.0), (1.8, -1.3, 0.75)),  # an armchair, roughly
        Box((0.62, 0.1, 0.0), (0.97, 0.45, 0.42)),  # a stool, which hides a foot from cam1 at times
    ),
)


@dataclasses.dataclass(frozen=True)
class _Mount:
    """A camera on its stand: metres from the origin over the floor, and the height it looks at there."""

    sensor: SensorPreset
    azimuth_deg: float
    distance_m: float
    height_m: float
    aim_m: float


def _half(preset: SensorPreset) -> SensorPreset:
    """A sensor with images at half their size."""
    return dataclasses.replace(
        preset, width=preset.width // 2, height=preset.height // 2, fx=preset.fx / 2, fy=preset.fy / 2,
        cx=preset.cx / 2 - 0.25, cy=preset.cy / 2 - 0.25,
    )  # fmt: skip


_MOUNTS = {
    "cam0": _Mount(SENSORS["azure-nfov-binned"], 8.0, 2.6, 1.15, 1.12),
    "cam1": _Mount(SENSORS["azure-nfov-binned"], 121.0, 2.65, 1.95, 1.08),
    "cam2": _Mount(_half(SENSORS["kinect2"]), -114.0, 2.7, 1.5, 1.1),
}


def demo_rig() -> Rig:
    """The three cameras; an azimuth is counted from −Y, where the person looks at the start, towards +X."""
    cameras = []
    for name, mount in _MOUNTS.items():
        azimuth = np.deg2rad(mount.azimuth_deg)
        eye = np.array([np.sin(azimuth) * mount.distance_m, -np.cos(azimuth) * mount.distance_m, mount.height_m])
        pose = look_at(eye, np.array([0.0, 0.0, mount.aim_m])).round(6)  # as exact as a calibration, and readable
        cameras.append(mount.sensor.camera(name, pose))
    return Rig(tuple(cameras))


def demo_body() -> DressedBody:
    """The person, dressed. Needs the extra ``train``."""
    return clothe(BodyModel.load().shape(PERSON), ORDINARY_CLOTHES, np.random.default_rng(7))


def demo_backgrounds(seed: int = 0) -> dict[str, Float[ndarray, "_ _"]]:
    """Depth (metres) that each camera reads of the empty room."""
    rng = np.random.default_rng([seed, 0])
    backgrounds = {}
    for camera in demo_rig().cameras:
        depth_m = render_room(ROOM, camera)
        material = np.full(depth_m.shape, Material.SCENE, np.uint8)
        backgrounds[camera.name] = sense(depth_m, material, camera, _MOUNTS[camera.name].sensor.model, rng)
    return backgrounds


def demo_frames(seed: int = 0, sets: int | None = None, fps: float = FPS) -> Iterator[tuple[dict[str, int], FrameSet]]:
    """The frames: each camera's own timestamp (ns), and the views with their true masks, labels and joints.

    The person is where they are at each camera's own time; the true joints are of the set's median time.

    Raises:
        ValueError: when the motion is shorter than ``sets``; by default there are ``fps`` per second of the whole
            motion.
    """
    most = round(DEMO_SECONDS * fps)
    sets = most if sets is None else sets
    if not 1 <= sets <= most:
        raise ValueError(f"sets must be in 1 to {most}, got {sets}")
    rng = np.random.default_rng([seed, 1])
    body, rig = demo_body(), demo_rig()
    rooms = {camera.name: render_room(ROOM, camera) for camera in rig.cameras}
    nominal_s = np.arange(sets) / fps + JITTER_S
    times_s = nominal_s + rng.uniform(-JITTER_S, JITTER_S, (len(rig.cameras), sets))
    times_s = times_s.round(6)  # whole microseconds
    middle_s = np.median(times_s, axis=0)
    moving = [pose_sequence(body, demo_motion(body, times)) for times in times_s]
    for i, truth in enumerate(pose_sequence(body, demo_motion(body, middle_s))):
        views = []
        for camera, poses in zip(rig.cameras, moving, strict=True):
            rendering = render_person(next(poses), camera, rooms[camera.name])
            depth = sense(rendering.depth_m, rendering.material, camera, _MOUNTS[camera.name].sensor.model, rng)
            views.append(View(camera, depth, rendering.person & (depth > 0), rendering.labels))
        stamps = {camera.name: _stamp_ns(times_s[k, i]) for k, camera in enumerate(rig.cameras)}
        yield stamps, FrameSet(_stamp_ns(middle_s[i]), tuple(views), truth.joints)


def _stamp_ns(time_s: float) -> int:
    return START_NS + round(float(time_s) * 1e6) * 1000


def _raw(depth_m: Float[ndarray, "h w"], camera: DepthCamera) -> UInt16[ndarray, "h w"]:
    return (DEPTH_STEP * np.round(depth_m / camera.depth_unit_m / DEPTH_STEP)).astype(np.uint16)


def write_demo(path: Path, seed: int = 0, sets: int = SETS) -> None:
    """Write the demo recording, or its first sets, to a new folder.

    Raises:
        InputError: when the folder already holds something.
    """
    rig = demo_rig()
    backgrounds = {
        name: _raw(depth_m, rig[name]) for name, depth_m in demo_backgrounds(seed).items() if name != LEARNT_CAMERA
    }
    with RecordingWriter(path, rig, backgrounds, compression=9) as writer:
        for stamps, frame_set in demo_frames(seed, sets):
            for view in frame_set.views:
                name = view.camera.name
                writer.write(stamps[name], {name: _raw(view.depth_m, view.camera)})
            assert frame_set.true_joints is not None
            writer.write(frame_set.timestamp_ns, {}, frame_set.true_joints.round(5))


def _main(out: Path, /, seed: int = 0) -> None:
    """Write the demo recording.

    Args:
        out: a new folder.
        seed: of the noise.
    """
    write_demo(out, seed)


if __name__ == "__main__":
    tyro.cli(_main)
