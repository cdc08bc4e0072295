"""The page of a calibration: point clouds before and after, and the numbers of every pair."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy import ndarray

from depthmocap.calibration.verdict import FAIR, GOOD, PairVerdict
from depthmocap.report.charts import COLOURS, INK, SOFT, as_png, label_of
from depthmocap.report.page import Cell, ReportFigure, ReportSection, ReportTable, write_report

_DPI = 200
#: Points of a camera in a picture.
_POINTS = 5000
#: Percentiles of the points that the axes cover.
_PERCENTILES = (0.5, 99.5)


def pair_table(pairs: Sequence[PairVerdict]) -> ReportTable:
    """The table of all pairs."""
    rows: list[list[Cell]] = [
        [
            " – ".join(pair.cameras), pair.grade, pair.uncertainty_mm, pair.uncertainty_deg, pair.shared_poses,
            pair.agreed_poses, pair.joints_apart_mm, pair.turned_deg, pair.surface_points, pair.surfaces_apart_mm,
        ]
        for pair in pairs
    ]  # fmt: skip
    header = (
        "cameras", "verdict", "± mm", "± degrees", "shared poses", "agree", "joints apart mm", "turned degrees",
        "surface points", "apart mm",
    )  # fmt: skip
    return ReportTable(header, rows)


def write_page(
    path: Path,
    headline: str,
    notes: Sequence[str],
    pairs: Sequence[PairVerdict],
    pictures: tuple[bytes, bytes],
) -> None:
    """Write the page; ``pictures`` are the clouds before and after."""
    good, fair = (f"{1e3 * metres:.0f} mm and {degrees:g}°" for metres, degrees in (GOOD, FAIR))
    explained = (
        "± is how far a pair may be wrong (three standard deviations): in millimetres where the person was, in degrees "
        f"between the cameras. Good is up to {good}, fair up to {fair}.",
        "Joints apart and turned tell how much the skeletons of two single views differ, pose by pose: mostly errors "
        "of single views, which many poses average out. Surface points are of walls, floor and person that both "
        "cameras see, with their median distance.",
    )
    before = ReportFigure(pictures[0], "As the recording's rig has it.", chart=True)
    after = ReportFigure(pictures[1], "From above and from the side, with the person's way in black.", chart=True)
    colours = "One colour a camera: walls and floor of one should lie on those of another."
    sections = [
        ReportSection("Verdict", (headline, *notes), (pair_table(pairs),)),
        ReportSection("After", (colours,), figures=(after,)),
        ReportSection("Before", figures=(before,)),
        ReportSection("What the numbers mean", explained),
    ]
    write_report(path, "Calibration", sections)


def draw_clouds(
    clouds: dict[str, Float[ndarray, "_ 3"]],
    poses: Sequence[Float[ndarray, "4 4"]],
    trajectory: Float[ndarray, "n 3"] | None,
) -> bytes:
    """A PNG of the clouds in a Z-up world from above and from the side.

    Args:
        clouds: points by camera, in the world.
        poses: ``world_from_camera`` of these.
        trajectory: positions of the person in the world (metres), in order.
    """
    figure = Figure(figsize=(8.6, 4.4), dpi=_DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    points = np.concatenate([*clouds.values(), np.stack([pose[:3, 3] for pose in poses])])
    low, high = np.percentile(points, _PERCENTILES, axis=0)
    for index, (title, across, along) in enumerate((("from above", 0, 1), ("from the side", 0, 2))):
        axes = figure.add_subplot(1, 2, index + 1)
        for colour, (name, cloud), pose in zip(COLOURS * 4, clouds.items(), poses, strict=False):
            thin = cloud[:: max(len(cloud) // _POINTS, 1)]
            axes.plot(thin[:, across], thin[:, along], ".", color=colour, markersize=0.8)
            eye, tip = pose[:3, 3], pose[:3, 3] + 0.4 * pose[:3, 2]
            axes.plot(*np.stack([eye, tip])[:, [across, along]].T, color=colour, linewidth=2)
            axes.plot(eye[across], eye[along], "o", color=colour, markersize=6, label=label_of(name))
        if trajectory is not None:
            axes.plot(trajectory[:, across], trajectory[:, along], color="black", linewidth=0.8)
        axes.set_xlim(low[across] - 0.4, high[across] + 0.4)
        axes.set_ylim(low[along] - 0.4, high[along] + 0.4)
        axes.set_aspect("equal")
        axes.set_title(title, fontsize=10, color=INK)
        axes.set_xlabel("x (m)", fontsize=9, color=INK)
        axes.set_ylabel("xyz"[along] + " (m)", fontsize=9, color=INK)
        axes.tick_params(colors=SOFT, labelsize=8)
        if index == 0:
            axes.legend(frameon=False, fontsize=8, loc="upper right")
    return as_png(figure)
