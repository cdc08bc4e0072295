"""``depthmocap sync``: separate recordings of one scene as one take, put in step by how somebody moves in them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from depthmocap.calibration.clock_network import SYSTEMATIC_S, ClockLink, Clocks, solve_clocks
from depthmocap.calibration.clock_steps import find_large_step, find_step
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.observations import observe, subsample_timestamps
from depthmocap.calibration.time_search import LONGEST_SEARCH_S, TimeMatch, find_time
from depthmocap.calibration.verdict import OFFSET_S
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.recordings.depth_codec import Coding
from depthmocap.recordings.merged_take import ClockMap, check_new_take, write_take
from depthmocap.recordings.open_recording import RECORDING_FILES, open_recording
from depthmocap.recordings.recording import Recording
from depthmocap.segment.person_by_network import PersonByNetwork
from depthmocap.text import joined

#: ± is so many standard errors.
SIGMAS = 3.0
#: A recording that covers less of the take than this is told.
_WHOLE = 0.8


@dataclasses.dataclass(frozen=True)
class SyncSettings(NetworkSettings):
    """Put separate recordings of one scene, whose clocks share nothing, into one take, in step by how somebody moves.

    Attributes:
        recordings: two or more recordings (folders, MCAP, an Azure Kinect's MKV), or a folder that holds them. The
            take has the clock of the first.
        out: the take: an MCAP file if its name ends in .mcap, else a folder.
        longest_s: how far apart the recordings may have been started (seconds).
        segment: "auto" finds the person in a static scene; "none" takes every valid pixel.
        rate_hz: most frames per second of a camera that are looked at.
        weights: a classifier.onnx of your own.
        coding: of the depth in MCAP. png and raw are larger, but other viewers show them.
    """

    recordings: tyro.conf.Positional[tuple[Path, ...]]
    out: Path = Path("take.mcap")
    longest_s: float = LONGEST_SEARCH_S
    segment: Literal["auto", "none"] = "auto"
    rate_hz: float = 15.0
    weights: Path | None = None
    coding: Coding = "delta-zstd"
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        if not 5 <= self.rate_hz <= 120:
            raise InputError(f"--rate-hz takes 5 to 120, got {self.rate_hz:g}")
        if not 0 < self.longest_s <= LONGEST_SEARCH_S:
            raise InputError(f"--longest-s takes up to {LONGEST_SEARCH_S:g}, got {self.longest_s:g}")


@dataclasses.dataclass(frozen=True, eq=False)
class SyncedClocks:
    """How the clocks of recordings lie on that of the first.

    Attributes:
        clocks: of each recording.
        sigma_s: standard error of each (seconds); 0 where it was not moved against the first.
        notes: what was noticed, one line each.
    """

    clocks: tuple[ClockMap, ...]
    sigma_s: tuple[float, ...]
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class _Camera:
    """One camera: its recording, and its track in seconds from the start of its clock's recordings."""

    name: str
    recording: int
    clock: int
    track: JointTrack


def sync(settings: SyncSettings, console: Console | None = None) -> SyncedClocks:
    """Put recordings in step, write the take and print the offsets.

    Raises:
        InputError: when there is one recording only, nobody is seen or moves, the offset of one cannot be told, cameras
            share a name, or the take cannot be written.
    """
    console = console or Terminal()
    recordings = [open_recording(path) for path in _listed(settings.recordings)]
    if len(recordings) < 2:
        raise InputError(
            f"{recordings[0].path} is one recording: sync takes two or more (calibrate finds the time offsets of the "
            "cameras of one)"
        )
    check_new_take(settings.out, recordings)
    synced = find_clocks(recordings, settings, console)
    frames, lost = write_take(settings.out, recordings, synced.clocks, settings.coding, console)
    _print_result(recordings, synced, console)
    for line in [*synced.notes, *(problem for recording in recordings for problem in recording.problems), *lost]:
        console.print(f"• {line}")
    console.print(
        f"{frames} frames of {len(recordings)} recordings are in {settings.out}; calibrate tells where its cameras "
        "stand."
    )
    return synced


def find_clocks(recordings: Sequence[Recording], settings: SyncSettings, console: Console) -> SyncedClocks:
    """The clocks of the recordings, by the movement that they see.

    Raises:
        InputError: when that of one cannot be told.
    """
    clock_of, starts_ns, middles_s = _group_by_clock(recordings)
    cameras = _observe_all(recordings, clock_of, starts_ns, settings, console)
    links: list[ClockLink] = []
    untold: list[tuple[_Camera, _Camera, TimeMatch]] = []
    notes: list[str] = []
    rng = np.random.default_rng(settings.seed)
    with console.status("comparing movements"):
        for a, b in itertools.combinations(cameras, 2):
            if a.clock > b.clock:
                a, b = b, a
            match = find_time(a.track, b.track, rng, settings.longest_s)
            if match.fit is None or not match.told:
                untold.append((a, b, match))
                continue
            fit = match.fit
            if a.clock == b.clock:
                if abs(fit.shift_s) > max(OFFSET_S, SIGMAS * fit.sigma_s):
                    notes.append(_out_of_step(a, b, fit.shift_s, fit.sigma_s))
                continue
            if step := find_step(a.track, b.track, fit):
                notes.append(
                    f"the clock of camera {a.name!r} or {b.name!r} jumps by {1e3 * abs(step.by_s):.0f} ms, "
                    f"{step.at_s - a.track.times_s[0]:.0f} s after the first frame of {a.name!r}: from there on, or up "
                    "to there, their frames are not of one moment; cut the recordings in two"
                )
            links.append(ClockLink(
                a.clock, b.clock, fit.shift_s, fit.sigma_s, fit.middle_s, fit.drift,
                fit.drift_sigma if fit.drift_sigma > 0 else float("inf"), match.shared_s,
            ))  # fmt: skip
    clocks = solve_clocks(len(starts_ns), links, middles_s)
    if clocks.unlinked:
        raise InputError(_why_unlinked(recordings, clocks, untold))
    if clocks.contradictions:
        link, apart_s = clocks.contradictions[0]
        names = [recordings[clock_of.index(clock)].path for clock in (link.one, link.other)]
        raise InputError(
            f"cannot tell how far the clocks of {names[0]} and {names[1]} are apart: what they show differs by "
            f"{abs(apart_s):.2f} s from what others tell of them; give recordings of a longer and less even movement"
        )
    notes += _drift_lines(recordings, clock_of, clocks)
    return _as_maps(clock_of, starts_ns, clocks, notes, recordings)


def _listed(paths: Sequence[Path]) -> list[Path]:
    """The recordings: those named, and those in folders that are none themselves."""
    listed: list[Path] = []
    for path in paths:
        if not path.is_dir() or _is_recording(path):
            listed.append(path)
            continue
        inside = [entry for entry in sorted(path.iterdir()) if _is_recording(entry)]
        if not inside:
            raise InputError(f"{path} has no recording in it, and is none: it has no rig.json")
        listed += inside
    if not listed:
        raise InputError("sync takes two or more recordings, or a folder that holds them")
    return listed


def _is_recording(path: Path) -> bool:
    return path.suffix.lower() in RECORDING_FILES if path.is_file() else (path / "rig.json").exists()


def _shared_clock(recording: Recording) -> str:
    """The name of the device clock of all cameras of a recording, which another recording may share; "" if none."""
    clocks = set()
    for name in recording.rig.names:
        for stamp in recording.stamps(name)[:1]:
            time_ns, clock = recording.device_time(name, stamp)
            clocks.add(clock if time_ns == stamp else "")
    clock = clocks.pop() if len(clocks) == 1 else ""
    # Folders all name their clock alike, and hosts too.
    return "" if clock == "recording" or clock.startswith("host") else clock


def _group_by_clock(recordings: Sequence[Recording]) -> tuple[list[int], list[int], list[float]]:
    """Which clock each recording has; the first timestamp (ns) of each clock, and the middle of its recordings after
    that (seconds)."""
    numbers: dict[str, int] = {}
    clock_of = [
        numbers.setdefault(_shared_clock(recording) or f"recording {index}", len(numbers))
        for index, recording in enumerate(recordings)
    ]
    firsts: list[list[int]] = [[] for _ in numbers]
    lasts: list[list[int]] = [[] for _ in numbers]
    for recording, clock in zip(recordings, clock_of, strict=True):
        stamps = [recording.stamps(name) for name in recording.rig.names if recording.stamps(name)]
        firsts[clock] += [camera_stamps[0] for camera_stamps in stamps]
        lasts[clock] += [camera_stamps[-1] for camera_stamps in stamps]
    starts_ns = [min(first) for first in firsts]
    return clock_of, starts_ns, [(max(last) - start) / 2e9 for last, start in zip(lasts, starts_ns, strict=True)]


def _observe_all(
    recordings: Sequence[Recording], clock_of: list[int], starts_ns: list[int], settings: SyncSettings, console: Console
) -> list[_Camera]:
    with networks_on(settings.device) as devices:
        classifier = Classifier(settings.weights)
    for line in devices.lines():
        console.print(f"  {line}")
    if not classifier.predicts_joints:
        raise InputError(f"{classifier.path} is a network that tells no joints, by which recordings are put in step")
    rate_hz = settings.rate_hz
    total = sum(len(subsample_timestamps(r.stamps(name), rate_hz)) for r in recordings for name in r.rig.names)
    cameras, problems = [], []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("looking", total=total)
        for index, recording in enumerate(recordings):
            segmenter = PersonByNetwork.from_recording(recording, settings.segment)
            problems += segmenter.problems
            for seen in observe(recording, classifier, segmenter, rate_hz, lambda: progress.advance(task)):
                times_s = seen.track.times_s - starts_ns[clock_of[index]] / 1e9
                track = JointTrack(times_s, seen.track.joints, seen.track.sigma_m)
                cameras.append(_Camera(seen.camera.name, index, clock_of[index], track))
    for index, recording in enumerate(recordings):
        if not any(len(c.track.times_s) > 1 for c in cameras if c.recording == index):
            hint = joined(problems) or "somebody must move about in view; try --segment none where there is no room"
            raise InputError(f"{recording.path}: no person was found in it, by whom it could be put in step: {hint}")
    return cameras


def _out_of_step(a: _Camera, b: _Camera, shift_s: float, sigma_s: float) -> str:
    return (
        f"cameras {a.name!r} and {b.name!r} share a clock and were not moved, but {b.name!r} looks "
        f"{1e3 * abs(shift_s):.0f} ± {1e3 * SIGMAS * sigma_s:.0f} ms {'later' if shift_s > 0 else 'earlier'} than its "
        "timestamps say; calibrate writes it as time_offset_s"
    )


def _why_unlinked(
    recordings: Sequence[Recording], clocks: Clocks, untold: Sequence[tuple[_Camera, _Camera, TimeMatch]]
) -> str:
    """Why the clock of a recording cannot be told, by the pair that comes nearest to telling it."""
    away = set(clocks.unlinked)
    a, b, match = max((u for u in untold if (u[0].clock in away) != (u[1].clock in away)), key=lambda u: u[2].rank)
    reason = match.why
    step = None if match.best_s is None else find_large_step(a.track, b.track, match.best_s)
    if step is not None:
        reason += f"; perhaps a clock jumps by about {abs(step.by_s):.1f} s in between"
    return (
        f"cannot tell how far the clocks of {recordings[a.recording].path} and {recordings[b.recording].path} are "
        f"apart: {reason}. One person must be in view of both for 20 s or so, who walks in turns and moves the arms"
    )


def _drift_lines(recordings: Sequence[Recording], clock_of: list[int], clocks: Clocks) -> list[str]:
    return [
        f"the clock of {recording.path} runs {1e6 * abs(clocks.drift[clock]):.0f} millionths too "
        f"{'slowly' if clocks.drift[clock] > 0 else 'fast'} against that of {recordings[0].path}: its frames are moved "
        "by what that makes, too"
        for recording, clock in zip(recordings, clock_of, strict=True)
        if clocks.drift[clock]
    ]


def _as_maps(
    clock_of: list[int], starts_ns: list[int], clocks: Clocks, notes: list[str], recordings: Sequence[Recording]
) -> SyncedClocks:
    """The clocks as maps of timestamps. The take's clock is that of the first, unless something would be before 0."""
    takes_ns = [starts_ns[0] + round(1e9 * shift_s) for shift_s in clocks.shift_s]
    lift_ns = max(0, -min(takes_ns))
    maps = tuple(
        ClockMap(starts_ns[clock], takes_ns[clock] + lift_ns, float(clocks.drift[clock])) for clock in clock_of
    )
    if lift_ns:
        notes = [*notes, f"{lift_ns / 1e9:.3f} s were added to all timestamps, because none can be before 0"]
    spans = [_span_s(recording, clock) for recording, clock in zip(recordings, maps, strict=True)]
    begin_s, end_s = min(span[0] for span in spans), max(span[1] for span in spans)
    for recording, (start_s, stop_s) in zip(recordings, spans, strict=True):
        if stop_s - start_s < _WHOLE * (end_s - begin_s):
            notes.append(
                f"{recording.path} covers {stop_s - start_s:.1f} of the take's {end_s - begin_s:.1f} s, from "
                f"{start_s - begin_s:.1f} to {stop_s - begin_s:.1f} s"
            )
    sigma_s = tuple(float(np.hypot(clocks.sigma_s[clock], SYSTEMATIC_S)) if clock else 0.0 for clock in clock_of)
    return SyncedClocks(maps, sigma_s, tuple(notes))


def _span_s(recording: Recording, clock: ClockMap) -> tuple[float, float]:
    """When a recording begins and ends by the take's clock (seconds)."""
    stamps = [recording.stamps(name) for name in recording.rig.names if recording.stamps(name)]
    return clock(min(s[0] for s in stamps)) / 1e9, clock(max(s[-1] for s in stamps)) / 1e9


def _print_result(recordings: Sequence[Recording], synced: SyncedClocks, console: Console) -> None:
    table = Table(box=None, padding=(0, 1, 0, 0))
    for heading in ("recording", "starts s", "moved s", "± ms", "drift ppm"):
        table.add_column(heading, justify="left" if heading == "recording" else "right")
    begin_s = min(_span_s(r, c)[0] for r, c in zip(recordings, synced.clocks, strict=True))
    for recording, clock, sigma_s in zip(recordings, synced.clocks, synced.sigma_s, strict=True):
        moved_s = (clock.take_ns - clock.start_ns) / 1e9
        table.add_row(
            str(recording.path), f"{_span_s(recording, clock)[0] - begin_s:.3f}",
            f"{moved_s:+.4f}" if moved_s else "–", f"{1e3 * SIGMAS * sigma_s:.1f}" if sigma_s else "–",
            f"{1e6 * clock.drift:+.0f}" if clock.drift else "–",
        )  # fmt: skip
    console.print(table)
