"""A pipeline of real stages around a network and an estimator that cost nothing, and a scene whose depth is noisy."""

from __future__ import annotations

import numpy as np

from depthmocap.classify.classifier import ViewPrediction
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.offline.pipeline import Pipeline
from depthmocap.segment.people_segmenter import PeopleSegmenter


class FakeClassifier:
    """Everything is region 1."""

    def label_views(self, views, masks, up=None):
        return [
            ViewPrediction(mask.astype(np.uint8), mask.astype(np.float32), np.full((18, 4), np.nan)) for mask in masks
        ]


class FakeEstimator:
    """All joints are in the middle of the cloud."""

    def __call__(self, cloud, up="z"):
        if not len(cloud):
            return np.full((18, 3), np.nan), np.zeros(18)
        return np.repeat(cloud.points_world.mean(0)[None].astype(np.float64), 18, 0), np.ones(18)


def fake_pipeline(smoothing=None, people=1):
    segment = PeopleSegmenter({}, mode="none", people=people)
    return Pipeline(FakeClassifier(), FakeEstimator(), segment, "z", smoothing)


class Board:
    """Cameras around a board 2 m before each, that moves away by 1 m/s and back; every picture has its own noise."""

    def __init__(self, count=4, width=32, height=24):
        cameras = []
        for i in range(count):
            azimuth = 2 * np.pi * i / count
            pose = look_at(np.array([3 * np.sin(azimuth), -3 * np.cos(azimuth), 1.0]), np.array([0.0, 0.0, 1.0]))
            cameras.append(DepthCamera(f"cam{i}", width, height, 30.0, 30.0, width / 2, height / 2, pose))
        self.rig = Rig(tuple(cameras))

    def depth(self, camera, time_s):
        own = self.rig[camera]
        rng = np.random.default_rng(round(time_s * 1e6))
        depth = 2000 + 1000 * abs(time_s % 2 - 1) + rng.integers(-2, 3, (own.height, own.width))
        return depth.round().astype(np.uint16)
