"""The regression that tells when a toe leaves the floor, made once: on walks of motion capture and walks made by rule.

    python benchmarks/make_toe_off.py CLIPS src/depthmocap/analysis/toe_off.npz

CLIPS is a folder as of ``evaluate analysis``, with a manifest.csv that describes its BVH files. One body performs all
clips of the training split, another each walk by rule; joints are moved by about a centimetre and filtered as
``analyse`` does it. Prints errors of the clips of other splits, and of other walks by rule.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import numpy as np
from numpy import ndarray

from depthmocap.analysis.gait_events import ankle_speed, speed_peaks
from depthmocap.analysis.joint_angles import SIDES
from depthmocap.analysis.steady_joints import SteadyJoints, low_pass
from depthmocap.analysis.toe_off import design, swing_features
from depthmocap.evaluate.moving_people import FPS
from depthmocap.evaluate.walking_scenes import captured_walk, sole_points, true_swings, walks
from depthmocap.geometry import z_up_from
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype
from depthmocap.synth.motion.perform import Motion
from depthmocap.synth.motion.stroll import Stop, stroll
from depthmocap.synth.people.bodies import random_dressed_body
from depthmocap.synth.sample import Split

_Y_UP = z_up_from("y").T
_CUTOFF_HZ = 6.0
#: Errors of joints (m): those that last for a while, and those of every frame.
_SLOW_M, _FAST_M = 0.008, 0.002
#: Repetitions of the training clips with other errors; walks by rule, the last of which are for the test.
_REPEATS, _BY_RULE, _TESTED = 3, 16, 5
#: Of the sum of squares of coefficients, against as many samples as there are.
_RIDGE = 50.0
#: Further off than this is an outlier (s), which counts by its distance and not by its square.
_NEAR_S = 0.01

Samples = list[tuple[float, ndarray]]


def samples(body: Body, motion: Motion, rng: np.random.Generator) -> Samples:
    """Of every swing when the toe leaves, from half of the peak speed on (s), and its features."""
    model, soles = body.model, sole_points()
    joints, points = [], {side: [] for side in soles}
    for posture, offset in zip(motion.postures, motion.offsets, strict=True):
        bones = body.bone_transforms(posture)
        joints.append(bones.heads[model.joint_bones] + offset)
        for side, vertices in soles.items():
            own = (array[list(vertices)] for array in (body.rest_vertices, model.skin_indices, model.skin_weights))
            points[side].append(bones.skin(*own) + offset)
    exact = np.stack(joints).astype(np.float64) @ _Y_UP.T
    slow = low_pass(rng.normal(0, _SLOW_M, exact.shape), 1 / FPS, _CUTOFF_HZ)
    seen = exact + slow + rng.normal(0, _FAST_M, exact.shape)
    steady = SteadyJoints(np.arange(len(exact)) / FPS, low_pass(seen, 1 / FPS, _CUTOFF_HZ), 1 / FPS)
    found = []
    for side in soles:
        speed = ankle_speed(steady, side)
        peaks = speed_peaks(speed, 1 / FPS)
        for swing in true_swings(np.stack(points[side]).astype(np.float64), side):
            own = [at for at in peaks if swing.toe_off_s - 0.1 < at / FPS < swing.heel_strike_s + 0.1]
            told = swing_features(steady, SIDES[side], speed, max(own, key=lambda at: speed[at])) if own else None
            if told is not None:
                found.append((swing.toe_off_s - told[0] / FPS, told[1]))
    return found


def by_rule(number: int, rng: np.random.Generator) -> tuple[Body, Motion]:
    """Somebody who walks straight on and back, or round a square."""
    far = rng.uniform(0.85, 1.1)
    stops = [Stop(0.0, 1.9 * far), Stop(0.0, -1.9 * far)]
    if number % 2:
        stops = [Stop(-1.1 * far, far), Stop(-far, -far), Stop(far, -1.1 * far), Stop(1.1 * far, far)]
    way = sum(np.hypot(b.x - a.x, b.y - a.y) for a, b in itertools.pairwise(stops))
    speed = rng.uniform(0.6, 1.4)
    dressed = random_dressed_body(rng, "open")
    return dressed.body, stroll(dressed, stops, 0.4, speed, np.arange(round((way / speed + 1) * FPS)) / FPS)


def fit(groups: list[Samples]) -> tuple[ndarray, ndarray, ndarray]:
    """Mean, scale and coefficients; each group counts alike, and outliers little."""
    features = np.concatenate([np.stack([row for _, row in group]) for group in groups])
    wanted = np.concatenate([[later_s for later_s, _ in group] for group in groups])
    share = np.concatenate([np.full(len(group), len(wanted) / len(groups) / len(group)) for group in groups])
    mean, scale = features.mean(0), features.std(0) + 1e-6
    inputs, weights = design(features, mean, scale), share
    coefficients = np.zeros(inputs.shape[1])
    for _ in range(30):
        weighted = inputs * weights[:, None]
        penalty = _RIDGE * np.eye(inputs.shape[1])
        coefficients = np.linalg.solve(weighted.T @ inputs + penalty, weighted.T @ wanted)
        weights = share / np.maximum(np.abs(inputs @ coefficients - wanted) / _NEAR_S, 1.0)
    return mean, scale, coefficients


def tell(what: str, group: Samples, model: tuple[ndarray, ndarray, ndarray]) -> None:
    mean, scale, coefficients = model
    wanted = np.array([later_s for later_s, _ in group])
    off = design(np.stack([row for _, row in group]), mean, scale) @ coefficients - wanted
    for words, errors in (("half of the peak speed", wanted), ("the regression", off)):
        within = np.mean(np.abs(errors) <= 0.04)
        print(f"{what}, {words}: {1e3 * np.abs(errors).mean():.0f} ms, {within:.0%} within 40 ms of {len(errors)}")


def main(clips: Path, path: Path) -> None:
    rng = np.random.default_rng(0)
    body = BodyModel.load().shape(Phenotype())
    captured: dict[Split, Samples] = {"train": [], "valid": [], "test": []}
    for split, group in captured.items():
        for name in walks(clips, split):
            motion = captured_walk(clips / name, body)
            if motion is None:
                continue
            for _ in range(_REPEATS if split == "train" else 1):
                group += samples(body, motion, rng)
    ruled: list[Samples] = [[], []]
    for number in range(_BY_RULE):
        ruled[number >= _BY_RULE - _TESTED] += samples(*by_rule(number, rng), rng)
    model = fit([captured["train"], ruled[0]])
    for what, group in (*((f"captured, {split}", captured[split]) for split in captured), ("by rule", ruled[1])):
        tell(what, group, model)
    np.savez_compressed(path, **dict(zip(("mean", "scale", "coefficients"), model, strict=True)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
