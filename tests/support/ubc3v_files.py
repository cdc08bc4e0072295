"""Small UBC3V sections for the tests."""

import numpy as np

from depthmocap.datasets.ubc3v import (
    UNLABELLED,
    kinect2_camera,
)
from depthmocap.datasets.ubc3v_write import SectionWriter
from depthmocap.frames import View
from depthmocap.geometry.transforms import look_at

HALF_STEP_M = 750 / 255 / 2 * 1.03 / 100 + 1e-6
SHAPE = (424, 512)
EYES = [(2.0, -2.5, 1.5), (-2.2, -1.0, 0.3), (0.5, 3.0, 2.6)]


def make_views(rng, eyes=EYES, labels=True):
    views = []
    for k, eye in enumerate(eyes, 1):
        mask = np.zeros(SHAPE, bool)
        mask[150:250, 200:260] = True
        depth = np.where(mask, rng.uniform(1.0, 5.0, SHAPE), 0).astype(np.float32)
        regions = np.where(mask, rng.integers(1, 44, SHAPE), 0).astype(np.uint8)
        regions[150, 200:210] = UNLABELLED
        camera = kinect2_camera(f"Cam{k}", look_at(np.array(eye), np.array([0.1, 0.2, 1.0])))
        views.append(View(camera, depth, mask, regions if labels else None))
    return views


def write_section(root, count=3, labels=True, section=1, split="train", seed=0):
    rng = np.random.default_rng(seed)
    samples = [(make_views(rng, labels=labels), rng.uniform(-1, 2, (18, 3))) for _ in range(count)]
    with SectionWriter(root, "easy-pose", split, section) as writer:
        for views, joints in samples:
            writer.write(views, joints)
    return writer.path, samples
