"""Everybody of a take as moving, skinned skeletons in the same evenly spaced frames, for files of whole scenes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.exporting.body_motion import BodyMotion, solve_body
from depthmocap.exporting.body_surface import BodySurface, fitted_surface
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.summary import FrameRanges, frame_ranges
from depthmocap.exporting.target_skeleton import PosedSkeleton, retarget
from depthmocap.exporting.timeline import FrameTimes, evenly_spaced, frame_times

#: Colours of people, in turn (linear red, green, blue).
COLOURS = ((0.55, 0.62, 0.68), (0.68, 0.48, 0.30), (0.36, 0.58, 0.40), (0.55, 0.42, 0.66), (0.66, 0.60, 0.32))


@dataclasses.dataclass(frozen=True, eq=False)
class AnimatedPerson:
    """One person.

    Attributes:
        name: letters, digits, "_" and "-".
        surface: at rest, around the hips.
        present: frames from the first to the last in which the person was seen.
        colour: linear red, green, blue.
    """

    name: str
    skeleton: PosedSkeleton
    motion: BodyMotion
    surface: BodySurface
    present: Bool[ndarray, " n"]
    colour: tuple[float, float, float]

    @property
    def vertices_at_rest(self) -> Float[ndarray, "v 3"]:
        """The surface around the skeleton at rest, which stands on the floor."""
        return self.surface.vertices + self.skeleton.rest_positions[self.skeleton.hips]

    def notes(self) -> dict[str, dict[str, FrameRanges]]:
        """Stretches of frames in which joints were held or filled, by joint."""

        def ranges(mask: Bool[ndarray, "n 18"]) -> dict[str, FrameRanges]:
            by_joint = {joint: frame_ranges(mask[:, i]) for i, joint in enumerate(JOINTS)}
            return {joint: stretches for joint, stretches in by_joint.items() if stretches}

        return {"held": ranges(self.motion.held), "filled": ranges(self.motion.filled)}


def animated_people(take: ExportedTake, settings: FileSettings) -> tuple[list[AnimatedPerson], FrameTimes]:
    """Everybody, and the frames that they share.

    Raises:
        InputError: when no joint of somebody remains, or the take pauses for very long.
    """
    lines = [take.rows(person, settings.least_confidence) for person in take.people]
    frames = frame_times(lines)
    people = []
    for number, (person, line) in enumerate(zip(take.people, lines, strict=True)):
        motion = solve_body(evenly_spaced(line, frames), settings.fill_s)
        seen = np.flatnonzero(~np.isnan(motion.joints).all((1, 2)))
        index = np.arange(frames.count)
        people.append(
            AnimatedPerson(
                take.name(person) or "person",
                retarget(motion, settings.skeleton, settings.rest),
                motion,
                fitted_surface(motion.offsets, settings.rest),
                np.asarray((index >= seen[0]) & (index <= seen[-1])),
                COLOURS[number % len(COLOURS)],
            )
        )
    return people, frames


def take_notes(take: ExportedTake, frames: FrameTimes) -> dict[str, Any]:
    """What a file's format may have no place for: when it starts, and the markers, in seconds of the file."""
    return {
        "start_s": frames.start_s,
        "first_timestamp_ns": str(take.origin_ns),
        "frames_per_second": 1 / frames.frame_s,
        "markers": [{"time_s": time_s - frames.start_s, "text": text} for time_s, text in take.markers],
    }
