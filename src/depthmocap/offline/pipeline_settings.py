"""What all that makes poses has in common: one set of options, and the pipeline that follows from it."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

from depthmocap.classify.classifier import Classifier
from depthmocap.core.network_devices import Device, networks_on
from depthmocap.errors import InputError
from depthmocap.frames import FrameSource
from depthmocap.geometry import check_extrinsics, load_rig
from depthmocap.geometry.floor_area import FloorArea
from depthmocap.offline.pipeline import Pipeline
from depthmocap.pose.estimators import load_estimator
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording
from depthmocap.segment.choice import Choice, Subject
from depthmocap.segment.load_segmenter import Segmentation, load_segmenter
from depthmocap.smooth.filters import AUTO, Bones, Smoothing, load_filter

#: What is told where the rig says in which area people are followed.
RIG_AREA = "people are followed in the rig's area only (area_m in rig.json)"


@dataclasses.dataclass(frozen=True, kw_only=True)
class PipelineSettings:
    """How people are found and their poses estimated and smoothed.

    Attributes:
        segment: "auto" finds people by their shape, in any posture, and learns the empty scene, which sharpens the
            masks; "network" by their shape alone, also with a camera that moves; "background" by what differs from the
            empty scene, stands up and moves; "none" takes every valid pixel for one person.
        people: follow up to so many.
        subject: whom to follow first: who shows most surface, who is nearest to the middle, who came first, or a
            person's number.
        area: follow people in an area of the floor only: x and y (x and z where y is up) of its corners, in metres; by
            default in the rig's area_m, if it has one.
        smooth: a filter over time. "average" is the paper's weighted average of the last frames, "fixed-lag" waits for
            later ones; "auto" is "kalman" for recordings and cameras, and "none" for sets of pictures that do not
            follow each other, such as UBC3V's sections.
        lag_frames: that "fixed-lag" waits for.
        bridge_s: how long "kalman" and "fixed-lag" go on with a joint that is missing (s); 0 leaves gaps.
        bones: "steady" gives bones constant lengths, learnt on the run; "free" leaves them as estimated, as does
            "none" for --smooth.
        weights: a classifier.onnx of your own.
        estimator: of the joints: votes, ridge (the paper's), or a file that ``train pose`` wrote.
        device: that runs the networks: auto takes an accelerator whose ONNX Runtime is installed where it is faster
            than the CPU.
    """

    segment: Segmentation = "auto"
    people: int = 1
    subject: Subject = "largest"
    area: tuple[float, ...] = ()
    smooth: Smoothing = "auto"
    lag_frames: int = 4
    bridge_s: float = 0.0
    bones: Bones = "steady"
    weights: Path | None = None
    estimator: str = "votes"
    device: Device = "auto"

    def choice_in(self, area_m: FloorArea) -> Choice:
        """Who is followed: in the area of these settings, else in that of the rig.

        Raises:
            InputError: for an area that is none.
        """
        return Choice(self.subject, self.area or tuple(itertools.chain.from_iterable(area_m)))


def open_source(path: Path | str, rig: Path | None = None) -> FrameSource:
    """A recording folder, an MCAP file or a UBC3V section, told apart by what they hold and by the name. ``rig`` is a
    rig.json that tells where the cameras of a recording stand, instead of what it says.

    Raises:
        InputError: when the path is neither, or the rig is not one of its cameras.
    """
    path = Path(path)
    if (path / "images" / "depthRender").is_dir() or (path / "groundtruth.mat").is_file():
        from depthmocap.datasets.ubc3v import Section

        if rig is not None:
            raise InputError("--rig is for recordings: a section of UBC3V tells its cameras' places frame by frame")
        return Section(path)
    return open_recording(path, None if rig is None else load_rig(rig))


def load_pipeline(
    source: FrameSource | Path | str, settings: PipelineSettings | None = None, **changes: Any
) -> Pipeline:
    """The pipeline for a source, its background learnt.

    Args:
        settings: by default the usual ones, with the packaged weights; settings of a command that has them will do.
        changes: single settings that differ, as in ``load_pipeline("recording", people=2)``.

    Raises:
        InputError: when the recording or the weights cannot be read, settings do not fit each other, or the device is
            not there.
    """
    settings = settings or PipelineSettings()
    if unknown := changes.keys() - {field.name for field in dataclasses.fields(PipelineSettings)}:
        raise InputError(f"the pipeline has no setting {min(unknown)!r}")
    settings = dataclasses.replace(settings, **changes)
    source = open_source(source) if isinstance(source, Path | str) else source
    if isinstance(source, Recording):
        check_extrinsics(source.rig.cameras)
    smooth = settings.smooth
    if smooth == "auto":
        smooth = AUTO if source.continuous else "none"
    if smooth == "none" and settings.bridge_s:
        raise InputError("gaps are bridged by the filters kalman and fixed-lag, not without one")
    smoothing = None
    if smooth != "none":
        smoothing = load_filter(smooth, settings.lag_frames, settings.bridge_s, settings.bones)
    with networks_on(settings.device) as devices:
        pipeline = Pipeline(
            Classifier(settings.weights),
            load_estimator(settings.estimator),
            load_segmenter(source, settings.segment, settings.people, settings.choice_in(source.area_m)),
            source.up,
            smoothing,
        )
    pipeline.devices = devices
    return pipeline
