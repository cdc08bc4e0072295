"""Simulated cameras with everything that goes wrong, in real time through the whole pipeline: does it last?

    python benchmarks/soak.py --minutes 30 --out soak.json

It prints poses a second, latency, dropped sets, and the memory at the end against that after the warm-up. The cameras
and what they see are a recording's, the packaged one's by default, played forwards and backwards.
"""

from __future__ import annotations

import dataclasses
import importlib.resources
import json
import resource
import time
from pathlib import Path

import tyro

from depthmocap.capture.open import open_recording
from depthmocap.capture.simulator import Faults, RecordedScene, SimulatedCamera, Simulation
from depthmocap.capture.sync import SyncSettings
from depthmocap.geometry import Rig
from depthmocap.offline import load_pipeline
from depthmocap.online.live import LiveCapture, warm

WARM_UP_S = 60.0


@dataclasses.dataclass(frozen=True)
class SoakSettings:
    """A long run with faults.

    Attributes:
        recording: what the cameras see; the packaged recording by default.
        out: file for the numbers.
        rate_hz: of the cameras.
        faults: without, the cameras are perfect.
    """

    minutes: float = 30.0
    recording: Path | None = None
    out: Path | None = None
    rate_hz: float = 30.0
    faults: bool = True


def faults_of(index: int, seconds: float) -> Faults:
    """A camera's own troubles, one a minute, at times that differ between cameras."""
    starts = [60.0 * i + 12.0 * index + 8.0 for i in range(int(seconds / 60) + 1)]
    kinds = [[(at, at + 4.0) for at in starts[k::5]] for k in range(5)]
    frozen, garbage, dark, stuck, unplugged = (tuple(kind) for kind in kinds)
    return Faults(
        offset_s=1000.0 * index, drift_ppm=(200.0, -200.0, 50.0, 0.0)[index % 4], delay_ms=5.0, jitter_ms=5.0,
        jumps=tuple((at + 30.0, 3.0) for at in starts[::7]), loss=0.02, duplicate=0.01, reorder=0.01,
        frozen=frozen, garbage=garbage, dark=dark, stuck=stuck, unplugged=unplugged,
    )  # fmt: skip


def _memory_mb() -> float:
    """Resident now, where the system tells; otherwise the most so far."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmRSS"))
        return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def soak(settings: SoakSettings) -> dict[str, object]:
    """Run and return the numbers."""
    path = settings.recording or Path(str(importlib.resources.files("depthmocap") / "demo_recording"))
    recording, seconds = open_recording(path), settings.minutes * 60
    rig = Rig(tuple(camera for camera in recording.rig.cameras if recording.stamps(camera.name)), recording.up)
    scene = RecordedScene(recording, rig, 1e9 / recording.period_ns)
    pipeline = warm(load_pipeline(recording), recording[0])
    faults = {name: faults_of(i, seconds) for i, name in enumerate(rig.names)} if settings.faults else {}
    simulation = Simulation(scene, settings.rate_hz, seconds, faults)
    zero_ns = time.monotonic_ns() + 500_000_000
    cameras = [SimulatedCamera(simulation, name, zero_ns) for name in rig.names]
    memory: list[tuple[float, float]] = []
    begun = time.monotonic()
    with LiveCapture(cameras, rig, pipeline, SyncSettings(settings.rate_hz), measure_rate=False) as capture:
        for _ in capture:
            elapsed = time.monotonic() - begun
            if not memory or elapsed - memory[-1][0] >= 10:
                memory.append((elapsed, _memory_mb()))
        statuses = capture.statuses()
    elapsed = time.monotonic() - begun
    after = [mb for at, mb in memory if at >= min(WARM_UP_S, elapsed / 2)]
    return {
        "seconds": elapsed,
        "poses_per_second": capture.books.poses / elapsed,
        "sets_dropped": capture.dropped,
        **capture.books.summary(),
        "memory_mb_after_warm_up": after[0] if after else None,
        "memory_mb_at_the_end": after[-1] if after else None,
        "cameras": {status.name: dataclasses.asdict(status) for status in statuses},
        "problems": list(capture.problems),
    }


if __name__ == "__main__":
    chosen = tyro.cli(SoakSettings)
    numbers = soak(chosen)
    text = json.dumps(numbers, indent=1)
    if chosen.out is not None:
        chosen.out.write_text(text + "\n")
    print(text)
