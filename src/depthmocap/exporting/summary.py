"""``summary.json``: what came of a take, of all of it or of one person; the same keys whoever wrote it.

docs/guides/export.md says what they mean. A number that cannot be told is null.
"""

from __future__ import annotations

import collections
import json
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import plain_json, write_json
from depthmocap.errors import InputError
from depthmocap.frames import Pose

#: Of the keys and what they mean; one more whenever a key goes or changes its meaning.
SCHEMA = 1
SUMMARY_FILE = "summary.json"
#: Intervals between poses by which the rate of a recording is told.
_INTERVALS = 1000


class Quantiles(TypedDict):
    """Of milliseconds."""

    p50: float
    p95: float


class Problem(TypedDict):
    """What a user should know, in one line, and how often it was so."""

    text: str
    times: int


#: First and last frame (from 0), both included, of each stretch of frames.
Stretches = list[list[int]]


class Summary(TypedDict):
    """The keys of summary.json, in their order."""

    schema: int
    command: Literal["run", "live"]
    version: str
    machine: str
    sources: list[str]
    person: int | None
    first_timestamp_ns: int | None
    interrupted: bool
    frames: int
    gaps: int
    gap_frames: Stretches
    recorded_frames_per_second: float | None
    mean_confidence: float | None
    least_confidence: float
    unsure_joints: dict[str, int]
    bvh_start_s: float | None
    bvh_held: dict[str, Stretches]
    smoothing: dict[str, Any] | None
    seconds: float | None
    frames_per_second: float | None
    frames_by_camera: dict[str, int]
    frames_by_person: dict[str, int]
    sets_dropped: int
    sets_before_ready: int
    ms_per_frame: Quantiles | None
    ms_per_stage: dict[str, Quantiles]
    latency_ms: Quantiles | None
    skew_ms: Quantiles | None
    cameras: dict[str, dict[str, Any]]
    cameras_apart_cm: dict[str, float]
    error: dict[str, Any] | None
    problems: list[Problem]


class Take:
    """What all results of one take share.

    Attributes:
        command: that makes them.
        sources: recordings or cameras, as they were named.
        up: the world's up axis.
        least_confidence: joints below it are gaps in TRC, and held in BVH.
        origin_ns: the timestamp of ``time_s`` = 0 in every file; None until the first set.
    """

    def __init__(
        self, command: Literal["run", "live"], sources: Iterable[str | Path], up: str, least_confidence: float
    ) -> None:
        """
        Raises:
            InputError: when ``least_confidence`` is not from 0 to 1.
        """
        if not 0 <= least_confidence <= 1:
            raise InputError(f"--least-confidence must be from 0 to 1, got {least_confidence}")
        self.command: Literal["run", "live"] = command
        self.sources, self.up, self.least_confidence = [str(source) for source in sources], up, least_confidence
        self.origin_ns: int | None = None

    def begin(self, timestamp_ns: int) -> int:
        """The timestamp of ``time_s`` = 0, which is that of the first call."""
        if self.origin_ns is None:
            self.origin_ns = timestamp_ns
        return self.origin_ns


class PoseNumbers:
    """Numbers of a sequence of poses, taken one by one; memory grows with the stretches without anybody alone."""

    def __init__(self, least_confidence: float) -> None:
        self._least = least_confidence
        self.frames = 0
        self._gaps: Stretches = []
        self._confidence = 0.0
        self._unsure = np.zeros(len(JOINTS), np.int64)
        self._intervals_ns: list[int] = []
        self._last_ns: int | None = None

    def add(self, pose: Pose) -> None:
        """Take one pose."""
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
        """Poses without a joint."""
        return sum(last - first + 1 for first, last in self._gaps)

    def summary(self) -> dict[str, Any]:
        """Keys of :class:`Summary` that follow from the poses."""
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
    """The summary of a take, or of one person in it, as it is written: NaN is None, and tuples are lists.

    Args:
        numbers: by keys of :class:`Summary`, whatever is known; ``problems`` as texts with how often each was so.

    Raises:
        ValueError: for a key that is none of a summary's.
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
        "seconds": None,
        "frames_per_second": None,
        "frames_by_camera": {},
        "frames_by_person": {},
        "sets_dropped": 0,
        "sets_before_ready": 0,
        "ms_per_frame": None,
        "ms_per_stage": {},
        "latency_ms": None,
        "skew_ms": None,
        "cameras": {},
        "cameras_apart_cm": {},
        "error": None,
        "problems": [{"text": text, "times": times} for text, times in problems.items()],
    }
    summary.update(known)  # type: ignore[typeddict-item]
    return plain_json(summary)


def write_summary(folder: Path, summary: Summary) -> None:
    """Write summary.json into a folder of results.

    Raises:
        InputError: when it cannot be written.
    """
    write_json(folder / SUMMARY_FILE, summary)


def read_summary(path: Path) -> Summary:
    """The summary of a file, or of a folder of results.

    Raises:
        InputError: when there is none, it is none, or was written by another version that wrote other keys.
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
    """The document that a file holds, if it is a summary.

    Raises:
        InputError: see :func:`read_summary`.
    """
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema is None:
        raise InputError(f"{path} is no summary of run or live of this version: it has no schema; run it again")
    if schema != SCHEMA:
        raise InputError(f"{path} has the schema {schema!r}, and this version reads {SCHEMA}: run it again")
    if absent := [key for key in Summary.__annotations__ if key not in document]:
        raise InputError(f"{path} lacks {', '.join(absent[:4])}: it was changed since it was written; run it again")
    return document  # type: ignore[return-value]


def count_problems(*lists: Iterable[str]) -> collections.Counter[str]:
    """How often each problem was told, in the order in which they came."""
    return collections.Counter(problem for each in lists for problem in each)


def problem_lines(problems: Sequence[Problem]) -> list[str]:
    """Problems as a user reads them."""
    return [each["text"] + (f" ({each['times']} times)" if each["times"] > 1 else "") for each in problems]


def unsure_lines(summary: Summary, most: int = 4) -> list[str]:
    """Which joints were too unsure for TRC and BVH, for a user to read; none where all were sure enough."""
    counts = sorted(summary["unsure_joints"].items(), key=lambda item: -item[1])
    if not counts:
        return []
    named = ", ".join(f"{joint} in {count} frames" for joint, count in counts[:most])
    more = f" and {len(counts) - most} other joints" if len(counts) > most else ""
    return [
        f"confidence below {summary['least_confidence']:g} (--least-confidence), so that pose.trc has a gap and "
        f"pose.bvh holds the bone: {named}{more}"
    ]


def stretches(marked: Bool[ndarray, " t"]) -> Stretches:
    """Where marks are set, from first to last, both included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return [[int(first), int(end) - 1] for first, end in edges.reshape(-1, 2)]
