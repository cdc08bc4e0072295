"""Joints by a rule of your own: each where the points of the body regions around it are, in the median.

python examples/09_own_estimator.py RECORDING
"""

import sys

import numpy as np
from numpy import ndarray

import depthmocap
from depthmocap.body.regions import REGION
from depthmocap.classify.classifier import Classifier
from depthmocap.pose.cloud import MIN_CLOUD_POINTS
from depthmocap.pose.estimators import JOINT_REGIONS, load_estimator
from depthmocap.segment.people_segmenter import PeopleSegmenter


class Middles:
    """A `JointEstimator`: a labelled cloud in, joints (metres, in the world) and their confidence out."""

    def __call__(self, cloud: depthmocap.LabelledCloud, up: str = "z") -> tuple[ndarray, ndarray]:
        joints, confidence = np.full((len(depthmocap.JOINTS), 3), np.nan), np.zeros(len(depthmocap.JOINTS))
        if len(cloud) < MIN_CLOUD_POINTS:
            return joints, confidence  # nobody is there
        for i, name in enumerate(depthmocap.JOINTS):
            near = np.isin(cloud.labels, [REGION[region] for region in JOINT_REGIONS[name]])
            if near.any():
                joints[i], confidence[i] = np.median(cloud.points_world[near], axis=0), 0.5
        return joints, confidence


def main(recording: str) -> None:
    """Print how far joints of this rule, and of the packaged estimator, are from the true ones."""
    source = depthmocap.open_source(recording)
    assert isinstance(source, depthmocap.Recording)
    for name, estimator in (("middles", Middles()), ("votes", load_estimator("votes"))):
        pipeline = depthmocap.Pipeline(Classifier(), estimator, PeopleSegmenter.from_recording(source), source.up)
        errors = [
            np.linalg.norm(pipeline(frames).pose.joints - frames.true_joints, axis=1)
            for frames in source
            if frames.true_joints is not None
        ]
        print(f"{name}: joints are off by {100 * np.nanmean(errors):.1f} cm")


if __name__ == "__main__":
    main(sys.argv[1])
