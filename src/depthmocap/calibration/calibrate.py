"""``depthmocap calibrate``: the extrinsics of the cameras of a recording, from a person who walks about in it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.table import Table

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.calibration_page import draw_clouds, pair_table, write_page
from depthmocap.calibration.camera_placement import Placement, mean_joints, place_cameras, why_unreliable
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.lateness_by_motion import find_jumps, jump_lines
from depthmocap.calibration.mending import mend_poses, mended_rig, open_mending
from depthmocap.calibration.observations import Observation
from depthmocap.calibration.origin import WALK, check_origin, find_lab
from depthmocap.calibration.refine import RefinedPlacement, refine
from depthmocap.calibration.rig_check import RigCheck, check_rig, tell_check
from depthmocap.calibration.sighting import Sighting, cameras_left_out, see_person, without
from depthmocap.calibration.upright import Upright, find_upright
from depthmocap.calibration.verdict import PairVerdict, find_warnings, judge_pairs, late_cameras
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.core.output import check_outputs, write_json
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import Rig, load_rig, save_rig, transform_points, z_up_from
from depthmocap.geometry.depth_camera import time_offsets_s
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording
from depthmocap.text import camera_list, joined, offset_lines

_GRADES = ("good", "fair", "poor")
#: No more faults are mended than so many: one that is told again and again is not mended.
_MOST_MENDED = 12
#: Expected error of the joints that several cameras see together (metres).
_PERSON_SIGMA_M = 0.03
_FLOORS = {
    "floor": "The floor is where the cameras see it.",
    "feet": "No camera sees enough of the floor: it is where the feet stood, to a few centimetres.",
    "body": "Neither floor nor feet tell how the world stands: up is along the body, give or take several degrees.",
}


@dataclasses.dataclass(frozen=True)
class CalibrateSettings(NetworkSettings):
    """Estimate the extrinsics from a person who walks about in front of the cameras for 20 to 60 s and moves the arms,
    or check those of a rig.

    Attributes:
        recording: a recording folder or an MCAP file; the extrinsics in its rig matter only for the picture "before".
        out: the rig.json to write.
        report: the page with pictures; by default beside ``out``, with its name and the ending .html.
        json: file for all numbers.
        segment: "auto" finds the person in a static scene; "none" takes every valid pixel.
        rate_hz: most frames per second of a camera that are used.
        weights: a classifier.onnx of your own.
        check: a rig.json that is compared with what the recording says: how far off each camera is, and whether it is
            good, bumped or not known. No rig is written without --mend.
        mend: write into the rig what mends wrong depth units, and mirrored and turned pictures. Otherwise they are
            named, and their cameras left out. With --check, the rig that is checked is written to --out with what mends
            these, and poses of another convention; nothing is placed anew.
        origin: the lab's own axes: "walk", from where the person first stands (the origin) and where they stand next
            (+X); a .json file of points of the floor; or a .c3d file of the same movement. By default the origin is
            below the middle of the person's path.
    """

    recording: tyro.conf.Positional[Path]
    out: Path = Path("rig.json")
    report: Path | None = None
    json: Path | None = None
    segment: Literal["auto", "none"] = "auto"
    rate_hz: float = 10.0
    weights: Path | None = None
    check: Path | None = None
    mend: bool = False
    origin: str = ""
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        if not 1 <= self.rate_hz <= 120:
            raise InputError(f"--rate-hz takes 1 to 120, got {self.rate_hz:g}")
        if self.origin:
            check_origin(self.origin)
        if self.out.suffix.lower() != ".json":
            raise InputError(f"--out must end in .json, got {self.out}")

    @property
    def page(self) -> Path:
        """The page with pictures."""
        return self.report or self.out.with_suffix(".html")


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    Attributes:
        rig: the cameras that could be placed. Z up, the floor at z = 0, the origin below the person's median position.
        floor: the source of the up direction and the floor: "floor", "feet" or "body" (see ``Upright``).
        unplaced: why each of the other cameras could not be placed, by name.
        pairs: quality of each pair of placed cameras.
        warnings: what would improve the calibration, one line each.
        offset_s: how much later than its timestamps say each placed camera exposes (seconds; the mean is 0); empty if
            it cannot be told of all.
        trajectory: positions of the pelvis in the world (metres).
        clouds: points of the empty scene by placed camera, in the camera's frame (metres).
        check: how far the cameras of an existing rig are off, if one is checked.
        person: the person's joints in the world (metres), by the times of the recording; None where they are not kept.
        origin: what the world's origin and axes are by, where the lab's were asked for, a line each.
    """

    rig: Rig
    floor: str
    unplaced: dict[str, str]
    pairs: list[PairVerdict]
    warnings: list[str]
    offset_s: dict[str, float]
    trajectory: Float[ndarray, "n 3"]
    clouds: dict[str, Float[ndarray, "_ 3"]]
    check: RigCheck | None = None
    person: JointTrack | None = None
    origin: tuple[str, ...] = ()

    @property
    def grade(self) -> str:
        """The grade of the worst pair."""
        return max((pair.grade for pair in self.pairs), key=_GRADES.index)


def find_rig(recording: Recording, settings: CalibrateSettings, console: Console) -> Calibration:
    """Estimate the extrinsics of the cameras of a recording.

    Raises:
        InputError: when the recording has fewer than two cameras, shows nobody, or no two cameras see the same person
            often enough.
    """
    recording, sighting, mended = _look(recording, settings, console)
    return _place(recording, sighting, mended, settings, console)


def _look(recording: Recording, settings: CalibrateSettings, console: Console) -> tuple[Recording, Sighting, list[str]]:
    """What the cameras see, with pictures mended if that is asked for: the recording with the mended rig, and what was
    mended, a line each."""
    names = recording.rig.names
    if len(names) < 2:
        raise InputError(f"{recording.path} has one camera ({', '.join(names)}): a calibration needs two or more")
    rng = np.random.default_rng([settings.seed, 1])
    mended: list[str] = []
    with networks_on(settings.device) as devices:
        while True:
            sighting = see_person(recording, settings.segment, settings.weights, settings.rate_hz, rng, console)
            certain = [fault for fault in sighting.faults if fault.certain]
            if not settings.mend or not certain or len(mended) > _MOST_MENDED:
                break
            mended += [f"mended: {fault.text}" for fault in certain]
            recording = open_recording(recording.path, mended_rig(recording.rig, certain))
    for line in devices.lines():
        console.print(f"  {line}")
    return recording, sighting, mended


def _place(
    recording: Recording, sighting: Sighting, mended: list[str], settings: CalibrateSettings, console: Console
) -> Calibration:
    rng = np.random.default_rng(settings.seed)
    with console.status("placing the cameras"):
        what, problems = str(recording.path), [*mended, *sighting.notes, *sighting.problems, *recording.problems]
        return solve_rig(what, sighting.observations, problems, rng, cameras_left_out(what, sighting))


def solve_rig(
    what: str,
    observations: list[Observation],
    problems: list[str],
    rng: np.random.Generator,
    left_out: Mapping[str, str] | None = None,
) -> Calibration:
    """Estimate the extrinsics from what cameras saw of a person.

    Args:
        what: where it was seen, for messages.
        problems: what makes good masks unlikely, and what is wrong with the frames.
        left_out: cameras that are not to be placed, with the reason.

    Raises:
        InputError: when nobody was seen, or no two cameras see the same person often enough.
    """
    left_out = left_out or {}
    names = tuple(observation.camera.name for observation in observations)
    if not any(len(observation.track.times_s) > 1 for observation in observations):
        hint = joined(problems) or "one person must walk about in view; try --segment none where there is no room"
        raise InputError(f"{what}: no person was found in any of {sum(s.frames for s in observations)} frames: {hint}")
    placement = place_cameras(without(left_out, names, [observation.track for observation in observations]), rng)
    if len(placement.cameras) < 2:
        raise InputError(f"{what}: {_no_pair_message(names, observations, placement)}")
    placed = [observations[camera] for camera in placement.cameras]
    placed_names = tuple(observation.camera.name for observation in placed)
    jumps = find_jumps([observation.track for observation in placed], placement.offset_s.tolist(), rng.spawn(1)[0])
    placement = dataclasses.replace(placement, untold=tuple(sorted({*placement.untold, *jumps})))
    refined = refine(placement, placed, rng)
    empty_views = [View(observation.camera, observation.empty_m) for observation in placed]
    upright = find_upright(refined.poses, placement.skeletons, empty_views)
    rig = _rig(placed, refined, upright, placement)
    pairs = judge_pairs(placed_names, placement, refined)
    start_s = min(float(observation.track.times_s[0]) for observation in placed if len(observation.track.times_s))
    warnings = [*find_warnings(placed_names, placement, pairs), *jump_lines(placed_names, jumps, start_s), *problems]
    if not refined.surfaces_used:
        warnings.append("no surface was seen well by two cameras, or it did not fit the skeletons, which decide alone")
    joints = transform_points(upright.world_from_old, mean_joints(refined.poses, placement.skeletons))
    hips = joints[:, JOINT_INDEX["Hip"]]
    trajectory = hips[np.isfinite(hips).all(1)]
    person = JointTrack(placement.skeletons.times_s, joints, np.full(joints.shape[:2], _PERSON_SIGMA_M))
    unplaced = {
        name: left_out.get(name) or _why_unplaced(index, names, observations, placement)
        for index, name in enumerate(names)
        if index not in placement.cameras
    }
    clouds = {observation.camera.name: observation.empty_surface().points for observation in placed}
    offset_s = {} if placement.untold else dict(zip(placed_names, placement.offset_s.tolist(), strict=True))
    return Calibration(rig, upright.source, unplaced, pairs, warnings, offset_s, trajectory, clouds, person=person)


def _rig(observations: list[Observation], refined: RefinedPlacement, upright: Upright, placement: Placement) -> Rig:
    """The placed cameras. Time offsets are those of the recording's rig, and what was found, if it is significant."""
    cameras = [observation.camera for observation in observations]
    offset_s = np.array([camera.time_offset_s for camera in cameras])
    if late_cameras(tuple(camera.name for camera in cameras), placement):
        offset_s = offset_s + placement.offset_s
    offset_s = offset_s - offset_s.mean()
    return Rig(
        tuple(
            dataclasses.replace(camera, world_from_camera=pose, time_offset_s=round(float(late_s), 6))
            for camera, pose, late_s in zip(cameras, upright.world_from_old @ refined.poses, offset_s, strict=True)
        )
    )


def _no_pair_message(names: tuple[str, ...], observations: list[Observation], placement: Placement) -> str:
    counts = ", ".join(
        f"{name} in {len(observation.track.times_s)}" for name, observation in zip(names, observations, strict=True)
    )
    best = max(placement.pairs.items(), key=lambda item: item[1].agreed, default=None)
    lack = f"; of {camera_list([names[index] for index in best[0]])} {why_unreliable(best[1])}" if best else ""
    return (
        f"no two cameras see the same person often enough: somebody is found by {counts} frames{lack}; walk where two "
        "cameras see the whole body, for 20 s or more, with nobody else in view"
    )


def _why_unplaced(index: int, names: tuple[str, ...], observations: list[Observation], placement: Placement) -> str:
    """Why a camera could not be placed."""
    if not observations[index].frames:
        return "it has no frames"
    if len(observations[index].track.times_s) < 2:
        return f"it never sees a person in {observations[index].frames} frames"
    partners = {indices[indices[0] == index]: pair for indices, pair in placement.pairs.items() if index in indices}
    placed = {names[other]: pair for other, pair in partners.items() if other in placement.cameras}
    best = max(placed, key=lambda other: placed[other].agreed, default="")
    if not best:
        return "it never sees the person at the same time as one that is"
    return f"with {best!r} {why_unreliable(placed[best])}"


@locks_outputs(files=("out", "page", "json"))
def calibrate(settings: CalibrateSettings, console: Console | None = None) -> Calibration:
    """Place the cameras of a recording, write the rig and the page, and print the verdict.

    Raises:
        InputError: when the recording cannot be read, cameras cannot be placed, or files cannot be written.
    """
    console = console or Terminal()
    if settings.check is not None:
        return _check(settings, load_rig(settings.check), console)
    recording, turned = open_mending(settings.recording, settings.mend)
    check_outputs(
        {"--out": settings.out, "--report": settings.page, "--json": settings.json},
        {
            "the recording": settings.recording, "the file of --weights": settings.weights,
            "the file of --origin": Path(settings.origin) if settings.origin not in ("", WALK) else None,
        },
    )  # fmt: skip
    calibration = find_rig(recording, settings, console)
    calibration.warnings[:0] = turned
    if settings.origin:
        calibration = _in_lab(calibration, settings)
    for path in (settings.page, settings.json):  # of another rig
        if path is not None:
            path.unlink(missing_ok=True)
    save_rig(calibration.rig, settings.out)
    headline, *notes = calibration_lines(calibration, len(recording.rig.cameras))
    before = _in_z_up_world(
        {name: recording.rig[name].world_from_camera for name in calibration.rig.names}, recording.up
    )
    rig = calibration.rig
    after = _in_z_up_world({camera.name: camera.world_from_camera for camera in rig.cameras}, rig.up)
    pictures = _draw(calibration, before, None), _draw(calibration, after, calibration.trajectory)
    write_page(settings.page, headline, notes, calibration.pairs, pictures)
    if settings.json is not None:
        write_json(settings.json, _as_json(calibration))
    print_calibration(calibration, [headline, *notes], console)
    console.print(
        f"{settings.out} has the cameras, {settings.page} the pictures; run, live and record take it by --rig."
    )
    return calibration


def _in_lab(calibration: Calibration, settings: CalibrateSettings) -> Calibration:
    """The calibration in the lab's own axes."""
    assert calibration.person is not None
    lab = find_lab(settings.origin, calibration.person, calibration.rig, np.random.default_rng([settings.seed, 2]))
    z_up = np.eye(4)
    z_up[:3, :3] = z_up_from(lab.up)
    return dataclasses.replace(
        calibration,
        rig=lab.rig(calibration.rig),
        trajectory=transform_points(z_up @ lab.lab_from_world, calibration.trajectory),
        origin=tuple(lab.lines),
    )


def calibration_lines(calibration: Calibration, cameras: int) -> list[str]:
    """The verdict, and what was noticed, a line each; ``cameras``: how many there are, placed or not."""
    return [
        _headline(calibration, cameras),
        _FLOORS[calibration.floor],
        *calibration.origin,
        *(f"Camera {name!r} is not in the rig: {reason}." for name, reason in calibration.unplaced.items()),
        *(f"Noticed: {warning}." for warning in calibration.warnings),
        *(f"{line}."[0].upper() + f"{line}."[1:] for line in offset_lines(time_offsets_s(calibration.rig.cameras))),
    ]


def _check(settings: CalibrateSettings, rig: Rig, console: Console) -> Calibration:
    """Compare a rig with what the recording says, and print the verdict."""
    if settings.origin:
        raise InputError("--origin is for a rig that is written from a recording, and --check writes none")
    checked = {"the recording": settings.recording, "the file of --check": settings.check}
    check_outputs({"--json": settings.json, **({"--out": settings.out} if settings.mend else {})}, checked)
    recording, sighting, lines = _look(open_recording(settings.recording, rig), settings, console)
    if settings.mend:
        rig = _mended(rig, recording.rig, sighting, lines, settings, console)
    placed = _place(recording, sighting, [], settings, console)
    # Intrinsics and what mends pictures are the rig's already, and so is what moves timestamps.
    check = check_rig(rig, placed.rig, placed.pairs, placed.trajectory, placed.unplaced, placed.warnings)
    placed = dataclasses.replace(placed, check=check)
    if settings.json is not None:
        write_json(settings.json, {**_as_json(placed), "check": dataclasses.asdict(check)})
    tell_check(check, console)
    return placed


def _mended(
    rig: Rig, seen: Rig, sighting: Sighting, lines: list[str], settings: CalibrateSettings, console: Console
) -> Rig:
    """Write a rig with what mends it, and print what that is.

    Args:
        seen: its cameras that the recording has, with their pictures mended.
        lines: what these were mended by.
    """
    left = [fault.text for fault in sighting.faults]
    if not left:
        seen, mended, left = mend_poses(seen, sighting.tracks, np.random.default_rng([settings.seed, 2]))
        lines = [*lines, *(f"mended: {line}" for line in mended)]
    # The unit of depth stays as the rig has it; that of the recording's device is used where it is played.
    cameras = {camera.name: camera for camera in rig.cameras}
    for camera in seen.cameras:
        cameras[camera.name] = dataclasses.replace(camera, depth_unit_m=cameras[camera.name].depth_unit_m)
    rig = Rig(tuple(cameras.values()), seen.up, rig.area_m)
    save_rig(rig, settings.out)
    for line in [*lines, *(f"not mended: {line}" for line in left)] or ["nothing to mend was found"]:
        console.print(f"{line[0].upper()}{line[1:]}.")
    console.print(f"{settings.out} has the rig.")
    return rig


def _headline(calibration: Calibration, cameras: int) -> str:
    worst_mm = max(pair.uncertainty_mm for pair in calibration.pairs)
    worst_deg = max(pair.uncertainty_deg for pair in calibration.pairs)
    if untold := [pair for pair in calibration.pairs if not pair.time_told]:
        return (
            f"Poor: {len(calibration.rig.cameras)} of {cameras} cameras are placed, but how far the timestamps of "
            f"{camera_list(untold[0].cameras)} are apart cannot be told, and their places are wrong by what the person "
            "moved in between."
        )
    return (
        f"{calibration.grade.capitalize()}: {len(calibration.rig.cameras)} of {cameras} cameras are placed, any two of "
        f"them to {worst_mm:.1f} mm where the person was and {worst_deg:.2f}° or better."
    )


def _in_z_up_world(poses: dict[str, Float[ndarray, "4 4"]], up: str) -> dict[str, Float[ndarray, "4 4"]]:
    """Poses in the Z-up world."""
    upright = np.eye(4)
    upright[:3, :3] = z_up_from(up)
    return {name: upright @ pose for name, pose in poses.items()}


def _draw(
    calibration: Calibration, poses: dict[str, Float[ndarray, "4 4"]], trajectory: Float[ndarray, "n 3"] | None
) -> bytes:
    clouds = {name: transform_points(poses[name], points) for name, points in calibration.clouds.items()}
    return draw_clouds(clouds, list(poses.values()), trajectory)


def _as_json(calibration: Calibration) -> dict[str, Any]:
    return {
        "verdict": calibration.grade,
        "floor": calibration.floor,
        "cameras": list(calibration.rig.names),
        "unplaced": calibration.unplaced,
        "pairs": [{**dataclasses.asdict(pair), "verdict": pair.grade} for pair in calibration.pairs],
        "late_ms": {name: 1e3 * offset_s for name, offset_s in calibration.offset_s.items()},
        "origin": list(calibration.origin),
        "time_offset_s": {camera.name: camera.time_offset_s for camera in calibration.rig.cameras},
        "warnings": calibration.warnings,
    }


def print_calibration(calibration: Calibration, lines: list[str], console: Console) -> None:
    """Print the table of pairs, and the lines."""
    numbers = pair_table(calibration.pairs)
    table = Table(box=None, padding=(0, 1, 0, 0))
    for heading in numbers.header:
        table.add_column(heading, justify="left" if heading in ("cameras", "verdict") else "right")
    for row in numbers.rows:
        table.add_row(*("–" if v is None else f"{v:.2f}" if isinstance(v, float) else str(v) for v in row))
    console.print(table)
    for line in lines:
        console.print(line)
