"""Estimates of moving people, stored on disk: the input of the evaluation of temporal filters."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.classify.classifier import Classifier
from depthmocap.core.output import atomic_write, write_file
from depthmocap.core.reading.array_files import ArrayType, error_reason, read_npz
from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, Pose
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import JointEstimator, estimate_pose
from depthmocap.pose.labelled_view import label_people

_SETTINGS = "estimates.json"
_ARRAYS = {
    "timestamps_ns": ArrayType("t", "i"), "truth": ArrayType("t 18 3", "f"), "joints": ArrayType("v t 18 3", "f"),
    "confidence": ArrayType("v t 18", "f"),
}  # fmt: skip
_POINT_ARRAYS = {"points": ArrayType("v t 18 3", "f"), "points_confidence": ArrayType("v t 18", "f")}


@dataclasses.dataclass(frozen=True, eq=False)
class SequenceEstimates:
    """One sequence: true joints, and joints estimated from 1 … v of its cameras (NaN and confidence 0 without one);
    points of the skin where the estimator tells these."""

    name: str
    timestamps_ns: Int[ndarray, "t"]
    truth: Float[ndarray, "t 18 3"]
    joints: Float[ndarray, "v t 18 3"]
    confidence: Float[ndarray, "v t 18"]
    points: Float[ndarray, "v t 18 3"] | None = None
    points_confidence: Float[ndarray, "v t 18"] | None = None

    def poses(self, views: int) -> list[Pose]:
        """The estimates from the first so many cameras."""
        joints, confidence = self.joints[views - 1], self.confidence[views - 1]
        poses = [Pose(*row) for row in zip(self.timestamps_ns.tolist(), joints, confidence, strict=True)]
        if self.points is None or self.points_confidence is None:
            return poses
        rows = zip(self.points[views - 1], self.points_confidence[views - 1], strict=True)
        return [
            dataclasses.replace(pose, points=points, points_confidence=sure)
            for pose, (points, sure) in zip(poses, rows, strict=True)
        ]


def estimate_sequence(
    name: str, frames: Iterable[FrameSet], classifier: Classifier, estimator: JointEstimator
) -> SequenceEstimates:
    """Joints of frames with true masks and joints, frame by frame, nothing smoothed."""
    stamps, truths, estimates = [], [], []
    for frame in frames:
        parts = label_people(frame.views, classifier, "z")
        clouds = [merge_views(parts[:count]) for count in range(1, len(parts) + 1)]
        stamps.append(frame.timestamp_ns)
        truths.append(frame.true_joints)
        estimates.append([estimate_pose(estimator, cloud, "z", frame.timestamp_ns) for cloud in clouds])
    names = ("joints", "confidence")
    if estimates and estimates[0][0].points is not None:
        names += ("points", "points_confidence")
    arrays = {
        key: np.stack([np.stack([getattr(pose, key) for pose in poses]) for poses in estimates], 1) for key in names
    }
    return SequenceEstimates(name, np.array(stamps), np.stack(truths), **arrays)


class EstimateStore:
    """Estimates in a folder, with the settings that made them; an interrupted run continues."""

    def __init__(self, folder: Path, settings: dict[str, object]) -> None:
        """Open or begin a folder.

        Raises:
            InputError: when it holds estimates made with other settings.
        """
        self._folder = folder
        path, text = folder / _SETTINGS, json.dumps(settings, indent=1, default=str, sort_keys=True) + "\n"
        if path.exists() and _sorted(read_text(path)) != text:
            raise InputError(f"{path} is of other settings: choose another --out, or delete that folder")
        write_file(path, text)

    def load(self, index: int) -> SequenceEstimates | None:
        """The estimates of a sequence; None where the file does not exist.

        Raises:
            InputError: when its file cannot be read.
        """
        path = self._path(index)
        if not path.exists():
            return None
        try:
            data = read_npz(path, {"name": ArrayType("", "U"), **_ARRAYS}, optional=_POINT_ARRAYS)
        except InputError as error:
            raise InputError(f"{path} is not a file of estimates ({error_reason(error, path)}): delete it") from None
        return SequenceEstimates(str(data.pop("name")), **data)

    def save(self, index: int, sequence: SequenceEstimates) -> None:
        """Write the estimates of a sequence; the file is complete or not there at all."""
        with atomic_write(self._path(index)) as unfinished:
            arrays = {key: getattr(sequence, key) for key in (*_ARRAYS, *_POINT_ARRAYS)}
            np.savez(
                unfinished, name=sequence.name, **{key: array for key, array in arrays.items() if array is not None}
            )

    def _path(self, index: int) -> Path:
        return self._folder / f"{index:04d}.npz"


def _sorted(text: str) -> str:
    """A file of settings with its keys in order, as they are written now; itself where it is none."""
    try:
        return json.dumps(json.loads(text), indent=1, sort_keys=True) + "\n"
    except ValueError:
        return text
