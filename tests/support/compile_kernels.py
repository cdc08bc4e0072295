"""Compiles the kernels that tests use, for ``make body``: each process of the tests would compile them for itself."""

from __future__ import annotations

import itertools

import numpy as np

from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.timeline import timeline
from depthmocap.geometry import DepthCamera
from depthmocap.offline.pipeline_settings import PipelineSettings, load_pipeline
from depthmocap.recordings.open_recording import open_recording, packaged_recording
from depthmocap.synth.motion.cover import Cover, farthest_points
from depthmocap.synth.motion.postures import joint_positions
from depthmocap.synth.sample import Recipe, Sampler
from depthmocap.synth.scenes.solids import box


def _compile_capture() -> None:
    recording = open_recording(packaged_recording())
    for settings in (PipelineSettings(), PipelineSettings(segment="background", estimator="ridge")):
        pipeline = load_pipeline(recording, settings)
        poses = [pipeline(frames).pose for frames in itertools.islice(recording, 3)]
    solve_body(timeline(poses, recording.up))


def _compile_data_engine() -> None:
    Sampler(Recipe("open", noise="sensor", scene="full"), 0)(0)
    camera = DepthCamera("bent", 32, 24, 30.0, 30.0, 15.5, 11.5, np.eye(4), (0.1, 0.0, 0.0, 0.0, 0.0))
    depth_m = np.full((24, 32), np.inf, np.float32)
    box((0.0, 0.0, 2.0), (0.5, 0.5, 0.5)).draw(camera, depth_m, np.zeros(depth_m.shape, np.uint8))


def _compile_postures() -> None:
    postures = np.random.default_rng(0).normal(0, 0.3, (60, 20, 3))
    Cover(0.01, 20).add(postures, np.arange(60))
    farthest_points(joint_positions(postures).astype(np.float32), [(np.ones(60, dtype=bool), 5)])


if __name__ == "__main__":
    _compile_capture()
    _compile_data_engine()
    _compile_postures()
