"""OpenSim's TRC marker files: the joints as markers, millimetres, Y up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import write_file
from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.gap_filling import fill_gaps
from depthmocap.exporting.timeline import LEAST_CONFIDENCE, Y_UP_FROM_Z_UP, timeline
from depthmocap.exporting.virtual_markers import landmark_positions
from depthmocap.frames import Pose

_KEYS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip
_HEADER_LINES = 5
#: Larger numbers cannot belong to a skeleton.
_LARGEST = 1e12


def write_trc(
    path: Path,
    poses: Sequence[Pose],
    up: str,
    least_confidence: float = LEAST_CONFIDENCE,
    origin_ns: int | None = None,
    *,
    fill_s: float = 0.0,
    landmarks: bool = False,
) -> None:
    """Write poses whose world has the up axis ``up`` ("z", "y" or "-y").

    Times are those of the poses, from ``origin_ns`` on their clock (by default the first pose is at 0). The rates in
    the header follow from their typical interval. A marker that is missing, or whose confidence is below
    ``least_confidence``, is three empty cells, which OpenSim reads as NaN; gaps of a marker up to ``fill_s`` seconds
    are filled instead (:func:`fill_gaps`). With ``landmarks`` the surface landmarks of the skeleton of constant bones
    are markers after the joints.

    Raises:
        InputError: when there is no pose, none shows a person, timestamps do not increase, or the file cannot be
            written.
    """
    line = timeline(poses, up, least_confidence, origin_ns)
    points, _ = fill_gaps(line.times_s, line.joints_y_up, fill_s)
    names = JOINTS
    if landmarks:
        names += LANDMARK_NAMES
        points = np.concatenate([points, landmark_positions(solve_body(line, fill_s))], 1)
    rate = f"{1 / line.frame_s:.6g}"
    count = str(len(poses))
    values = (rate, rate, count, str(len(names)), "mm", rate, "1", count)
    axes = [f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ"]
    # OpenSim ends lines with a tab. It needs the tab to count the cells of a row whose last marker is missing.
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(_KEYS),
        "\t".join(values),
        "Frame#\tTime\t" + "".join(f"{joint}\t\t\t" for joint in names),
        "\t\t" + "".join(f"{axis}\t" for axis in axes),
        "",
    ]
    for i, (time_s, points_mm) in enumerate(zip(line.times_s, points * 1000, strict=True)):
        cells = ["" if np.isnan(value) else f"{value:.3f}" for value in points_mm.ravel()]
        lines.append("\t".join([str(i + 1), f"{time_s:.6f}", *cells, ""]))
    write_file(path, "\n".join(lines) + "\n")


def write_take_trc(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write a person of a take as :func:`write_trc` does.

    Raises:
        InputError: when the file cannot be written, or no joint remains.
    """
    (person,) = take.people
    poses = person.table.poses()
    write_trc(
        path, poses, take.up, settings.least_confidence, take.origin_ns,
        fill_s=settings.fill_s, landmarks=settings.landmarks,
    )  # fmt: skip


def read_trc(path: Path) -> tuple[Float[ndarray, " t"], Float[ndarray, "t 18 3"]]:
    """Times (s) and joints (m, Z up, NaN where missing) of a file that ``write_trc`` wrote; landmarks are passed over.

    Raises:
        InputError: when the file is missing, or is not such a file.
    """
    lines = read_text(path).split("\n")
    if not lines[0].startswith("PathFileType\t4") or len(lines) < _HEADER_LINES:
        raise InputError(f"{path} is not a TRC file")
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    names = tuple(cell for cell in lines[3].rstrip("\r").split("\t")[2:] if cell)
    if names not in (JOINTS, JOINTS + LANDMARK_NAMES) or header.get("Units") != "mm":
        raise InputError(f"{path} was not written by depthmocap: its markers must be {', '.join(JOINTS)}, in mm")
    width = 2 + 3 * len(JOINTS)
    try:
        rows = [line.rstrip("\r").split("\t")[:width] for line in lines[_HEADER_LINES:] if line.strip()]
        table = np.array([[float(cell or "nan") for cell in row] for row in rows]).reshape(-1, width)
        if (np.abs(table) > _LARGEST).any():
            raise ValueError("it has a number that no length or time can be")
    except ValueError as error:
        raise InputError(f"{path} has a row that cannot be read: {error}") from None
    return table[:, 1], table[:, 2:].reshape(-1, len(JOINTS), 3) / 1000 @ Y_UP_FROM_Z_UP
