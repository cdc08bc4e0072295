"""Rows of segmentation, of aggregation and joints, and of the whole pipeline."""

from __future__ import annotations

import dataclasses
import importlib.resources
import time
from pathlib import Path

import numpy as np
from body_rows import camera_before
from label_rows import load_classifier
from numpy import ndarray
from timing import Bench, Reference, Row, Timing

from depthmocap.body.regions import REGION_COUNT
from depthmocap.evaluate.moving_people import moving_frames, prior_motions
from depthmocap.frames import FrameSet, Pose, View
from depthmocap.geometry.transforms import transform_points
from depthmocap.offline.pipeline import STAGES, Pipeline
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import RidgeEstimator, load_estimator
from depthmocap.pose.features import FEATURES_PER_REGION, MIN_POINTS, cloud_features
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.parts import body_frame, part_statistics
from depthmocap.pose.ridge import RidgePose
from depthmocap.recordings.recording import Recording
from depthmocap.segment.people_segmenter import PeopleSegmenter, PersonMasks
from depthmocap.smooth.filters import AUTO, load_filter
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.people.bodies import random_dressed_body
from depthmocap.synth.render import render_person
from depthmocap.synth.sample import CameraRange, Recipe, Sampler
from depthmocap.synth.scenes.room import Box, Room, render_room
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS

#: Goal of the segmentation of a view, milliseconds.
SEGMENT_GOAL_MS = 3.0
#: Goal of the features of four views, milliseconds.
FEATURES_GOAL_MS = 4.0
#: Goal of the joints of four views, milliseconds.
POSE_GOAL_MS = 8.0
#: Goal of a set of four views from masked depth, median, milliseconds.
SET_GOAL_MS = 33.3
#: The same, 95th percentile, milliseconds.
SET_P95_GOAL_MS = 60.0
#: The distance at which a body just fits into a Kinect 2's picture: about 30,000 pixels.
_NEAR = CameraRange(distance_m=(1.4, 1.4), height_m=(0.8, 1.2), aim_m=0.0)


def joints(bench: Bench) -> None:
    """From four labelled views to features, to joints by the paper's ridge, and by votes and smoothed."""
    ridge, votes, smooth = load_estimator("ridge"), load_estimator("votes"), load_filter(AUTO)
    assert isinstance(ridge, RidgeEstimator)
    bank = ridge.bank
    # Of some samples, the one nearest to 30,000 pixels a view.
    draw = Sampler(Recipe("open", views=4, sensors=("kinect2",), noise="sensor", cameras=_NEAR), seed=6)
    samples = [draw(i) for i in range(12)]
    sample = min(samples, key=lambda s: abs(sum(int((v.depth_m > 0).sum()) for v in s.views) - 120_000))
    parts: list[LabelledView] = []
    for view in sample.views:
        assert view.mask is not None and view.labels is not None
        labels = np.where(view.mask, view.labels, 0).astype(np.uint8)
        parts.append(LabelledView(view, labels, view.mask.astype(np.float32)))

    def ours() -> tuple[ndarray, ndarray]:
        return ridge(merge_views(parts))

    def plain() -> ndarray:
        return _plain_joints(bank.model_for(len(parts)), parts)[1]

    now_ns = 0

    def voted() -> Pose:
        nonlocal now_ns
        now_ns += 33_000_000
        return smooth(Pose(now_ns, *votes(merge_views(parts))))

    def features() -> ndarray:
        return cloud_features(merge_views(parts), "z", bank.frame).values

    plain_features = _plain_joints(bank.model_for(len(parts)), parts)[0]
    feature_error = float(np.nanmax(np.abs(features() - plain_features)))
    error_mm = float(np.abs(ours()[0] - plain()).max() * 1e3)
    same_seen = np.array_equal(np.isnan(features()), np.isnan(plain_features))
    bench.measure("Merge 4 views, features of the regions", features, goal_ms=FEATURES_GOAL_MS)
    bench.measure(
        "Merge 4 views, joints by ridge", ours, Reference("plain NumPy", plain), goal_ms=POSE_GOAL_MS,
        agrees=same_seen and feature_error < 1e-4 and error_mm < 0.5,
        note=f"{len(merge_views(parts))} points; features within {feature_error:.2g}, joints within {error_mm:.2g} mm",
    )  # fmt: skip
    bench.measure(
        "Merge 4 views, joints by votes, smooth", voted, Reference("by ridge, not smoothed", ours),
        goal_ms=POSE_GOAL_MS,
    )  # fmt: skip


def _plain_joints(model: RidgePose, parts: list[LabelledView]) -> tuple[ndarray, ndarray]:
    """Features and joints as a direct reading of the paper's text computes them."""
    points = np.concatenate(
        [
            transform_points(view.camera.world_from_camera, view.camera.unproject(view.depth_m, labels > 0))
            for view, labels, *_ in parts
        ]
    )
    regions = np.concatenate([labels[(labels > 0) & (view.depth_m > 0)] for view, labels, *_ in parts])
    turn = body_frame(part_statistics(merge_views(parts))).rotation if model.frame == "body" else np.eye(3)
    points = points @ turn.T
    centre = np.zeros(3) if model.frame == "world" else np.median(points, axis=0)
    features = np.full((REGION_COUNT, FEATURES_PER_REGION), np.nan)
    for region in range(1, REGION_COUNT + 1):
        region_points = points[regions == region] - centre
        if len(region_points) >= MIN_POINTS:
            covariance = np.cov(region_points, rowvar=False, bias=True)
            features[region - 1] = np.concatenate(
                [
                    np.median(region_points, axis=0), covariance.ravel(), np.linalg.eigvalsh(covariance),
                    region_points.std(0), region_points.min(0), region_points.max(0),
                ]
            )  # fmt: skip
    x = np.nan_to_num((features.ravel() - model.mean) / model.scale)
    return features.ravel(), ((x @ model.weights + model.bias).reshape(-1, 3) + centre) @ turn


def segmentation(bench: Bench) -> None:
    """The person before a static room, against the bare comparison with the background."""
    rng = np.random.default_rng(7)
    posed = random_dressed_body(rng, "easy").pose(PosturePrior.load().sample(rng)[0])
    centre = posed.vertices.mean(0).astype(float)
    camera = camera_before(centre, 2.6)
    x, y, floor = float(centre[0]), float(centre[1]), float(posed.vertices[:, 2].min()) - 0.005
    chest = Box((x + 0.9, y + 0.8, floor), (x + 1.5, y + 1.6, floor + 0.9))
    room = render_room(Room(Box((x - 3, y - 3.5, floor), (x + 3, y + 2.5, floor + 2.6)), (chest,)), camera)
    model = SENSORS["kinect2"].model
    background = sense(room, None, camera, model, rng)
    rendering = render_person(posed, camera, room)
    view, truth = View(camera, sense(rendering.depth_m, rendering.material, camera, model, rng)), rendering.person
    segmenter, now_ns = PeopleSegmenter({camera.name: background}), 0

    def ours() -> tuple[PersonMasks, ...]:
        nonlocal now_ns
        now_ns += 33_000_000
        return segmenter(FrameSet(now_ns, (view,)))

    def plain() -> ndarray:
        return (view.depth_m > 0) & (view.depth_m < background - 0.05)

    people = [ours() for _ in range(30)][-1]  # a person is reported only after a while
    detected = people[0].masks[0] if people else np.zeros_like(truth)
    shares = [_overlap(mask, truth & (view.depth_m > 0)) for mask in (detected, plain())]
    bench.measure(
        "Find the person in a view", ours, Reference("bare threshold (a floor)", plain), goal_ms=SEGMENT_GOAL_MS,
        note=f"overlap with the truth {shares[0]:.1%}, of the threshold {shares[1]:.1%}",
    )  # fmt: skip


def _overlap(mask: ndarray, truth: ndarray) -> float:
    """Intersection over union."""
    return float((mask & truth).sum() / max((mask | truth).sum(), 1))


def four_cameras(bench: Bench, seconds: float) -> None:
    """All stages from masked depth on, of four Kinects around a moving person, one set after the other without rest."""
    rng = np.random.default_rng(11)
    motion = next(prior_motions(1, 2.0, rng))
    sets = list(moving_frames(motion, 4, (SENSORS["kinect2"],), rng))
    sets += sets[::-1]
    pipeline = Pipeline(load_classifier(bench), load_estimator(), PeopleSegmenter({}), "z", load_filter(AUTO))
    for frames in sets[: bench.warm_up]:
        pipeline(frames)
    total, stages = [], []
    start = time.perf_counter()
    while not total or time.perf_counter() - start < seconds:
        frames = dataclasses.replace(sets[len(total) % len(sets)], timestamp_ns=round(len(total) * 1e9 / 30))
        before = time.perf_counter()
        result = pipeline(frames)
        total.append((time.perf_counter() - before) * 1e3)
        stages.append([result.milliseconds[stage] for stage in STAGES])
    rate = len(total) / (time.perf_counter() - start)
    timing = Timing.of(np.array(total))
    note = (
        f"{rate:.1f} sets a second over {seconds:.0f} s ({_stages(stages)}); "
        f"p95 {'met' if timing.p95_ms <= SET_P95_GOAL_MS else 'missed'}, its goal {SET_P95_GOAL_MS:g} ms"
    )
    bench.rows.append(Row("Pipeline, a set of 4 masked Kinects", timing, goal_ms=SET_GOAL_MS, note=note))


def _stages(milliseconds: list[list[float]]) -> str:
    medians = np.median(milliseconds, axis=0)
    return ", ".join(f"{stage} {ms:.1f}" for stage, ms in zip(STAGES, medians, strict=True)) + " ms"


def whole_pipeline(bench: Bench, recording: Path | None) -> None:
    """All stages on the packaged demo recording, or the user's own."""
    path = recording or Path(str(importlib.resources.files("depthmocap") / "demo_recording"))
    if not path.is_dir():
        bench.notes.append("no packaged demo recording: the whole pipeline is not measured")
        return
    source = Recording(path)
    pipeline = Pipeline(
        load_classifier(bench), load_estimator(), PeopleSegmenter.from_recording(source), source.up, load_filter(AUTO)
    )
    sets = min(len(source), bench.warm_up + bench.runs)
    total, reading, stages = [], [], []
    for i in range(sets):
        start = time.perf_counter()
        frames = source[i]
        read = time.perf_counter()
        result = pipeline(frames)
        total.append((time.perf_counter() - read) * 1e3)
        reading.append((read - start) * 1e3)
        stages.append([result.milliseconds[stage] for stage in STAGES])
    first = min(bench.warm_up, sets - 1)
    timing = Timing.of(np.array(total[first:]))
    note = (
        f"{1e3 / timing.median_ms:.1f} frame sets a second of {len(source.rig.names)} views "
        f"({_stages(stages[first:])}); "
        f"reading the files takes {np.median(reading[first:]):.1f} ms more"
    )
    bench.rows.append(Row("Whole pipeline, a frame set", timing, note=note))
