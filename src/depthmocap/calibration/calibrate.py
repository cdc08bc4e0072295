"""``depthmocap calibrate``: where the cameras of a recording stand, from a person who walks about in it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.calibration_page import draw_clouds, pair_table, write_page
from depthmocap.calibration.camera_placement import Placement, lacking, mean_joints, place
from depthmocap.calibration.observations import Observation, observe, thinned
from depthmocap.calibration.refine import refine
from depthmocap.calibration.upright import Upright, stand_up
from depthmocap.calibration.verdict import PairVerdict, judge_pairs, warnings_of
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import owns
from depthmocap.core.output import check_outputs, write_json
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import Rig, save_rig, transform_points, z_up_from
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording
from depthmocap.segment.static_scene import PersonSegmenter
from depthmocap.text import cameras, joined

_GRADES = ("good", "fair", "poor")
_FLOORS = {
    "floor": "The floor is where the cameras see it.",
    "feet": "No camera sees enough of the floor: it is where the feet stood, to a few centimetres.",
    "body": "Neither floor nor feet tell how the world stands: up is along the body, give or take several degrees.",
}


@dataclasses.dataclass(frozen=True)
class CalibrateSettings:
    """Cameras placed by a person who walks about in front of them for 20 to 60 s and moves the arms.

    Attributes:
        recording: a recording folder or an MCAP file; where its rig says that cameras stand does not matter, but for
            the picture "before".
        out: the rig.json to write.
        report: the page with pictures; by default beside ``out``, with its name and the ending .html.
        json: file for all numbers.
        segment: "auto" finds the person in a static scene; "none" takes every valid pixel.
        rate_hz: frames of a camera that are looked at, a second, at most.
        weights: a classifier.onnx of your own.
    """

    recording: tyro.conf.Positional[Path]
    out: Path = Path("rig.json")
    report: Path | None = None
    json: Path | None = None
    segment: Literal["auto", "none"] = "auto"
    rate_hz: float = 10.0
    weights: Path | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        if not 1 <= self.rate_hz <= 120:
            raise InputError(f"--rate-hz takes 1 to 120, got {self.rate_hz:g}")
        if self.out.suffix.lower() != ".json":
            raise InputError(f"--out must end in .json, got {self.out}")

    @property
    def page(self) -> Path:
        """The page with pictures."""
        return self.report or self.out.with_suffix(".html")


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """What was found.

    Attributes:
        rig: the cameras that could be placed. Z up, the floor at z = 0, the origin under where the person was.
        floor: what told up and the floor: "floor", "feet" or "body" (see ``Upright``).
        unplaced: why others could not be placed, by name.
        pairs: what is known of any two placed cameras.
        warnings: what would make it better, one line each.
        late_s: how much later than its timestamps say each placed camera looks, against the mean of all.
        way: places of the pelvis.
        clouds: points of the empty scene by placed camera, in the camera's frame.
    """

    rig: Rig
    floor: str
    unplaced: dict[str, str]
    pairs: list[PairVerdict]
    warnings: list[str]
    late_s: dict[str, float]
    way: Float[ndarray, "n 3"]
    clouds: dict[str, Float[ndarray, "_ 3"]]

    @property
    def grade(self) -> str:
        """That of the worst pair."""
        return max((pair.grade for pair in self.pairs), key=_GRADES.index)


def find_rig(recording: Recording, settings: CalibrateSettings, console: Console) -> Calibration:
    """Find where the cameras of a recording stand.

    Raises:
        InputError: when the recording has fewer than two cameras, shows nobody, or no two cameras see the same person
            often enough.
    """
    names = recording.rig.names
    if len(names) < 2:
        raise InputError(f"{recording.path} has one camera ({', '.join(names)}): a calibration needs two or more")
    with console.status("reading the background and the weights"):
        classifier = Classifier(settings.weights)
        segmenter = PersonSegmenter.from_recording(recording, settings.segment)
    if not classifier.predicts_joints:
        raise InputError(f"{classifier.path} is a network that tells no joints, which a calibration is made of")
    total = sum(len(thinned(recording.stamps(name), settings.rate_hz)) for name in names)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("looking", total=total)
        seen = observe(recording, classifier, segmenter, settings.rate_hz, lambda: progress.advance(task))
    rng = np.random.default_rng(settings.seed)
    with console.status("placing the cameras"):
        return _solve(recording, seen, segmenter.problems, rng)


def _solve(recording: Recording, seen: list[Observation], problems: list[str], rng: np.random.Generator) -> Calibration:
    names = recording.rig.names
    lookers = [each for each in seen if len(each.track.times_s) > 1]
    if not lookers:
        hint = joined(problems) or "one person must walk about in view; try --segment none where there is no room"
        raise InputError(
            f"{recording.path}: no person was found in any of {sum(s.frames for s in seen)} frames: {hint}"
        )
    placement = place([each.track for each in seen], rng)
    if len(placement.cameras) < 2:
        raise InputError(f"{recording.path}: {_nothing_shared(names, seen, placement)}")
    chosen = [seen[camera] for camera in placement.cameras]
    own = tuple(each.camera.name for each in chosen)
    refined = refine(placement, chosen, rng)
    upright = stand_up(refined.poses, placement.skeletons, [View(each.camera, each.empty_m) for each in chosen])
    rig = _rig(chosen, refined.poses, upright)
    pairs = judge_pairs(own, placement, refined)
    warnings = [*warnings_of(own, placement, pairs), *problems, *recording.problems]
    if not refined.kept:
        warnings.append("no surface was seen well by two cameras, or it did not fit the skeletons, which decide alone")
    hips = mean_joints(refined.poses, placement.skeletons)[:, JOINT_INDEX["Hip"]]
    way = transform_points(upright.world_from_old, hips[np.isfinite(hips).all(1)])
    unplaced = {
        name: _why(index, names, seen, placement) for index, name in enumerate(names) if index not in placement.cameras
    }
    clouds = {each.camera.name: each.empty_surface().points for each in chosen}
    late_s = dict(zip(own, placement.late_s.tolist(), strict=True))
    return Calibration(rig, upright.told_by, unplaced, pairs, warnings, late_s, way, clouds)


def _rig(seen: list[Observation], poses: Float[ndarray, "k 4 4"], upright: Upright) -> Rig:
    placed = upright.world_from_old @ poses
    return Rig(
        tuple(dataclasses.replace(each.camera, world_from_camera=pose) for each, pose in zip(seen, placed, strict=True))
    )


def _nothing_shared(names: tuple[str, ...], seen: list[Observation], placement: Placement) -> str:
    counts = ", ".join(f"{name} in {len(each.track.times_s)}" for name, each in zip(names, seen, strict=True))
    best = max(placement.pairs.items(), key=lambda item: item[1].agreed, default=None)
    found = f"; of {cameras([names[each] for each in best[0]])} {lacking(best[1])}" if best else ""
    return (
        f"no two cameras see the same person often enough: somebody is found by {counts} frames{found}; walk where two "
        "cameras see the whole body, for 20 s or more, with nobody else in view"
    )


def _why(index: int, names: tuple[str, ...], seen: list[Observation], placement: Placement) -> str:
    """Why a camera could not be placed, and the way out."""
    if not seen[index].frames:
        return "it has no frames"
    if len(seen[index].track.times_s) < 2:
        return f"it never sees a person in {seen[index].frames} frames"
    shared = {pair[pair[0] == index]: found for pair, found in placement.pairs.items() if index in pair}
    own = {names[other]: found for other, found in shared.items() if other in placement.cameras}
    best = max(own, key=lambda other: own[other].agreed, default="")
    if not best:
        return "it never sees the person at the same time as one that is"
    return f"with {best!r} {lacking(own[best])}"


@owns(files=("out", "page", "json"))
def calibrate(settings: CalibrateSettings, console: Console | None = None) -> Calibration:
    """Place the cameras of a recording, write the rig and the page, and print the verdict.

    Raises:
        InputError: when the recording cannot be read, cameras cannot be placed, or files cannot be written.
    """
    console = console or Terminal()
    recording = open_recording(settings.recording)
    check_outputs(
        {"--out": settings.out, "--report": settings.page, "--json": settings.json},
        {"the recording": settings.recording, "the file of --weights": settings.weights},
    )
    found = find_rig(recording, settings, console)
    for path in (settings.page, settings.json):  # of another rig
        if path is not None:
            path.unlink(missing_ok=True)
    save_rig(found.rig, settings.out)
    headline = _headline(found, len(recording.rig.cameras))
    notes = [
        _FLOORS[found.floor],
        *(f"Camera {name!r} is not in the rig: {why}." for name, why in found.unplaced.items()),
        *(f"Noticed: {warning}." for warning in found.warnings),
    ]
    before = _placed({name: recording.rig[name].world_from_camera for name in found.rig.names}, recording.up)
    after = {camera.name: camera.world_from_camera for camera in found.rig.cameras}
    pictures = _picture(found, before, None), _picture(found, after, found.way)
    write_page(settings.page, headline, notes, found.pairs, pictures)
    if settings.json is not None:
        write_json(settings.json, _numbers(found))
    _tell(found, [headline, *notes], console)
    console.print(
        f"{settings.out} has the cameras, {settings.page} the pictures; run, live and record take it by --rig."
    )
    return found


def _headline(found: Calibration, cameras: int) -> str:
    worst_mm = max(pair.uncertainty_mm for pair in found.pairs)
    worst_deg = max(pair.uncertainty_deg for pair in found.pairs)
    return (
        f"{found.grade.capitalize()}: {len(found.rig.cameras)} of {cameras} cameras are placed, any two of them to "
        f"{worst_mm:.1f} mm where the person was and {worst_deg:.2f}° or better."
    )


def _placed(poses: dict[str, Float[ndarray, "4 4"]], up: str) -> dict[str, Float[ndarray, "4 4"]]:
    """Poses in the Z-up world."""
    upright = np.eye(4)
    upright[:3, :3] = z_up_from(up)
    return {name: upright @ pose for name, pose in poses.items()}


def _picture(found: Calibration, poses: dict[str, Float[ndarray, "4 4"]], way: Float[ndarray, "n 3"] | None) -> bytes:
    clouds = {name: transform_points(poses[name], points) for name, points in found.clouds.items()}
    return draw_clouds(clouds, list(poses.values()), way)


def _numbers(found: Calibration) -> dict[str, Any]:
    return {
        "verdict": found.grade,
        "floor": found.floor,
        "cameras": list(found.rig.names),
        "unplaced": found.unplaced,
        "pairs": [{**dataclasses.asdict(pair), "verdict": pair.grade} for pair in found.pairs],
        "late_ms": {name: 1e3 * late_s for name, late_s in found.late_s.items()},
        "warnings": found.warnings,
    }


def _tell(found: Calibration, lines: list[str], console: Console) -> None:
    numbers = pair_table(found.pairs)
    table = Table(box=None, padding=(0, 1, 0, 0))
    for heading in numbers.header:
        table.add_column(heading, justify="left" if heading in ("cameras", "verdict") else "right")
    for row in numbers.rows:
        table.add_row(*("–" if v is None else f"{v:.2f}" if isinstance(v, float) else str(v) for v in row))
    console.print(table)
    for line in lines:
        console.print(line)
