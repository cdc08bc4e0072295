"""Estimates of moving people, made once and kept: what the filters over time are measured on."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.classify.classifier import Classifier
from depthmocap.core.output import replacing, write_file
from depthmocap.core.reading.array_files import ArrayType, read_npz, why
from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, Pose
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import JointEstimator
from depthmocap.pose.labelled_view import label_people

_SETTINGS = "estimates.json"
_ARRAYS = {
    "timestamps_ns": ArrayType("t", "i"), "truth": ArrayType("t 18 3", "f"), "joints": ArrayType("v t 18 3", "f"),
    "confidence": ArrayType("v t 18", "f"),
}  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class Track:
    """One sequence: true joints, and those estimated from 1 … v of its cameras (NaN and confidence 0 where none)."""

    name: str
    timestamps_ns: Int[ndarray, "t"]
    truth: Float[ndarray, "t 18 3"]
    joints: Float[ndarray, "v t 18 3"]
    confidence: Float[ndarray, "v t 18"]

    def poses(self, views: int) -> list[Pose]:
        """The estimates from the first so many cameras."""
        joints, confidence = self.joints[views - 1], self.confidence[views - 1]
        return [Pose(*each) for each in zip(self.timestamps_ns.tolist(), joints, confidence, strict=True)]


def estimate_track(name: str, frames: Iterable[FrameSet], classifier: Classifier, estimator: JointEstimator) -> Track:
    """Joints of frames with true masks and joints, frame by frame, nothing smoothed."""
    stamps, truths, joints, confidences = [], [], [], []
    for frame in frames:
        parts = label_people(frame.views, classifier, "z")
        found = [estimator(merge_views(parts[:count]), "z") for count in range(1, len(parts) + 1)]
        stamps.append(frame.timestamp_ns)
        truths.append(frame.true_joints)
        joints.append(np.stack([each for each, _ in found]))
        confidences.append(np.stack([each for _, each in found]))
    return Track(name, np.array(stamps), np.stack(truths), np.stack(joints, 1), np.stack(confidences, 1))


class TrackStore:
    """Tracks in a folder, with the settings that made them; a run that was cut short goes on."""

    def __init__(self, folder: Path, settings: dict[str, object]) -> None:
        """Open or begin a folder.

        Raises:
            InputError: when it holds estimates made with other settings.
        """
        self._folder = folder
        path, text = folder / _SETTINGS, json.dumps(settings, indent=1, default=str) + "\n"
        if path.exists() and read_text(path) != text:
            raise InputError(f"{path} is of other settings: choose another --out, or delete that folder")
        write_file(path, text)

    def load(self, index: int) -> Track | None:
        """The track of a sequence, if it is there.

        Raises:
            InputError: when its file cannot be read.
        """
        path = self._path(index)
        if not path.exists():
            return None
        try:
            data = read_npz(path, {"name": ArrayType("", "U"), **_ARRAYS})
        except InputError as error:
            raise InputError(f"{path} is not a file of estimates ({why(error, path)}): delete it") from None
        return Track(str(data["name"]), *(data[key] for key in _ARRAYS))

    def save(self, index: int, track: Track) -> None:
        """Keep a track; a file is there whole or not at all."""
        with replacing(self._path(index)) as unfinished:
            np.savez(unfinished, name=track.name, **{key: getattr(track, key) for key in _ARRAYS})

    def _path(self, index: int) -> Path:
        return self._folder / f"{index:04d}.npz"
