"""From a labelled cloud to joints in the world, with a confidence for each, by any of several estimators."""

from __future__ import annotations

import importlib.resources
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray

from depthmocap.body.regions import REGION, REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.pose.cloud import MIN_CLOUD_POINTS, LabelledCloud
from depthmocap.pose.features import Features, cloud_features
from depthmocap.pose.labelled_view import Labels
from depthmocap.pose.ridge import RidgeBank
from depthmocap.pose.votes import VotesEstimator

#: Number of points around a joint from which more points add no confidence: a half visible hand in a Kinect 2 at 3 m.
FULL_POINTS = 100
#: Confidence of a joint without observed points around it: its position follows from the rest of the body.
UNOBSERVED_CONFIDENCE = 0.1

#: The regions around each joint.
JOINT_REGIONS: dict[str, tuple[str, ...]] = {
    "Head": ("forehead", "hair R", "hair L", "face R", "face L"),
    "Neck": ("neck front", "nape", "neck back R", "neck back L"),
    "Spine2": ("chest R", "chest L", "upper back R", "upper back L"),
    "Spine1": ("chest R", "chest L", "upper back R", "upper back L",
               "belly R", "belly L", "lower back R", "lower back L"),
    "Spine": ("belly R", "belly L", "lower back R", "lower back L"),
    "Hip": ("belly R", "belly L", "lower back R", "lower back L", "thigh R", "thigh L"),
    "RHip": ("belly R", "lower back R", "thigh R"),
    "RKnee": ("thigh R", "knee R", "shin R"),
    "RFoot": ("shin R", "ankle R", "forefoot R"),
    "LHip": ("belly L", "lower back L", "thigh L"),
    "LKnee": ("thigh L", "knee L", "shin L"),
    "LFoot": ("shin L", "ankle L", "forefoot L"),
    "RShoulder": ("collar R", "shoulder front R", "shoulder back R", "upper arm R"),
    "RElbow": ("upper arm R", "elbow R", "forearm R"),
    "RHand": ("forearm R", "wrist R", "hand R"),
    "LShoulder": ("collar L", "shoulder front L", "shoulder back L", "upper arm L"),
    "LElbow": ("upper arm L", "elbow L", "forearm L"),
    "LHand": ("forearm L", "wrist L", "hand L"),
}  # fmt: skip


def _joint_regions() -> Bool[ndarray, "18 43"]:
    mask = np.zeros((len(JOINTS), REGION_COUNT), bool)
    for row, joint in zip(mask, JOINTS, strict=True):
        row[[REGION[name] - 1 for name in JOINT_REGIONS[joint]]] = True
    return mask


_JOINT_REGIONS = _joint_regions()


def joint_confidence(features: Features) -> Float64[ndarray, "18"]:
    """Confidence 0.1–1 of each joint: a simple measure of the points around it, not a calibrated probability.

    It is the mean label probability of the points in the joint's regions (``JOINT_REGIONS``), times their share of
    ``FULL_POINTS`` when they are fewer, and at least ``UNOBSERVED_CONFIDENCE``.
    """
    points = _JOINT_REGIONS @ features.counts.astype(np.float64)
    probability = _JOINT_REGIONS @ (features.counts * features.mean_weights) / np.maximum(points, 1)
    return np.clip(probability * np.minimum(points / FULL_POINTS, 1), UNOBSERVED_CONFIDENCE, 1)


@runtime_checkable
class JointEstimator(Protocol):
    """Joints in the world (metres) and their confidence 0–1, from a cloud of any number of cameras.

    A cloud of fewer than ``MIN_CLOUD_POINTS`` points gives NaN joints with confidence 0.
    """

    def __call__(
        self, cloud: LabelledCloud, up: str = "z"
    ) -> tuple[Float64[ndarray, "18 3"], Float64[ndarray, "18"]]: ...


def estimate_pose(estimator: JointEstimator, cloud: LabelledCloud, up: str, timestamp_ns: int) -> Pose:
    """The pose of a cloud; with points of the skin where the estimator tells them.

    Raises:
        InputError: as the estimator.
    """
    if isinstance(estimator, VotesEstimator) and estimator.has_points:
        return Pose(timestamp_ns, *estimator.with_points(cloud, up))
    return Pose(timestamp_ns, *estimator(cloud, up))


class RidgeEstimator:
    """The paper's estimator: ridge regression (``ridge``) from statistics of the regions (``features``)."""

    def __init__(self, bank: RidgeBank) -> None:
        self.bank = bank

    def __call__(self, cloud: LabelledCloud, up: str = "z") -> tuple[Float64[ndarray, "18 3"], Float64[ndarray, "18"]]:
        """Joints in the world (metres) and their confidence, by the model for the number of cameras with points.

        Raises:
            InputError: as ``cloud_features``.
        """
        if len(cloud) < MIN_CLOUD_POINTS:
            return np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS))
        features = cloud_features(cloud, up, self.bank.frame)
        views = sum(size > 0 for size in cloud.view_sizes) or 1
        joints = self.bank.predict(features.values[None], views)
        return features.to_world(joints[0].astype(np.float64)), joint_confidence(features)


def load_estimator(source: str | Path = "votes", labels: Labels = "network") -> JointEstimator:
    """Load an estimator.

    Args:
        source: a packaged one, "votes" or "ridge" (the paper's), or a file that ``depthmocap train pose`` wrote
            (votes.onnx or ridge .npz).
        labels: the labels that the packaged ridge was fitted on.

    Raises:
        InputError: for another name, or a file that cannot be read.
    """
    if source == "votes" or Path(source).suffix == ".onnx":
        return VotesEstimator(None if source == "votes" else Path(source))
    if source == "ridge":
        weights = importlib.resources.files("depthmocap.pose") / "weights"
        return RidgeEstimator(RidgeBank.load(Path(str(weights / f"ridge_{labels}.npz"))))
    if Path(source).suffix == ".npz":
        return RidgeEstimator(RidgeBank.load(Path(source)))
    raise InputError(f"--estimator takes votes, ridge, or a file (.onnx, .npz), not {str(source)!r}")
