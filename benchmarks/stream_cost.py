"""What streams cost a capture: a recording played in real time without and with them, in turns in one run.

    python benchmarks/stream_cost.py [--recording PATH] [--streams osc ws] [--rounds 3] [--json FILE]

prints CPU time a set, sets a second and sets left out of both, and their ratio; of each stream the CPU time of sending
a sample, and the time from the last exposure of a set to the arrival of its packet in another process of this machine.
Trust ratios more than milliseconds. Receivers read every message and do nothing else; their CPU time is not counted.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from stream_receivers import Arrivals, Scheme, receivers

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.core.output import plain_json, write_json
from depthmocap.geometry import Rig
from depthmocap.offline.pipeline import Pipeline, warm_up
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.recordings.open_recording import open_recording, packaged_recording
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.stream_protocol import Sample, Stream, StreamSetup


@dataclasses.dataclass(frozen=True)
class StreamCost:
    """Settings.

    Attributes:
        recording: played in real time; by default the packaged one.
        streams: that run at the same time.
        rounds: of each.
        json: also write all numbers to this file.
    """

    recording: Path = dataclasses.field(default_factory=packaged_recording)
    streams: tuple[Scheme, ...] = ("osc", "ws")
    rounds: int = 3
    json: Path | None = None


@dataclasses.dataclass(frozen=True)
class Round:
    """One playing of the recording.

    Attributes:
        sample: the last one.
        cpu_ms: CPU time of this process, by set.
        latencies_ms: of each stream, from the last exposure of every set to the arrival of its packet.
    """

    sets: int
    seconds: float
    dropped: int
    cpu_ms: float
    latencies_ms: dict[str, list[float]]
    sample: Sample


@contextlib.contextmanager
def _streams(schemes: Sequence[Scheme]) -> Iterator[tuple[list[str], dict[str, Arrivals]]]:
    """The addresses of receivers, and at the end what arrived."""
    with receivers(schemes) as (ports, arrived):
        yield [f"{scheme}://127.0.0.1:{port}" for scheme, port in zip(schemes, ports, strict=True)], arrived


class _Newest(Stream):
    """Keeps the newest sample."""

    sample: Sample

    def send(self, sample: Sample) -> None:
        self.sample = sample


def send_ms(scheme: Scheme, sample: Sample, rig: Rig, times: int = 200) -> float:
    """CPU time of sending a sample to somebody who receives it, again and again."""
    with _streams([scheme]) as (addresses, _):
        stream = open_stream(addresses[0])
        stream.start(StreamSetup(rig))
        time.sleep(1.0)  # until the receiver is connected
        begun_s = time.process_time()
        for i in range(times):
            stream.send(dataclasses.replace(sample, unix_ns=sample.unix_ns + i * 33_000_000))
        spent_s = time.process_time() - begun_s
        stream.close()
    return spent_s * 1e3 / times


def play(recording: Path, pipeline: Pipeline, schemes: Sequence[Scheme]) -> Round:
    """Play the recording once."""
    pipeline.reset()
    exposed_ns: dict[int, int] = {}
    newest = _Newest()
    with _streams(schemes) as (addresses, arrived):
        sources = make_sources([str(recording)], PlaybackClock(1.0))
        with LiveCapture(sources, pipeline=pipeline, streams=[newest, *addresses]) as capture:
            time.sleep(1.0 if schemes else 0.0)  # until everybody is connected: sets meanwhile are left out
            capture.reader.reset_dropped()
            start_s, cpu_s = time.monotonic(), time.process_time()
            for live in capture:
                exposed_ns[round((live.pose.timestamp_ns + capture.unix_minus_monotonic_ns) * 1e-6)] = max(
                    live.synced.times_ns.values()
                )
            seconds, cpu_s = time.monotonic() - start_s, time.process_time() - cpu_s
            dropped = capture.dropped
    latencies = {
        scheme: [
            (arrived[scheme][key].ns - last_ns) * 1e-6 for key, last_ns in exposed_ns.items() if key in arrived[scheme]
        ]
        for scheme in schemes
    }
    return Round(len(exposed_ns), seconds, dropped, cpu_s * 1e3 / max(len(exposed_ns), 1), latencies, newest.sample)


def measure(settings: StreamCost) -> dict[str, list[Round]]:
    """Rounds without and with streams, in turns."""
    source = open_recording(settings.recording)
    pipeline = warm_up(load_pipeline(source), source[0])
    rounds: dict[str, list[Round]] = {"without": [], "with": []}
    for _ in range(settings.rounds):
        rounds["without"].append(play(settings.recording, pipeline, ()))
        rounds["with"].append(play(settings.recording, pipeline, settings.streams))
    return rounds


def main(settings: StreamCost) -> None:
    """Measure and print."""
    console, rounds = Console(), measure(settings)
    table = Table(title=f"{settings.rounds} times {settings.recording.name}, {' and '.join(settings.streams)}")
    for column in ("", "CPU ms a set", "sets a second", "sets left out"):
        table.add_column(column, justify="right" if column else "left")
    cpu_ms = {}
    for name, played in rounds.items():
        cpu_ms[name] = float(np.median([each.cpu_ms for each in played]))
        rate = np.median([each.sets / each.seconds for each in played])
        table.add_row(name, f"{cpu_ms[name]:.1f}", f"{rate:.1f}", str(sum(each.dropped for each in played)))
    console.print(table)
    console.print(f"with streams {cpu_ms['with'] / cpu_ms['without']:.2f} times the CPU of without")
    last, rig = rounds["with"][-1].sample, open_recording(settings.recording).rig
    numbers: dict[str, Any] = {"cpu_ms": cpu_ms, "streams": {}}
    for scheme in settings.streams:
        values = [value for each in rounds["with"] for value in each.latencies_ms[scheme]]
        p50, p95 = np.quantile(values, [0.5, 0.95]).tolist() if values else (float("nan"), float("nan"))
        cost_ms = send_ms(scheme, last, rig)
        numbers["streams"][scheme] = {"p50_ms": p50, "p95_ms": p95, "cpu_ms": cost_ms, "sets": len(values)}
        console.print(
            f"{scheme}: {cost_ms:.2f} ms of CPU a sample, {cost_ms / cpu_ms['without']:.1%} of a set; last exposure to "
            f"arrival p50 {p50:.1f}, p95 {p95:.1f} ms ({len(values)} sets)"
        )
    if settings.json is not None:
        write_json(settings.json, plain_json(numbers))


if __name__ == "__main__":
    main(tyro.cli(StreamCost, description=__doc__))
