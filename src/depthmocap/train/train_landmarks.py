"""``depthmocap train landmarks``: where surface landmarks are on a skeleton of given lengths."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.body.landmarks import LANDMARK_MIRROR, LANDMARKS
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import atomic_write
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.landmark_model import LandmarkModel, build_of, person_size_m
from depthmocap.exporting.timeline import Timeline
from depthmocap.geometry import z_up_from
from depthmocap.synth.body.hands import random_grip, with_hands
from depthmocap.synth.body.mesh import REST_POSTURE, Body, BodyModel, Phenotype
from depthmocap.synth.body.mesh_landmarks import landmark_vertices, posed_landmarks
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.motion.true_rotations import bone_frames, t_pose_from_rest

_Y_UP = z_up_from("y").T
_FLIP = np.array([-1.0, 1.0, 1.0])
_JOINT = np.array([JOINT_INDEX[landmark.joint] for landmark in LANDMARKS])
_BONE = np.array([JOINT_INDEX[landmark.bone] for landmark in LANDMARKS])
#: Bones whose rotation follows from the joints on several sides of them: their frame is the solved skeleton's.
_TRUNK = [JOINT_INDEX[name] for name in ("Hip", "Spine", "Spine1", "Spine2")]
#: Lengths are scaled to differ by about 1 from person to person; of that the squared coefficients weigh so much.
_RIDGE = 1e-2


@dataclasses.dataclass(frozen=True)
class LandmarkTraining:
    """Learn where surface landmarks are from the lengths of bones, on bodies of many builds.

    Attributes:
        out: the .npz file to write.
        bodies: of random builds to learn from.
        held_out: bodies to measure on, each in several postures of the packaged prior.
        postures: of each.
    """

    out: Path
    bodies: int = 400
    held_out: int = 60
    postures: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        if self.out.suffix != ".npz":
            raise InputError(f"--out must be a file that ends in .npz, got {self.out}")
        if self.bodies < 20 or min(self.held_out, self.postures) < 1:
            raise InputError("--bodies takes at least 20, --held-out and --postures at least 1")


@locks_outputs(files=("out",))
def train_landmarks(settings: LandmarkTraining, console: Console | None = None) -> Path:
    """Fit, measure on other bodies in postures of the prior, and write.

    Raises:
        InputError: when anny is not installed, or the file cannot be written.
    """
    console = console or Terminal(stderr=True)
    rng = np.random.default_rng(settings.seed)
    model = BodyModel.load()
    with Progress(console=console) as progress:
        rows = [
            rest_landmarks(_person(model, rng)) for _ in progress.track(range(settings.bodies), description="bodies")
        ]
        fitted = _fit(np.stack([build for build, _ in rows]), np.stack([places for _, places in rows]))
        fitted_model = LandmarkModel(fitted, np.zeros(len(LANDMARKS)))
        errors = [
            _errors(_person(model, rng), fitted_model, settings.postures, rng)
            for _ in progress.track(range(settings.held_out), description="measuring")
        ]
    error = np.concatenate(errors).mean(0)
    error = (error + error[LANDMARK_MIRROR]) / 2
    with atomic_write(settings.out) as unfinished:
        np.savez_compressed(unfinished, coefficients=fitted.astype(np.float32), error=error.astype(np.float32))
    size_m = person_size_m(_rest_offsets(model.shape(Phenotype())))
    for i, landmark in enumerate(LANDMARKS):
        if i <= LANDMARK_MIRROR[i]:  # both sides have one error
            console.print(f"{landmark.name}: {1e3 * error[i] * size_m:.0f} mm of an adult")
    return settings.out


def _person(model: BodyModel, rng: np.random.Generator) -> Body:
    """From children of about six to old people, slim to heavy, with any grip."""
    build = Phenotype(*rng.uniform([0.0, 0.3, 0.2, 0.1, 0.1, 0.1], [1.0, 1.0, 0.9, 0.9, 0.9, 0.9]).tolist())
    return with_hands(model.shape(build), random_grip(rng), random_grip(rng))


def _rest_joints(body: Body) -> Float[ndarray, "18 3"]:
    return body.rest_heads[body.model.joint_bones] @ _Y_UP.T


def _rest_offsets(body: Body) -> Float[ndarray, "18 3"]:
    return solve_body(Timeline(np.zeros(1), _rest_joints(body)[None], 1 / 30)).offsets


def rest_landmarks(body: Body) -> tuple[Float[ndarray, " b"], Float[ndarray, "m 3"]]:
    """A body's build, and where its landmarks are in the frames of bones, in units of its size."""
    joints = _rest_joints(body)
    motion = solve_body(Timeline(np.zeros(1), joints[None], 1 / 30))
    frames = np.swapaxes(t_pose_from_rest(body), -1, -2)
    frames[_TRUNK] = motion.world_rotations()[0, _TRUNK]
    seen = body.rest_vertices[landmark_vertices()] @ _Y_UP.T - joints[_JOINT]
    inside = np.einsum("mji,mj->mi", frames[_BONE], seen)
    return build_of(motion.offsets), inside / person_size_m(motion.offsets)


def _fit(builds: Float[ndarray, "n b"], places: Float[ndarray, "n m 3"]) -> Float[ndarray, "m b 3"]:
    """Ridge regression; both sides are one, mirrored."""
    places = (places + places[:, LANDMARK_MIRROR] * _FLIP) / 2
    mean, scale = builds[:, 1:].mean(0), builds[:, 1:].std(0)
    inputs = np.concatenate([builds[:, :1], (builds[:, 1:] - mean) / scale], 1)
    penalty = _RIDGE * len(inputs) * np.diag([0.0, *np.ones(inputs.shape[1] - 1)])
    weights = np.linalg.solve(inputs.T @ inputs + penalty, inputs.T @ places.reshape(len(places), -1))
    weights[1:] /= scale[:, None]
    weights[0] -= mean @ weights[1:]
    return np.moveaxis(weights.reshape(-1, *places.shape[1:]), 0, 1)


def _errors(body: Body, fitted: LandmarkModel, count: int, rng: np.random.Generator) -> Float[ndarray, "n m"]:
    """Distances of landmarks from the truth where the skeleton is true, in postures; in units of the body's size."""
    postures = np.stack([REST_POSTURE, *(PosturePrior.load().sample(rng)[0] for _ in range(count))])
    truth = posed_landmarks(body, postures) @ _Y_UP.T
    joints = np.stack([body.pose(posture).joints for posture in postures]) @ _Y_UP.T
    offsets = _rest_offsets(body)
    size_m = person_size_m(offsets)
    frames = bone_frames(body, postures)
    for i, posed in enumerate(joints):
        motion = solve_body(Timeline(np.zeros(1), posed[None], 1 / 30), offsets=offsets)
        frames[i, _TRUNK] = motion.world_rotations()[0, _TRUNK]
    markers = joints[:, _JOINT] + np.einsum("tmij,mj->tmi", frames[:, _BONE], fitted.offsets_m(offsets))
    return (np.linalg.norm(markers - truth, axis=-1) / size_m)[1:]
