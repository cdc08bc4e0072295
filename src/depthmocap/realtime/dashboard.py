"""The dashboard of a running motion capture in the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from depthmocap.realtime.status import CameraStatus, RunStatistics
from depthmocap.text import harmless


def _number(value: float, digits: int = 1) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def draw_dashboard(
    cameras: Sequence[CameraStatus], statistics: RunStatistics, dropped: int, seconds: float, problems: Sequence[str]
) -> Group:
    """Cameras, stages and the latest problems as one renderable."""
    table = Table(title=f"{seconds:.0f} s, {statistics.poses} poses, {dropped} sets dropped", title_justify="left")
    for column in ("camera", "frames/s", "frames", "missing", "late", "left out", "drift ppm", "clock jumps", "state"):
        table.add_column(column, justify="left" if column in ("camera", "state") else "right")
    for camera in cameras:
        counts = camera.counts
        other = sum(counts.values()) - sum(
            counts.get(key, 0) for key in ("frames", "used", "missing", "late", "outages")
        )
        table.add_row(
            camera.name, _number(camera.rate_hz), str(counts["frames"]), str(camera.lost), str(counts["late"]),
            str(other), _number(camera.drift_ppm), str(camera.clock_restarts),
            Text(harmless(camera.state), "green" if camera.state == "running" else "red"),
        )  # fmt: skip
    stages = Table()
    stages.add_column("ms")
    meters = {**statistics.stages, "latency": statistics.latency, "skew": statistics.skew}
    for name in meters:
        stages.add_column(name, justify="right")
    recent = [meter.recent() for meter in meters.values()]
    stages.add_row("p50", *(_number(p50) for p50, _ in recent))
    stages.add_row("p95", *(_number(p95) for _, p95 in recent))
    here = ", ".join(map(str, statistics.present)) or "nobody"
    count = len(statistics.people)
    people = Text(f"in view: {here}; so far {count} {'person' if count == 1 else 'people'}")
    return Group(table, stages, people, *(Text(harmless(f"• {problem}"), "yellow") for problem in list(problems)[-4:]))
