"""Moving people with known joints, seen by depth cameras with their errors: sequences for temporal metrics.

Motion comes from clips, or is interpolated between postures of the packaged prior. Clips hold postures only, so the
trajectory over the floor follows from the feet: the supporting foot does not slip. Each sequence ends at rest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, View
from depthmocap.synth.body.bones import heading, turn_posture
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype
from depthmocap.synth.motion.mocap import Clip, ClipFolder, split_of
from depthmocap.synth.motion.postures import PosturePrior, anny_rest
from depthmocap.synth.people.bodies import random_dressed_body
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import PosedPerson, render_person
from depthmocap.synth.sample import CameraRange, Split, random_camera
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SensorPreset

#: Frames per second, the rate of clips as they are read.
FPS = 30.0
#: A sequence slows down to a stop over its last seconds.
STOP_S = 0.4
#: Then it rests for this long, seconds.
REST_S = 0.7
#: Largest distance of the pelvis from the middle of its trajectory, metres, so that fixed cameras see the person.
REACH_M = 1.0
#: Camera positions from which a moving person stays in the image.
CAMERAS = CameraRange(distance_m=(2.4, 3.8), height_m=(0.8, 2.3))
#: A foot supports the body when it is about this much lower than the other, metres.
_STANDING_M = 0.015
#: Postures of the prior: time from one to the next, seconds.
_CHANGE_S = (0.5, 1.2)
#: Largest turn between two of them, radians.
_TURN_RAD = 0.7
#: How long each is held, seconds.
_HOLD_S = 0.3
_FEET = [JOINT_INDEX["LFoot"], JOINT_INDEX["RFoot"]]


@dataclasses.dataclass(frozen=True, eq=False)
class PostureSequence:
    """Postures at ``FPS`` frames per second, and the name of their source."""

    name: str
    postures: Float[ndarray, "t 20 3"]


def clip_motions(
    folder: Path, split: Split, count: int, seconds: float, rng: np.random.Generator
) -> Iterator[PostureSequence]:
    """Parts of a split's clips, one of each clip, in random order: ``seconds`` of motion, then rest.

    Clips are skipped when they are shorter, travel too far, or have an impossible frame.

    Raises:
        InputError: when the folder has fewer such clips.
    """
    clips = ClipFolder.open(folder)
    files = [path for path in clips.files if split_of(path.stem) == split]
    files = [files[i] for i in rng.permutation(len(files))]
    made = 0
    body = BodyModel.load().shape(Phenotype())
    for clip in dataclasses.replace(clips, files=files).read(anny_rest()):
        if made == count:
            return
        if isinstance(clip, Clip) and len(clip.postures) == clip.frames:
            part = _most_active(body, clip.postures.astype(np.float64), round(seconds * FPS))
            if part is not None:
                made += 1
                yield PostureSequence(clip.name, _to_rest(part))
    if made < count:
        raise InputError(
            f"{folder}: {made} clips of the {split} split have {seconds:g} s of motion within {REACH_M} m, "
            f"{count} are wanted; lower --sequences or --seconds, or give more clips"
        )


def prior_motions(count: int, seconds: float, rng: np.random.Generator) -> Iterator[PostureSequence]:
    """PostureSequence from posture to posture of the packaged prior, each held a while; then rest."""
    prior = PosturePrior.load()
    for index in range(count):
        times, keys = [0.0], [prior.sample(rng)[0]]
        while times[-1] < seconds + STOP_S:
            following = prior.sample(rng)[0]
            turn = heading(keys[-1]) - heading(following) + rng.uniform(-_TURN_RAD, _TURN_RAD)
            following = turn_posture(following, turn)
            times += [times[-1] + _HOLD_S, times[-1] + _HOLD_S + rng.uniform(*_CHANGE_S)]
            keys += [keys[-1], following]
        at = np.arange(round(seconds * FPS)) / FPS
        yield PostureSequence(f"prior {index}", _to_rest(_between(np.array(times), np.stack(keys), at, eased=True)))


def _between(
    times: Float[ndarray, "k"], keys: Float[ndarray, "k 20 3"], at: Float[ndarray, "t"], eased: bool = False
) -> Float[ndarray, "t 20 3"]:
    """Postures at times, every bone turned along the shortest way between its keys."""
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    share = np.clip((at - times[before]) / (times[before + 1] - times[before]), 0, 1)
    if eased:
        share = share**3 * (10 - 15 * share + 6 * share**2)  # least jerk: at rest at both ends
    start, end = (Rotation.from_rotvec(keys[i].reshape(-1, 3)) for i in (before, before + 1))
    turn = (start.inv() * end).as_rotvec() * np.repeat(share, keys.shape[1])[:, None]
    return (start * Rotation.from_rotvec(turn)).as_rotvec().reshape(len(at), -1, 3)


def _to_rest(postures: Float[ndarray, "t 20 3"]) -> Float[ndarray, "u 20 3"]:
    """The motion slowed down to a stop over its last ``STOP_S``, which take twice as long, then still."""
    stop, rest = round(STOP_S * FPS), round(REST_S * FPS)
    last = len(postures) - 1
    steps = np.arange(1, 2 * stop + 1) / (2 * stop)
    slowing = last - stop + stop * (2 * steps - steps**2)
    at = np.concatenate([np.arange(last - stop + 1), slowing, np.full(rest, last)])
    return _between(np.arange(len(postures), dtype=float), postures, np.minimum(at, last))


def _most_active(body: Body, postures: Float[ndarray, "n 20 3"], length: int) -> Float[ndarray, "t 20 3"] | None:
    """The ``length`` frames with the most rotation of the bones that stay within reach; None where there are none."""
    if len(postures) < length:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(pelvis_trajectory(body, postures), length, axis=0)
    in_reach = np.ptp(windows, axis=-1).max(1) <= 2 * REACH_M
    if not in_reach.any():
        return None
    flat = Rotation.from_rotvec(postures.reshape(-1, 3))
    bones = postures.shape[1]
    turns = (flat[:-bones].inv() * flat[bones:]).magnitude().reshape(-1, bones).sum(1)
    total = np.concatenate([[0.0], np.cumsum(turns)])
    activity = np.where(in_reach, total[length - 1 :] - total[: len(in_reach)], -1.0)
    first = int(activity.argmax())
    return postures[first : first + length]


def pelvis_trajectory(body: Body, postures: Float[ndarray, "t 20 3"]) -> Float[ndarray, "t 2"]:
    """Displacement of the pelvis in x and y (metres), about the origin, such that the supporting foot does not slip."""
    bones = body.model.joint_bones[_FEET]
    feet = np.stack([body.bone_transforms(posture).heads[bones] for posture in postures]).astype(np.float64)
    height = feet[:, :, 2] - feet[:, :, 2].min(1, keepdims=True)
    load = np.exp(-height / _STANDING_M)
    load /= load.sum(1, keepdims=True)
    load = (load[1:] + load[:-1]) / 2
    steps = -(load[:, :, None] * np.diff(feet[:, :, :2], axis=0)).sum(1)
    trajectory = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return trajectory - (trajectory.max(0) + trajectory.min(0)) / 2


def moving_person(rng: np.random.Generator) -> DressedBody:
    """The person of :func:`moving_frames` with a generator in the same state."""
    return random_dressed_body(rng, "open")


def moving_frames(
    motion: PostureSequence,
    views: int,
    sensors: tuple[SensorPreset, ...],
    rng: np.random.Generator,
    out_of_step_s: float = 0.0,
) -> Iterator[FrameSet]:
    """A random dressed person moves on the floor z = 0 and random cameras look on, with true masks and joints.

    Timestamps start at 0; the true joints are those at the timestamp. All cameras capture at that time, or each with a
    constant offset of up to ``out_of_step_s``. The timestamp is then the median of the cameras' times, as in
    synchronisation. Person, cameras and random numbers do not depend on the offsets.
    """
    step_rng = rng.spawn(1)[0]
    dressed = moving_person(rng)
    trajectory = np.pad(pelvis_trajectory(dressed.body, motion.postures), ((0, 0), (0, 1)))
    first_pose = _standing(dressed, motion.postures[0], np.zeros(3)).body
    presets = [sensors[int(rng.integers(len(sensors)))] for _ in range(views)]
    cameras = [random_camera(rng, first_pose, CAMERAS, preset, f"cam{i}") for i, preset in enumerate(presets)]
    steps = step_rng.uniform(-out_of_step_s, out_of_step_s, views)
    times = np.arange(len(trajectory)) + (steps - np.median(steps))[:, None] * FPS
    motions = [_at_times(motion.postures, trajectory, at) for at in times]
    for index, (posture, offset) in enumerate(zip(motion.postures, trajectory, strict=True)):
        person = _standing(dressed, posture, offset)
        captured = []
        for camera, preset, at, (postures, offsets) in zip(cameras, presets, times, motions, strict=True):
            posed = person if at[index] == index else _standing(dressed, postures[index], offsets[index])
            drawn = render_person(posed, camera)
            depth = sense(drawn.depth_m, drawn.material, camera, preset.model, rng)
            captured.append(View(camera, depth, drawn.person & (depth > 0)))
        yield FrameSet(round(index / FPS * 1e9), tuple(captured), person.joints)


def _at_times(
    postures: Float[ndarray, "t 20 3"], trajectory: Float[ndarray, "t 3"], at: Float[ndarray, "n"]
) -> tuple[Float[ndarray, "n 20 3"], Float[ndarray, "n 3"]]:
    """Postures and positions at times in frame numbers, interpolated; constant before the first and after the last."""
    frames = np.arange(len(postures), dtype=float)
    places = np.stack([np.interp(at, frames, axis) for axis in trajectory.T], axis=1)
    return _between(frames, postures, np.clip(at, 0, frames[-1])), places


def _standing(dressed: DressedBody, posture: Float[ndarray, "20 3"], offset: Float[ndarray, "3"]) -> PosedPerson:
    person = dressed.pose(posture)
    return person.moved(np.eye(3), offset - np.array([0.0, 0.0, person.lowest_m]))
