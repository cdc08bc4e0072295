"""``depthmocap demo``: the whole pipeline on the packaged recording."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.exporting.run_result import RunResult
from depthmocap.offline.run import RunSettings, run
from depthmocap.recordings.open_recording import packaged_recording


@dataclasses.dataclass(frozen=True)
class DemoSettings:
    """Motion capture of the packaged recording: one person, three cameras, a generated scene.

    Attributes:
        out: folder for pose.bvh, pose.csv, pose.trc, summary.json, report.html and preview.webp.
    """

    out: Path = Path("out/demo")


def demo(settings: DemoSettings) -> RunResult:
    """Run the demo and tell where things are."""
    console = Terminal()
    result = run(RunSettings(packaged_recording(), settings.out), console)
    summary = result.summary
    assert summary["error"] is not None, "the packaged recording has true joints"
    table = Table(title="depthmocap demo", show_header=False)
    table.add_row("frames", f"{summary['frames']} sets of {len(summary['frames_by_camera'])} cameras")
    table.add_row("speed", f"{summary['frames_per_second']:.1f} sets a second")
    table.add_row("gaps", str(summary["gaps"]))
    table.add_row("mean joint error", f"{summary['error']['mean_joint_error_cm']:.2f} cm against the true joints")
    table.add_row("within 10 cm", f"{summary['error']['within_10cm']:.1%}")
    console.print(table)
    console.print(f"Look at {settings.out / 'report.html'}; the skeleton is in pose.bvh, .csv and .trc.")
    return result
