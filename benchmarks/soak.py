"""A soak test: four simulated cameras in real time through the whole pipeline, with recording. It measures rate,
latency, losses and the growth of memory.

    python benchmarks/soak.py --minutes 30 --json soak.json              # with all faults of cameras
    python benchmarks/soak.py --minutes 10 --no-faults --json live.json  # perfect cameras: rate, latency, losses

The cameras are Kinects of 512×424 around a moving person in a furnished room, generated (extra ``train``) and played
forwards and backwards; or those of a recording.
"""

from __future__ import annotations

import collections
import ctypes
import dataclasses
import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from camera_simulator import Faults, RecordedScene, SimulatedCamera, Simulation
from rich.console import Console
from rich.table import Table

from depthmocap.cameras.source import DepthFrame
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.offline.pipeline import Pipeline, warm_up
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.realtime.live_capture import BackgroundSource, LiveCapture
from depthmocap.realtime.mcap_recorder import McapRecorder
from depthmocap.realtime.sync import SyncSettings
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mcap_writer import McapWriter
from depthmocap.recordings.open_recording import open_recording

#: Time after which memory counts, seconds; half of a shorter run. Before, each new kind of fault allocates buffers.
WARM_UP_S = 900.0
#: Time between two measurements of memory, seconds.
MEMORY_EVERY_S = 5.0
#: Frames per file of the recording; older files are deleted, because 30 minutes would need 40 GB.
FRAMES_PER_FILE = 8_000
#: Goal of the rate of frame sets, as a share of the cameras' rate.
SHARE_GOAL = 0.995
#: Goal of the latency's 95th percentile, milliseconds.
P95_GOAL_MS = 80.0
#: Goal of the compression: raw bytes by bytes of the file.
RATIO_GOAL = 2.5
#: Goal of the growth of memory, MB per minute.
GROWTH_GOAL_MB_MIN = 0.1
KINDS = ("frozen", "garbage", "dark", "stuck", "unplugged", "jumps")


@dataclasses.dataclass(frozen=True)
class SoakSettings:
    """A long run.

    Attributes:
        recording: the cameras' scene; by default it is generated.
        scene_seconds: length of the generated scene, which is held in memory.
        rate_hz: frame rate of the cameras.
        faults: simulate faults of the cameras.
        record: also record, to a folder that is deleted at the end.
        stream: addresses to which every result is sent, as by ``live --stream``; may be given several times.
        folder: where that folder is made; by default the system's folder for temporary files.
        json: file for all numbers.
    """

    minutes: float = 30.0
    recording: Path | None = None
    scene_seconds: float = 3.0
    rate_hz: float = 30.0
    faults: bool = True
    record: bool = True
    stream: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    folder: Path | None = None
    json: Path | None = None


def camera_faults(index: int, seconds: float) -> Faults:
    """Faults of a camera: constant loss, delay, jitter, reordering and drift; and one of ``KINDS`` in turns for some
    seconds of each minute, more often in a short run, so that each occurs at least once."""
    every_s = min(60.0, seconds / (len(KINDS) + 1))
    stretches: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    for turn in range(int(seconds / every_s)):
        begin_s = every_s * (turn + 0.25 + 0.1 * index)
        lasts_s = min(4.0, every_s / 3)
        kind = KINDS[(turn + index) % len(KINDS)]
        back = len(stretches["jumps"]) % 2
        stretches[kind].append((begin_s, -3.0 if back else 3.0) if kind == "jumps" else (begin_s, begin_s + lasts_s))
    return Faults(
        1000.0 * (index + 1), (200.0, -200.0, 50.0, 0.0)[index % 4], delay_ms=5.0 + 3 * (index % 4), jitter_ms=5.0,
        loss=0.02, duplicate=0.01, reorder=0.01, frozen=tuple(stretches["frozen"]), dark=tuple(stretches["dark"]),
        garbage=tuple(stretches["garbage"]), stuck=tuple(stretches["stuck"]), jumps=tuple(stretches["jumps"]),
        unplugged=tuple(stretches["unplugged"]),
    )  # fmt: skip


class RollingRecorder:
    """Records all frames, in files of which the last two are kept.

    Attributes:
        offered: number of frames passed to the recorder, by camera.
        written: number of frames written, by camera.
        raw_bytes: size of the frames in closed files, uncompressed.
        file_bytes: size of the closed files.
    """

    def __init__(self, folder: Path, rig: Rig) -> None:
        self.offered, self.written = collections.Counter[str](), collections.Counter[str]()
        self.raw_bytes = self.file_bytes = 0
        self._folder, self._rig, self._lock = folder, rig, threading.Lock()
        self._cameras: dict[str, DepthCamera] = {camera.name: camera for camera in rig.cameras}
        #: The last one is in use. Threads may still write to the one before it, but not to earlier ones.
        self._files: list[tuple[McapWriter, McapRecorder]] = []
        self._made = 0
        self._begin()

    def write(self, frame: DepthFrame) -> None:
        """Add a frame, from any thread."""
        with self._lock:
            self.offered[frame.camera] += 1
            if self.offered.total() > FRAMES_PER_FILE * self._made:
                self._begin()
            recorder = self._files[-1][1]
        recorder.write(frame)

    def close(self) -> McapRecording:
        """Finish; returns the last recording."""
        while len(self._files) > 1:
            self._finish()
        last = self._files[0][0]
        self._finish(delete=False)
        return McapRecording(last.path)

    def _begin(self) -> None:
        self._made += 1
        writer = McapWriter(self._folder / f"{self._made}.mcap", self._rig)
        self._files.append((writer, McapRecorder(writer, self._cameras.get)))
        if len(self._files) > 2:
            self._finish()

    def _finish(self, delete: bool = True) -> None:
        writer, _ = self._files.pop(0)
        writer.close()
        self.written.update(writer.frames)
        self.raw_bytes += sum(2 * c.width * c.height * writer.frames[c.name] for c in self._rig.cameras)
        self.file_bytes += writer.path.stat().st_size
        if delete:
            writer.path.unlink()


def _memory_mb() -> float:
    """Resident memory (MB) where the system gives it; otherwise the peak so far."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmRSS"))
        return int(line.split()[1]) / 1024
    if sys.platform == "win32":
        return _windows_memory_mb()
    import resource

    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / 2**20 if sys.platform == "darwin" else most / 1024


class _MemoryCounters(ctypes.Structure):
    """PROCESS_MEMORY_COUNTERS of Windows, of which only the resident size is read."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("faults", ctypes.c_uint32),
        ("most", ctypes.c_size_t),
        ("resident", ctypes.c_size_t),
        ("others", ctypes.c_size_t * 6),
    )


def _windows_memory_mb() -> float:
    counters = _MemoryCounters(ctypes.sizeof(_MemoryCounters))
    kernel = getattr(ctypes, "windll").kernel32  # noqa: B009 - there on Windows alone
    kernel.GetCurrentProcess.restype = ctypes.c_void_p
    kernel.K32GetProcessMemoryInfo.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32)
    kernel.K32GetProcessMemoryInfo(kernel.GetCurrentProcess(), ctypes.byref(counters), counters.size)
    return counters.resident / 2**20


def prepare(settings: SoakSettings) -> tuple[RecordedScene, Pipeline]:
    """The cameras' scene, and the pipeline after a warm-up. The empty scene is known."""
    if settings.recording is not None:
        source = open_recording(settings.recording)
        rig = Rig(tuple(camera for camera in source.rig.cameras if source.stamps(camera.name)), source.up)
        pipeline = warm_up(load_pipeline(source), source[0])
        return RecordedScene(source, rig, 1e9 / source.period_ns), pipeline
    from studio import Studio  # needs the extra train

    studio = Studio(settings.scene_seconds, settings.rate_hz)
    sets = list(studio)
    pipeline = warm_up(load_pipeline(BackgroundSource(studio.rig, studio.backgrounds_m)), sets[0])
    return RecordedScene(sets, studio.rig, settings.rate_hz), pipeline


def soak(settings: SoakSettings, folder: Path, console: Console) -> dict[str, Any]:
    """Run and return the numbers; recordings go to ``folder``."""
    with console.status("making what the cameras see"):
        scene, pipeline = prepare(settings)
    rig, seconds = scene.rig, settings.minutes * 60
    faults = {name: camera_faults(i, seconds) for i, name in enumerate(rig.names)} if settings.faults else {}
    simulation = Simulation(scene, settings.rate_hz, seconds, faults)
    sent = {name: sum(1 for _ in simulation.camera_events(name)) for name in rig.names}
    recorder = RollingRecorder(folder, rig) if settings.record else None
    zero_ns = time.monotonic_ns() + 500_000_000
    cameras = [SimulatedCamera(simulation, name, zero_ns) for name in rig.names]
    memory: list[tuple[float, float]] = []
    capture = LiveCapture(
        cameras, rig, pipeline, SyncSettings(settings.rate_hz), measure_rate=False, streams=settings.stream
    )
    capture.reader.recorder = recorder
    with console.status(f"running for {settings.minutes:g} minutes"), capture:
        begun, cpu = time.monotonic(), time.process_time()
        for _ in capture:
            elapsed = time.monotonic() - begun
            if not memory or elapsed - memory[-1][0] >= MEMORY_EVERY_S:
                memory.append((elapsed, _memory_mb()))
        elapsed, cpu = time.monotonic() - begun, time.process_time() - cpu
        statuses = capture.statuses()
    numbers: dict[str, Any] = {
        "settings": {**dataclasses.asdict(settings), "recording": settings.recording and str(settings.recording)},
        "seconds": elapsed,
        "cpu_cores": cpu / elapsed,
        "sets_per_second": capture.statistics.poses / elapsed,
        "sets_dropped": capture.dropped,
        "sets_labelled_in_part": capture.labelled_in_part,
        "frames_overrun": capture.reader.overrun,
        **capture.statistics.summary(),
        "memory": _growth(memory),
        "frames_sent": sent,
        "cameras": {status.name: dataclasses.asdict(status) for status in statuses},
        "problems": dict(capture.problems),
        "faults": {name: dataclasses.asdict(fault) for name, fault in faults.items()},
    }
    numbers["settings"] |= {key: str(value) for key, value in numbers["settings"].items() if isinstance(value, Path)}
    if recorder is not None:
        numbers["recording"] = _recorded(recorder)
    return numbers


def _recorded(recorder: RollingRecorder) -> dict[str, Any]:
    last = recorder.close()
    return {
        "offered": dict(recorder.offered),
        "written": dict(recorder.written),
        "lost": recorder.offered.total() - recorder.written.total(),
        "ratio": recorder.raw_bytes / recorder.file_bytes,
        "last_file_complete": last.complete and not last.problems,
    }


def _growth(memory: list[tuple[float, float]]) -> dict[str, Any]:
    """Resident memory after the warm-up, and the slope of a line through it."""
    warm_s = min(WARM_UP_S, memory[-1][0] / 2)
    at_s, mb = np.array([look for look in memory if look[0] >= warm_s]).T
    slope = np.polyfit(at_s / 60, mb, 1)[0] if len(at_s) > 2 else float("nan")
    return {
        "mb_after_warm_up": float(mb[0]), "mb_at_the_end": float(mb[-1]), "mb_most": float(mb.max()),
        "mb_a_minute": float(slope), "mb": [[round(s, 1), round(m, 1)] for s, m in memory],
    }  # fmt: skip


def tables(numbers: dict[str, Any]) -> list[Table]:
    """The run, and each camera."""
    run = Table(title=f"{numbers['seconds']:.0f} s, {numbers['cpu_cores']:.2f} cores", title_justify="left")
    for column in ("what", "measured", "goal"):
        run.add_column(column, justify="left" if column == "what" else "right")

    def row(what: str, measured: str, goal: str = "", met: bool = True) -> None:
        run.add_row(what, measured, goal and f"[{'green' if met else 'red'}]{goal} {'met' if met else 'missed'}")

    rate, memory = numbers["settings"]["rate_hz"], numbers["memory"]
    latency, skew = numbers["latency_ms"], numbers["skew_ms"]
    per_second, growth = numbers["sets_per_second"], memory["mb_a_minute"]
    row("sets a second", f"{per_second:.2f}", f"≥ {SHARE_GOAL * rate:.2f}", per_second >= SHARE_GOAL * rate)
    row("sets dropped; frames overrun", f"{numbers['sets_dropped']}; {numbers['frames_overrun']}")
    row("latency from the last frame's arrival, p50", f"{latency['p50']:.1f} ms")
    row("… p95", f"{latency['p95']:.1f} ms", f"≤ {P95_GOAL_MS:g}", latency["p95"] <= P95_GOAL_MS)
    row("skew of a set, p50; p95", f"{skew['p50']:.1f}; {skew['p95']:.1f} ms")
    row("sets with somebody", f"{1 - numbers['gaps'] / max(numbers['frames'], 1):.1%}")
    row("memory after the warm-up; at the end", f"{memory['mb_after_warm_up']:.0f}; {memory['mb_at_the_end']:.0f} MB")
    row("… growth", f"{growth:+.2f} MB a minute", f"≤ {GROWTH_GOAL_MB_MIN:g}", growth <= GROWTH_GOAL_MB_MIN)
    if recording := numbers.get("recording"):
        row("frames not recorded", str(recording["lost"]), "0", recording["lost"] == 0)
        row("compression", f"{recording['ratio']:.2f}:1", f"≥ {RATIO_GOAL:g}", recording["ratio"] >= RATIO_GOAL)
        row("last file whole", "yes" if recording["last_file_complete"] else "NO")
    cameras = Table(title="frames by camera", title_justify="left")
    columns = ("sent", "read", "used", "missing", "late", "duplicates", "reordered", "unsure")
    fault_names = ("frozen", "noise", "dark", "clock", "size")
    other_columns = ("outages", "clock jumps", "opened in vain", "drift ppm")
    for column in ("camera", *columns, *fault_names, *other_columns):
        cameras.add_column(column, justify="left" if column == "camera" else "right")
    for name, status in numbers["cameras"].items():
        counts = status["counts"]
        fault_counts = [counts.get(fault_name, 0) for fault_name in fault_names]
        counts |= {"sent": numbers["frames_sent"][name], "read": counts["frames"] + sum(fault_counts)}
        cameras.add_row(
            name, *(str(counts[column]) for column in columns), *map(str, fault_counts), str(counts.get("outages", 0)),
            str(status["clock_restarts"]), str(status["opened_in_vain"]), f"{status['drift_ppm']:.1f}",
        )  # fmt: skip
    return [run, cameras]


def main(settings: SoakSettings) -> None:
    """Run, print and write."""
    console = Console()
    if not console.is_terminal:  # a file or a log has no width of its own
        console = Console(width=170)
    with tempfile.TemporaryDirectory(dir=settings.folder) as folder:
        numbers = soak(settings, Path(folder), console)
    for table in tables(numbers):
        console.print(table)
    for problem, times in numbers["problems"].items():
        console.print(f"• {problem}{f' ({times} times)' if times > 1 else ''}", markup=False, highlight=False)
    if settings.json is not None:
        settings.json.parent.mkdir(parents=True, exist_ok=True)
        settings.json.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(SoakSettings))
