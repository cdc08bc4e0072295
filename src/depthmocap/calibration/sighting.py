"""What every camera sees of the person, in pictures that are wrong in known ways too, and what is wrong with them."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.progress import Progress

from depthmocap.calibration.first_look import FirstLook, look_first
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.observations import Observation, observe, subsample_timestamps
from depthmocap.calibration.picture_faults import STATURES_M, PictureFault, find_picture_faults, scaled
from depthmocap.calibration.turned_pictures import find_turned_pictures
from depthmocap.classify.classifier import Classifier
from depthmocap.errors import InputError
from depthmocap.geometry import Rig
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording
from depthmocap.segment.person_by_network import PersonByNetwork
from depthmocap.text import joined

#: Somebody smaller than this (metres) may be an adult in half of the depth unit.
SMALL_M = 1.02
_TURNS = {1: "on its side (turned by 90° clockwise)", 2: "upside down", 3: "on its side (turned by 90° anticlockwise)"}


@dataclasses.dataclass(frozen=True, eq=False)
class Sighting:
    """What the cameras of a recording see of one person.

    Attributes:
        recording: in the depth units in which people are found.
        observations: of every camera, in that unit.
        tracks: the same joints in the units that the recording tells.
        looks: the first look at each camera.
        faults: wrong units, and pictures that are mirrored or turned.
        problems: what makes good masks unlikely.
    """

    recording: Recording
    observations: list[Observation]
    tracks: list[JointTrack]
    looks: dict[str, FirstLook]
    faults: list[PictureFault]
    problems: list[str]

    @property
    def notes(self) -> list[str]:
        """A line on each camera whose picture shows people on their side or upside down, and on a small person."""
        return [*self._turned, *self.small]

    @property
    def _turned(self) -> list[str]:
        return [
            f"the picture of camera {name!r} is {_TURNS[look.quarters]}, and is turned upright for the networks"
            for name, look in self.looks.items()
            if look.quarters
        ]

    @property
    def small(self) -> list[str]:
        """A line if the person is so small that they may be a child, or the depth unit of all cameras wrong by half."""
        statures = [look.stature_m / look.factor for look in self.looks.values() if look.stature_m > 0]
        stature_m = float(np.median(statures)) if statures else np.inf
        if not STATURES_M[0] < stature_m < SMALL_M or any(fault.kind == "unit" for fault in self.faults):
            return []
        return [
            f"the person is {stature_m:.2f} m tall: a small child, or depth is about half of what it should be in all "
            "cameras, which cannot be told"
        ]


def see_person(
    recording: Recording,
    segment: Literal["auto", "none"],
    weights: Path | None,
    rate_hz: float,
    rng: np.random.Generator,
    console: Console,
) -> Sighting:
    """Look at every camera of a recording.

    Raises:
        InputError: when the recording or the weights cannot be read, or the network tells no joints.
    """
    with console.status("reading the background and the weights"):
        classifier = Classifier(weights)
        segmenter = PersonByNetwork.from_recording(recording, segment)
        if not classifier.predicts_joints:
            raise InputError(f"{classifier.path} is a network that tells no joints, which a calibration is made of")
        looks = look_first(recording, segmenter, classifier)
        if any(look.factor != 1 for look in looks.values()):
            factors = {name: look.factor for name, look in looks.items()}
            recording = open_recording(recording.path, _with_factors(recording.rig, factors))
            segmenter = PersonByNetwork.from_recording(recording, segment)
    names = recording.rig.names
    total = sum(len(subsample_timestamps(recording.stamps(name), rate_hz)) for name in names)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("looking", total=total)
        observations = observe(recording, classifier, segmenter, rate_hz, lambda: progress.advance(task), looks)
    tracks = [
        scaled(observation.track, 1 / looks[name].factor) for name, observation in zip(names, observations, strict=True)
    ]
    stated = [
        dataclasses.replace(camera, depth_factor=camera.depth_factor / looks[camera.name].factor)
        for camera in recording.rig.cameras
    ]
    with console.status("comparing the cameras"):
        faults = find_picture_faults(stated, tracks, rng)
        faults += find_turned_pictures(stated, tracks, faults, rng)
    told_of = {name for fault in faults if fault.kind == "unit" for name in fault.cameras}
    faults += [
        PictureFault(
            "unit", (name,),
            f"people are found in the pictures of camera {name!r} only if its depth is multiplied by {look.factor:g} "
            "(depth_factor in rig.json)",
            look.factor,
        )
        for name, look in looks.items()
        if look.factor != 1 and name not in told_of
    ]  # fmt: skip
    return Sighting(recording, observations, tracks, looks, faults, segmenter.problems)


def cameras_left_out(what: str, sighting: Sighting) -> dict[str, str]:
    """Why cameras whose pictures are wrong are not placed, by name.

    Args:
        what: where it was seen, for the message.

    Raises:
        InputError: when fewer than two cameras are left.
    """
    lines = _fault_lines(sighting.faults)
    wrong = dict.fromkeys(name for fault in sighting.faults for name in fault.cameras)
    if lines and len(sighting.observations) - len(wrong) < 2:
        raise InputError(f"{what}: {joined(lines)}")
    return {
        name: joined(line for line, fault in zip(lines, sighting.faults, strict=True) if name in fault.cameras)
        for name in wrong
    }


def _fault_lines(faults: Sequence[PictureFault]) -> list[str]:
    """The faults in words, with what ``--mend`` would do."""
    ways = {True: "; --mend does so", False: "; which, --mend cannot know"}
    return [f"{fault.text}{ways[fault.certain]}" for fault in faults]


def without(cameras: Collection[str], names: Sequence[str], tracks: Sequence[JointTrack]) -> list[JointTrack]:
    """The tracks, empty for these cameras."""
    nothing = JointTrack(np.empty(0), np.empty((0, 18, 3)), np.empty((0, 18)))
    return [nothing if name in cameras else track for name, track in zip(names, tracks, strict=True)]


def _with_factors(rig: Rig, factors: dict[str, float]) -> Rig:
    cameras = (
        dataclasses.replace(camera, depth_factor=camera.depth_factor * factors[camera.name]) for camera in rig.cameras
    )
    return dataclasses.replace(rig, cameras=tuple(cameras))
