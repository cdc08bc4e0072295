"""``summary.json``: the summary of a take, or of one person in it, with the same keys from ``run`` and ``live``.

docs/guides/export.md explains the keys. An unknown number is null.
"""

from __future__ import annotations

import collections
import json
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, cast

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import plain_json, write_json
from depthmocap.errors import InputError
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.frames import Pose

#: Version of the keys; it increases when a key is removed or changes its meaning.
SCHEMA = 1
SUMMARY_FILE = "summary.json"
#: Number of intervals between poses that the frame rate is computed from.
_INTERVALS = 1000


class Quantiles(TypedDict):
    """Quantiles of a duration (milliseconds)."""

    p50: float
    p95: float


class Problem(TypedDict):
    """A problem for the user in one line, and how often it occurred."""

    text: str
    times: int


#: First and last frame (from 0, both included) of each range of frames.
FrameRanges = list[list[int]]


class Summary(TypedDict):
    """The keys of summary.json, in their order."""

    schema: int
    command: Literal["run", "live"]
    version: str
    machine: str
    sources: list[str]
    up: str
    person: int | None
    first_timestamp_ns: int | None
    interrupted: bool
    frames: int
    gaps: int
    gap_frames: FrameRanges
    recorded_frames_per_second: float | None
    mean_confidence: float | None
    least_confidence: float
    unsure_joints: dict[str, int]
    bvh_start_s: float | None
    bvh_held: dict[str, FrameRanges]
    smoothing: dict[str, Any] | None
    devices: dict[str, str]
    seconds: float | None
    frames_per_second: float | None
    frames_by_camera: dict[str, int]
    frames_by_person: dict[str, int]
    sets_dropped: int
    sets_labelled_in_part: int
    sets_before_ready: int
    ms_per_frame: Quantiles | None
    ms_per_stage: dict[str, Quantiles]
    latency_ms: Quantiles | None
    skew_ms: Quantiles | None
    cameras: dict[str, dict[str, Any]]
    cameras_apart_cm: dict[str, float]
    time_offsets_s: dict[str, float]
    recorded_minus_timestamp_ns: int | None
    error: dict[str, Any] | None
    problems: list[Problem]


class Take:
    """What all result files of one take share.

    Attributes:
        command: the command that writes them.
        sources: recordings or cameras, as the user named them.
        up: the world's up axis.
        files: what files are written, and how.
        origin_ns: the timestamp of ``time_s`` = 0 in every file; None before the first frame set.
    """

    def __init__(
        self, command: Literal["run", "live"], sources: Iterable[str | Path], up: str, files: FileSettings
    ) -> None:
        """
        Raises:
            InputError: when a setting is out of range.
        """
        files.check()
        self.command: Literal["run", "live"] = command
        self.sources, self.up, self.files = [str(source) for source in sources], up, files
        self.origin_ns: int | None = None

    @property
    def least_confidence(self) -> float:
        """Joints with less are gaps in TRC, and held in BVH."""
        return self.files.least_confidence

    def begin(self, timestamp_ns: int) -> int:
        """The timestamp of ``time_s`` = 0: that of the first call."""
        if self.origin_ns is None:
            self.origin_ns = timestamp_ns
        return self.origin_ns


class PoseStatistics:
    """Statistics of a sequence of poses, added one by one; memory grows only with the number of gaps."""

    def __init__(self, least_confidence: float) -> None:
        self._least = least_confidence
        self.frames = 0
        self._gaps: FrameRanges = []
        self._confidence = 0.0
        self._unsure = np.zeros(len(JOINTS), np.int64)
        self._intervals_ns: list[int] = []
        self._last_ns: int | None = None

    def add(self, pose: Pose) -> None:
        """Add one pose."""
        observed = np.isfinite(pose.joints).all(-1)
        if not observed.any():
            if self._gaps and self._gaps[-1][1] == self.frames - 1:
                self._gaps[-1][1] = self.frames
            else:
                self._gaps.append([self.frames, self.frames])
        self._unsure += observed & (pose.confidence < self._least)
        self._confidence += float(pose.confidence.mean())
        if self._last_ns is not None and len(self._intervals_ns) < _INTERVALS:
            self._intervals_ns.append(pose.timestamp_ns - self._last_ns)
        self._last_ns = pose.timestamp_ns
        self.frames += 1

    @property
    def gaps(self) -> int:
        """Number of poses without a joint."""
        return sum(last - first + 1 for first, last in self._gaps)

    def summary(self) -> dict[str, Any]:
        """The values of :class:`Summary` that follow from the poses, by key."""
        interval_ns = float(np.median(self._intervals_ns)) if self._intervals_ns else 0.0
        return {
            "frames": self.frames,
            "gaps": self.gaps,
            "gap_frames": self._gaps,
            "recorded_frames_per_second": 1e9 / interval_ns if interval_ns > 0 else None,
            "mean_confidence": self._confidence / self.frames if self.frames else None,
            "unsure_joints": {
                joint: count for joint, count in zip(JOINTS, self._unsure.tolist(), strict=True) if count
            },
        }


def make_summary(take: Take, numbers: Mapping[str, Any], person: int | None = None) -> Summary:
    """The summary of a take, or of one person in it, ready for JSON: NaN is None, and tuples are lists.

    Args:
        numbers: known values by key of :class:`Summary`; ``problems`` as texts with the number of their occurrences.

    Raises:
        ValueError: for a key that a summary does not have.
    """
    from depthmocap.core.version import __version__

    if unknown := set(numbers) - set(Summary.__annotations__):
        raise ValueError(f"not of a summary: {', '.join(sorted(unknown))}")
    known = dict(numbers)
    problems: Mapping[str, int] = known.pop("problems", {})
    summary: Summary = {
        "schema": SCHEMA,
        "command": take.command,
        "version": __version__,
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "sources": take.sources,
        "up": take.up,
        "person": person,
        "first_timestamp_ns": take.origin_ns,
        "interrupted": False,
        "frames": 0,
        "gaps": 0,
        "gap_frames": [],
        "recorded_frames_per_second": None,
        "mean_confidence": None,
        "least_confidence": take.least_confidence,
        "unsure_joints": {},
        "bvh_start_s": None,
        "bvh_held": {},
        "smoothing": None,
        "devices": {},
        "seconds": None,
        "frames_per_second": None,
        "frames_by_camera": {},
        "frames_by_person": {},
        "sets_dropped": 0,
        "sets_labelled_in_part": 0,
        "sets_before_ready": 0,
        "ms_per_frame": None,
        "ms_per_stage": {},
        "latency_ms": None,
        "skew_ms": None,
        "cameras": {},
        "cameras_apart_cm": {},
        "time_offsets_s": {},
        "recorded_minus_timestamp_ns": None,
        "error": None,
        "problems": [{"text": text, "times": times} for text, times in problems.items()],
    }
    return plain_json({**summary, **known})


def write_summary(folder: Path, summary: Summary) -> None:
    """Write summary.json into a folder of results.

    Raises:
        InputError: when it cannot be written.
    """
    write_json(folder / SUMMARY_FILE, summary)


def read_summary(path: Path) -> Summary:
    """The summary of a file, or of a folder of results.

    Raises:
        InputError: when the file is missing, is not a summary, or was written by a version with other keys.
    """
    path = path / SUMMARY_FILE if path.is_dir() else path
    try:
        document = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path} not found: depthmocap run and live write it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not JSON: {error}") from None
    return check_summary(path, document)


def check_summary(path: Path, document: Any) -> Summary:
    """The parsed content of a file, if it is a summary.

    Raises:
        InputError: as :func:`read_summary`.
    """
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema is None:
        raise InputError(f"{path} is no summary of run or live of this version: it has no schema; run it again")
    if schema != SCHEMA:
        raise InputError(f"{path} has the schema {schema!r}, and this version reads {SCHEMA}: run it again")
    document = {
        # which the first summaries do not have
        "up": "z", "time_offsets_s": {}, "devices": {}, "recorded_minus_timestamp_ns": None,
        **document,
    }  # fmt: skip
    if absent := [key for key in Summary.__annotations__ if key not in document]:
        raise InputError(f"{path} lacks {', '.join(absent[:4])}: it was changed since it was written; run it again")
    return cast(Summary, document)


def count_problems(*lists: Iterable[str]) -> collections.Counter[str]:
    """The number of occurrences of each problem, in the order of the first ones."""
    return collections.Counter(problem for problems in lists for problem in problems)


def problem_lines(problems: Sequence[Problem]) -> list[str]:
    """Problems as lines for the user."""
    return [problem["text"] + (f" ({problem['times']} times)" if problem["times"] > 1 else "") for problem in problems]


def unsure_lines(summary: Summary, shown: int = 4) -> list[str]:
    """Lines for the user on joints whose confidence is too low for TRC and BVH; none if there are no such joints."""
    counts = sorted(summary["unsure_joints"].items(), key=lambda item: -item[1])
    if not counts:
        return []
    named = ", ".join(f"{joint} in {count} frames" for joint, count in counts[:shown])
    more = f" and {len(counts) - shown} other joints" if len(counts) > shown else ""
    return [
        f"confidence below {summary['least_confidence']:g} (--least-confidence), so that pose.trc has a gap and "
        f"pose.bvh holds the bone: {named}{more}"
    ]


def frame_ranges(mask: Bool[ndarray, " t"]) -> FrameRanges:
    """The ranges of frames in a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [[int(first), int(end) - 1] for first, end in edges.reshape(-1, 2)]
