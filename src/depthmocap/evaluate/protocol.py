"""The protocols of the field on sets of real people: on which frames the fit is made, and what is measured.

As in the paper only the pose stage is fitted to a set's joints (see ``refit``), never the network.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from depthmocap.classify.classifier import Classifier
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.errors import InputError
from depthmocap.evaluate.estimated_frames import EstimatedFrames
from depthmocap.evaluate.evaluation_report import Outputs
from depthmocap.evaluate.refit import fit_joints
from depthmocap.pose.estimators import JointEstimator, load_estimator
from depthmocap.report.metrics import joint_errors_cm, joint_metrics, joint_numbers, reliability

#: "ridge" fits the set's joints; "none" takes ours where they correspond.
Refit = Literal["ridge", "none"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class RealSetEvaluation(NetworkSettings, Outputs):
    """What the protocols on sets of real people have in common.

    Attributes:
        every: read every so-many-th frame only.
        weights: a classifier.onnx of your own.
        estimator: of our joints: votes, ridge (the paper's), or a file that ``train pose`` wrote.
    """

    every: int = 1
    weights: Path | None = None
    estimator: str = "votes"

    def load(self) -> tuple[JointEstimator, Classifier]:
        """The estimator and the network.

        Raises:
            InputError: when a file is missing or not such a model.
        """
        with networks_on(self.device):
            classifier = Classifier(self.weights)
            return load_estimator(self.estimator), classifier


def comparable(observed: EstimatedFrames, refit: Refit) -> EstimatedFrames:
    """The joints that can be estimated: without a fit only those that correspond to one of ours.

    Raises:
        InputError: when there is none.
    """
    joints = tuple(joint for joint in observed.joints if refit != "none" or joint in observed.correspondence)
    if not joints:
        raise InputError(f"{observed.name}: none of its joints is known to be one of ours; pass --refit ridge")
    return observed.only(joints)


def leave_one_out(
    observed: EstimatedFrames, groups: Shaped[ndarray, "n"], refit: Refit = "ridge"
) -> Float[ndarray, "n j 3"]:
    """Estimates of every frame by a fit to the frames of all other groups (people, or actions).

    Raises:
        InputError: when there is only one group, or too little to fit to.
    """
    if refit == "none":
        return observed.mapped()
    names = np.unique(groups)
    if len(names) < 2:
        raise InputError(
            f"{observed.name}: only '{names[0]}' is there, so nothing is left to fit to; pass --refit none"
        )
    estimates = np.full(observed.truths.shape, np.nan)
    for name in names:
        out = groups == name
        estimates[out] = fit_joints(observed.rows(~out))(observed.rows(out))
    return estimates


def measure_estimates(
    observed: EstimatedFrames,
    estimates: Float[ndarray, "n j 3"],
    parts: Mapping[str, tuple[str, ...]] | None = None,
) -> dict[str, Any]:
    """All numbers of a set: over everything, by joint, person and action, and how far its confidence can be trusted.

    Args:
        parts: groups of joints, whose mean average precision at 10 cm is added.
    """
    metrics = joint_metrics(estimates, observed.truths, observed.joints)
    errors_cm = joint_errors_cm(estimates, observed.truths)
    numbers = {
        "frames": len(observed),
        "frames_left_out": observed.left_out,
        "frames_without_person": int((~observed.detected).sum()),
        "joints": list(observed.joints),
        **joint_numbers(metrics, reliability(observed.joint_confidence(), errors_cm)),
        "by_subject": _by_group(observed, estimates, observed.subjects),
        "by_action": _by_group(observed, estimates, observed.actions),
        "ms_per_frame": float(np.median(observed.milliseconds)),
        "problems": list(observed.problems),
    }
    if parts:
        numbers["ap_10cm_by_part"] = {
            part: float(np.mean([metrics.per_joint_within_10cm[joint] for joint in joints]))
            for part, joints in parts.items()
        }
    return numbers


def _by_group(
    observed: EstimatedFrames, estimates: Float[ndarray, "n j 3"], groups: Shaped[ndarray, "n"]
) -> dict[str, dict[str, Any]]:
    """The main numbers of each group; empty where there is only one group."""
    names = np.unique(groups)
    numbers = {}
    for name in names if len(names) > 1 else ():
        rows = groups == name
        metrics = joint_metrics(estimates[rows], observed.truths[rows], observed.joints)
        numbers[str(name)] = {
            "frames": metrics.frames,
            "mean_joint_error_cm": metrics.mean_joint_error_cm,
            "deviation_cm": metrics.deviation_cm,
            "within_10cm": metrics.within_10cm,
        }
    return numbers
