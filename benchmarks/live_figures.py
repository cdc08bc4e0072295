"""What ``depthmocap live`` does with four Kinects, a viewer that looks on and streams: the command itself, for minutes.

    python benchmarks/live_figures.py --minutes 10 --json live.json
    python benchmarks/live_figures.py --minutes 10 --people 2 --json two.json
    python benchmarks/live_figures.py --minutes 10 --live-cores 0 --other-cores 1 --json core.json   # one core alone

Four cameras of 512×424 around one or two moving people in a furnished room are generated (extra ``train``) and played
forwards and backwards by a process of their own, which hands frames over in shared memory as a driver does. A client of
the page and a receiver of each stream are processes, too: they read every message and draw nothing. Each process's CPU
time is told apart, as is the memory of ``live`` (what is resident, less the cameras' shared memory). Needs Linux.

The exposure of every frame is known, so that the time from the last exposure of a set to the arrival of its packet is
measured, and the cameras' own transport taken off. The start is from the command to the first packet with a joint.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from shared_cameras import CameraHost, Sent
from stream_receivers import Arrivals, Scheme, receivers

from depthmocap.core.output import plain_json, write_json
from depthmocap.core.reading.json_text import read_json
from depthmocap.core.settings import plain_settings
from depthmocap.errors import InputError
from depthmocap.geometry import load_rig

#: Time between two looks at memory and CPU time, seconds.
LOOK_S = 5.0
#: From the first packet on: what is measured only afterwards, seconds; and the part of a run over which growth counts.
SETTLED_S, GROWTH_PART = 5.0, 0.5
#: Where shared memory is.
_SHARED = Path("/dev/shm")
#: The goals: sets a second by people and cores, the latency's 95th percentile, memory and start.
SETS_GOAL, TWO_PEOPLE_GOAL, ONE_CORE_GOAL = 29.5, 24.0, 20.0
LATENCY_GOAL_MS, MEMORY_GOAL_MB, START_GOAL_S = 45.0, 500.0, 3.0


@dataclasses.dataclass(frozen=True)
class LiveFigures:
    """Settings.

    Attributes:
        minutes: how long, from the first pose on.
        people: one or two, who are there and are followed.
        streams: that run at the same time.
        view: with the page and a client of it.
        record: all frames.
        live_cores: the cores that ``live`` may use; by default all.
        other_cores: the cores that everything else may use.
        keep_gb: what of the recording is kept on the disk at a time: its older part is given back, since 30 minutes
            have 40 GB.
        scene_seconds: of the generated scene.
        free_running: the cameras expose a quarter of a period after one another, and not together.
        folder: for the recording and the results; they are deleted at the end.
        json: also write all numbers to this file.
    """

    minutes: float = 10.0
    people: int = 1
    streams: tuple[Scheme, ...] = ("osc", "ws")
    view: bool = True
    record: bool = True
    live_cores: tuple[int, ...] = ()
    other_cores: tuple[int, ...] = ()
    keep_gb: float = 1.0
    scene_seconds: float = 6.0
    free_running: bool = False
    folder: Path | None = None
    json: Path | None = None

    def __post_init__(self) -> None:
        if self.people not in (1, 2):
            raise InputError(f"--people must be 1 or 2, got {self.people}")


@contextlib.contextmanager
def _on_cores(cores: Sequence[int]) -> Iterator[None]:
    """Processes that are started within may use these cores, or all if there are none."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores or allowed)
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def _memory_mb(pid: int) -> float:
    """Resident memory, less what is shared memory: the cameras' rings."""
    kilobytes = {"RssAnon": 0, "RssFile": 0}
    for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
        name, _, value = line.partition(":")
        if name in kilobytes:
            kilobytes[name] = int(value.split()[0])
    return sum(kilobytes.values()) / 1024


def _cpu_s(pid: int) -> float:
    """CPU time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _give_back(path: Path, keep_bytes: float) -> None:
    """Free the disk of the older part of a file that is being written; what its size is stays."""
    if path.exists() and (old := int(path.stat().st_size - keep_bytes)) > 0:
        subprocess.run(["fallocate", "--punch-hole", "--offset", "0", "--length", str(old), str(path)], check=False)


def _words(settings: LiveFigures, shared: Path, folder: Path, ports: Sequence[int]) -> list[str]:
    """The arguments of ``live``."""
    cameras = [f"{name}=simulated:{shared / name}" for name in load_rig(shared / "rig.json").names]
    words = [*cameras, "--rig", str(shared / "rig.json"), "--out", str(folder / "out"), "--people"]
    words += [str(settings.people), "--seconds", str(60 * settings.minutes)]
    if settings.record:
        words += ["--record", str(folder / "take.mcap")]
    for scheme, port in zip(settings.streams, ports, strict=False):
        words += ["--stream", f"{scheme}://127.0.0.1:{port}"]
    if settings.view:
        words += ["--view", "--no-open", "--port", str(ports[-1])]
    return words


def run(settings: LiveFigures, shared: Path, folder: Path, console: Console) -> dict[str, Any]:
    """Run and give the numbers."""
    phases = (0.0, 0.25, 0.5, 0.75) if settings.free_running else (0.0,) * 4
    host = CameraHost(shared, settings.people, scene_seconds=settings.scene_seconds, phases=phases)
    kinds: tuple[Scheme | Literal["page"], ...] = (*settings.streams, "page") if settings.view else settings.streams
    with contextlib.ExitStack() as stack:
        with _on_cores(settings.other_cores):
            with console.status("making what the cameras see"):
                cameras, pipe = host.start()
                zero_ns: int = pipe.recv()
            ports, told = stack.enter_context(receivers(kinds))
        words = _words(settings, shared, folder, ports)
        command = [sys.executable, str(Path(__file__).with_name("shared_cameras.py")), str(folder / "counts.json")]
        with _on_cores(settings.live_cores), (folder / "told").open("w+", encoding="utf-8") as output:
            begun_ns = time.monotonic_ns()
            live = subprocess.Popen([*command, "live", *words], stdout=output, stderr=output)
            assert live.pid and cameras.pid
            looks = _watch(live, cameras.pid, folder / "take.mcap", settings, console)
            output.seek(0)
            lines = output.read().splitlines()
    if live.returncode:
        raise InputError(f"live has failed: {' '.join(lines[-1:])}")
    pipe.send(None)
    sent: Sent = pipe.recv()
    summary, counts = read_json(folder / "out" / "summary.json"), read_json(folder / "counts.json")
    streams = {
        scheme: _stream_numbers(told[scheme], host, zero_ns, begun_ns, settings.people) for scheme in settings.streams
    }
    numbers = {
        "settings": plain_settings(settings),
        "machine": {"cores": len(os.sched_getaffinity(0))},
        "sets_per_second": summary["frames_per_second"],
        "sets": summary["frames"],
        "sets_dropped": summary["sets_dropped"],
        "sets_labelled_in_part": summary["sets_labelled_in_part"],
        "sets_before_ready": summary["sets_before_ready"],
        "sets_with_people": summary["frames_by_person"],
        "latency_ms": summary["latency_ms"],
        "ms_per_stage": summary["ms_per_stage"],
        "streams": streams,
        "start_s": min((each["start_s"] for each in streams.values()), default=None),
        "page": dict(zip(("messages", "bytes"), told["page"], strict=True)) if settings.view else None,
        "frames": {"sent": sent.frames, **counts},
        "frames_unrecorded": _unrecorded(counts) if settings.record else None,
        **_looked(looks),
        "problems": summary["problems"],
        "told": lines,
    }
    return plain_json(numbers)


def _unrecorded(counts: dict[str, dict[str, int]]) -> int:
    """Frames that were lost on the way, and that were to be recorded and were not."""
    offered, written = counts["offered"], counts["written"]
    return sum(counts["lost"].values()) + sum(offered[name] - written.get(name, 0) for name in offered)


def _watch(
    live: subprocess.Popen[bytes], cameras: int, recording: Path, settings: LiveFigures, console: Console
) -> list[tuple[float, float, float, float]]:
    """Until it ends: seconds, memory (MB), and the CPU time of ``live`` and of the cameras (seconds)."""
    begun_s, looks = time.monotonic(), []
    with console.status(f"running for {settings.minutes:g} minutes"):
        while live.poll() is None:
            with contextlib.suppress(OSError, IndexError):  # it ended just now
                looks.append((time.monotonic() - begun_s, _memory_mb(live.pid), _cpu_s(live.pid), _cpu_s(cameras)))
            _give_back(recording, settings.keep_gb * 1e9)
            with contextlib.suppress(subprocess.TimeoutExpired):
                live.wait(LOOK_S)
    return looks


def _looked(looks: Sequence[tuple[float, float, float, float]]) -> dict[str, Any]:
    """Memory and its growth over the later part of the run, and the cores that were used."""
    at_s, mb, live_s, cameras_s = np.array([look for look in looks if look[1]]).T
    late = at_s >= at_s[-1] * GROWTH_PART
    slope = np.polyfit(at_s[late] / 60, mb[late], 1)[0] if late.sum() > 2 else float("nan")
    # From when it runs: the start is heavier.
    settled = at_s >= min(SETTLED_S + START_GOAL_S, at_s[-1] / 2)
    spent = [cpu[settled][-1] - cpu[settled][0] for cpu in (live_s, cameras_s)]
    seconds = max(at_s[settled][-1] - at_s[settled][0], 1e-9)
    return {
        "memory": {
            "mb_most": mb.max(), "mb_at_the_end": mb[-1], "mb_a_minute": slope,
            "mb": [[round(s, 1), round(m, 1)] for s, m in zip(at_s, mb, strict=True)],
        },
        "cores": {"live": spent[0] / seconds, "cameras": spent[1] / seconds},
    }  # fmt: skip


def _stream_numbers(arrivals: Arrivals, host: CameraHost, zero_ns: int, begun_ns: int, people: int) -> dict[str, Any]:
    """Of the packets of a stream: the start, how many come a second, and milliseconds from the last exposure."""
    first_ns = [arrival.ns for arrival in arrivals.values() if arrival.people]
    if not first_ns:
        raise InputError("no packet with a joint came")
    start_s = (first_ns[0] - begun_ns) * 1e-9
    settled_ns = first_ns[0] + round(SETTLED_S * 1e9)
    period_ns, phases_ns = 1e9 / host.rate_hz, np.array(host.phases) * 1e9 / host.rate_hz
    unix_minus_monotonic_ns = time.time_ns() - time.monotonic_ns()
    milliseconds, everybody = [], 0
    settled = {key: arrival for key, arrival in arrivals.items() if arrival.ns >= settled_ns}
    for key, arrival in settled.items():
        # What is told is the set's instant by the host's clock, which has the least delay in it.
        instant_ns = key * 1e6 - unix_minus_monotonic_ns - zero_ns - host.delay_ms * 1e6
        exposed_ns = np.round((instant_ns - phases_ns) / period_ns) * period_ns + phases_ns
        milliseconds.append((arrival.ns - zero_ns - exposed_ns.max()) * 1e-6)
        everybody += arrival.people >= people
    if not milliseconds:
        raise InputError("the run was too short: no packet came after it had settled")
    p50, p95, p99 = np.quantile(milliseconds, [0.5, 0.95, 0.99])
    transport_ms = host.delay_ms + host.jitter_ms  # on average
    seconds = (max(arrival.ns for arrival in settled.values()) - settled_ns) * 1e-9
    return {
        "start_s": start_s, "packets": len(settled), "packets_per_second": len(settled) / max(seconds, 1e-9),
        "everybody_share": everybody / len(settled), "exposure_to_arrival_ms": {"p50": p50, "p95": p95, "p99": p99},
        "transport_ms": transport_ms, "p50_ms": p50 - transport_ms, "p95_ms": p95 - transport_ms,
    }  # fmt: skip


def table(numbers: dict[str, Any]) -> Table:
    """The numbers beside the goals."""
    settings, shown = numbers["settings"], Table(title_justify="left")
    for column in ("what", "measured", "goal"):
        shown.add_column(column, justify="left" if column == "what" else "right")

    def row(what: str, measured: str, goal: str = "", met: bool = True) -> None:
        shown.add_row(what, measured, goal and f"[{'green' if met else 'red'}]{goal} {'met' if met else 'missed'}")

    rate, memory = numbers["sets_per_second"], numbers["memory"]
    one_core = len(settings["live_cores"]) == 1
    goal = ONE_CORE_GOAL if one_core else TWO_PEOPLE_GOAL if settings["people"] == 2 else SETS_GOAL
    row("sets a second", f"{rate:.2f}", f"≥ {goal:g}", rate >= goal)
    row("sets left out; before it was ready", f"{numbers['sets_dropped']}; {numbers['sets_before_ready']}")
    row("sets labelled in some views only", str(numbers["sets_labelled_in_part"]))
    if (lost := numbers["frames_unrecorded"]) is not None:
        row("frames not recorded", f"{lost} of {sum(numbers['frames']['offered'].values())}", "0", lost == 0)
    for scheme, stream in numbers["streams"].items():
        late = stream["p95_ms"]
        row(
            f"{scheme}: last exposure to packet, without transport, p50; p95",
            f"{stream['p50_ms']:.1f}; {late:.1f} ms", f"≤ {LATENCY_GOAL_MS:g}", late <= LATENCY_GOAL_MS,
        )  # fmt: skip
        row(f"{scheme}: packets a second; with everybody",
            f"{stream['packets_per_second']:.2f}; {stream['everybody_share']:.1%}")  # fmt: skip
    most, growth = memory["mb_most"], memory["mb_a_minute"]
    row("memory, most", f"{most:.0f} MB", f"≤ {MEMORY_GOAL_MB:g}", most <= MEMORY_GOAL_MB)
    a_minute = "–" if growth is None else f"{growth:+.2f} MB a minute"
    row("… at the end; growth over the later half", f"{memory['mb_at_the_end']:.0f} MB; {a_minute}")
    if (start := numbers["start_s"]) is not None:
        row("start", f"{start:.2f} s", f"≤ {START_GOAL_S:g}", start <= START_GOAL_S)
    row("cores: live; cameras", f"{numbers['cores']['live']:.2f}; {numbers['cores']['cameras']:.2f}")
    if numbers["page"]:
        row("page: messages; MB", f"{numbers['page']['messages']}; {numbers['page']['bytes'] / 1e6:.0f}")
    return shown


def main(settings: LiveFigures) -> None:
    """Run, print and write."""
    console = Console()
    with (
        tempfile.TemporaryDirectory(dir=_SHARED) as shared,
        tempfile.TemporaryDirectory(dir=settings.folder) as folder,
    ):
        numbers = run(settings, Path(shared), Path(folder), console)
    console.print(table(numbers))
    for problem in numbers["problems"]:
        console.print(f"• {problem['text']} ({problem['times']} times)", markup=False, highlight=False)
    if settings.json is not None:
        write_json(settings.json, numbers)


if __name__ == "__main__":
    main(tyro.cli(LiveFigures, description=__doc__))
