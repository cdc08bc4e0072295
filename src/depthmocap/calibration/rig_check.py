"""``depthmocap calibrate --check``: how far the cameras of a rig are from where a recording says they stand."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.table import Table

from depthmocap.calibration.pose_faults import moved
from depthmocap.calibration.verdict import PairVerdict
from depthmocap.geometry import Rig, largest_group, rigid_inverse, transform_points
from depthmocap.text import camera_list

State = Literal["good", "bumped", "unknown"]
#: A camera that is further from where it stood than this, where the person is, was bumped (cm).
BUMPED_CM = 3.0
#: So was one that is turned by more than this (degrees).
BUMPED_DEG = 2.0


@dataclasses.dataclass(frozen=True)
class PairCheck:
    """How far a rig's pair of cameras is from what the recording says: where the person is, and in rotation; each with
    its uncertainty (three standard deviations)."""

    cameras: tuple[str, str]
    cm: float
    degrees: float
    uncertainty_cm: float
    uncertainty_deg: float
    time_told: bool = True

    @property
    def state(self) -> State:
        """Bumped if beyond the limits and beyond what is uncertain; good if certainly within them."""
        if not self.time_told:
            return "unknown"
        if self.cm > max(BUMPED_CM, self.uncertainty_cm) or self.degrees > max(BUMPED_DEG, self.uncertainty_deg):
            return "bumped"
        return "good" if self.uncertainty_cm < BUMPED_CM and self.uncertainty_deg < BUMPED_DEG else "unknown"


@dataclasses.dataclass(frozen=True)
class CameraCheck:
    """How far a camera is from where the rig says, against those that are right; NaN where it is not known.

    Attributes:
        reason: why it is not known, or who else may be wrong instead.
    """

    name: str
    state: State
    cm: float = float("nan")
    degrees: float = float("nan")
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class RigCheck:
    """A verdict on a rig.

    Attributes:
        warnings: what makes it worse than it could be, and what is wrong with pictures, one line each.
    """

    cameras: list[CameraCheck]
    pairs: list[PairCheck]
    warnings: list[str]


def check_rig(
    rig: Rig,
    found: Rig,
    quality: Sequence[PairVerdict],
    trajectory: Float[ndarray, "n 3"],
    unplaced: Mapping[str, str],
    warnings: Sequence[str] = (),
) -> RigCheck:
    """Compare a rig with one that was found from a recording.

    Args:
        found: the rig by the recording, and ``quality`` of its pairs.
        trajectory: of the person in the world of ``found`` (metres).
        unplaced: why the other cameras could not be placed.
    """
    person = np.median(trajectory, axis=0)
    pairs = [_check_pair(rig, found, pair, person) for pair in quality]
    names = found.names
    places = {tuple(names.index(name) for name in pair.cameras): pair for pair in pairs}
    good = {(a, b) for (a, b), pair in places.items() if pair.state == "good"}
    group = largest_group(range(len(names)), good)
    cameras = []
    for i, name in enumerate(names):
        others = [j for j in group if j != i] if len(group) > 1 else [j for j in range(len(names)) if j != i]
        mine = [places[min(i, j), max(i, j)] for j in others if (min(i, j), max(i, j)) in places]
        cameras.append(_check_camera(name, mine, i in group, len(group) > 1))
    cameras += [CameraCheck(name, "unknown", reason=reason) for name, reason in unplaced.items()]
    return RigCheck(cameras, pairs, list(warnings))


def _check_pair(rig: Rig, found: Rig, pair: PairVerdict, person: Float[ndarray, "3"]) -> PairCheck:
    a, b = pair.cameras
    of_rig = rig[b].camera_from_world @ rig[a].world_from_camera
    is_now = found[b].camera_from_world @ found[a].world_from_camera
    at = transform_points(rigid_inverse(is_now) @ found[b].camera_from_world, person)
    cm, degrees = moved(of_rig, is_now, transform_points(of_rig, at))
    return PairCheck(pair.cameras, cm, degrees, pair.uncertainty_mm / 10, pair.uncertainty_deg, pair.time_told)


def _check_camera(name: str, pairs: Sequence[PairCheck], in_group: bool, has_group: bool) -> CameraCheck:
    """A camera's state by its pairs with those that fit each other, or with all where none do."""
    if not pairs:
        return CameraCheck(name, "unknown", reason="it shares too little with the others")
    nearest = min(pairs, key=lambda pair: pair.uncertainty_cm)
    states = {pair.state for pair in pairs}
    if in_group and has_group:
        return CameraCheck(name, "good", nearest.cm, nearest.degrees)
    if "bumped" not in states:
        return CameraCheck(name, "unknown", nearest.cm, nearest.degrees, "it is not known well enough: walk for longer")
    reason = ""
    if not has_group:
        others = [other for pair in pairs for other in pair.cameras if other != name]
        reason = f"or {camera_list(list(dict.fromkeys(others)))}: it cannot be told which"
    return CameraCheck(name, "bumped", nearest.cm, nearest.degrees, reason)


def tell_check(check: RigCheck, console: Console) -> None:
    """Print the verdict."""
    table = Table(box=None, padding=(0, 1, 0, 0))
    for heading in ("cameras", "verdict", "off cm", "± cm", "off degrees", "± degrees"):
        table.add_column(heading, justify="left" if heading in ("cameras", "verdict") else "right")
    for pair in check.pairs:
        table.add_row(
            " – ".join(pair.cameras), pair.state, f"{pair.cm:.1f}", f"{pair.uncertainty_cm:.1f}",
            f"{pair.degrees:.2f}", f"{pair.uncertainty_deg:.2f}",
        )  # fmt: skip
    console.print(table)
    for camera in check.cameras:
        off = (
            "" if np.isnan(camera.cm) else f", off by {camera.cm:.1f} cm where the person is and {camera.degrees:.2f}°"
        )
        console.print(f"camera {camera.name!r}: {camera.state}{off}{f' ({camera.reason})' if camera.reason else ''}")
    for warning in check.warnings:
        console.print(f"Noticed: {warning}.")
