"""OpenSim's own inverse kinematics of a person's model (extra: opensim)."""

from __future__ import annotations

import importlib
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import write_file
from depthmocap.errors import InputError, missing_extra
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.landmark_model import LandmarkModel
from depthmocap.exporting.opensim_model import COORDINATES, PLACES, UNSURE, model_xml
from depthmocap.exporting.trc import write_take_trc
from depthmocap.exporting.virtual_markers import landmark_confidence, landmark_positions

#: Weight of coordinates that markers may not show, against squared distances in metres.
_HELD = 1e-4
#: A marker that is missing in a frame is left out by OpenSim; a weight of 0 would make it begin anew.
_LEAST_WEIGHT = 0.01
#: A landmark whose own error is so large (m) counts half as much as its confidence.
_HALF_M = 0.01
#: How exactly each frame is solved.
_ACCURACY = 1e-6


def write_mot(path: Path, take: ExportedTake, settings: FileSettings) -> dict[str, Any]:
    """Write ``ik.mot``: OpenSim's inverse kinematics of the person's model (``--formats osim`` writes the same one).

    The joints are markers, each weighted by its confidence in that frame; landmarks, where they are wanted, by theirs
    and by how well a skeleton tells them. Frames without any sure joint have no row; the coordinates of a limb that is
    not seen stay where they were.

    Returns:
        for export.json: how far markers are from the model (``marker_rms_cm``, ``by_marker_cm``), and the number of
        ``frames``.

    Raises:
        InputError: when opensim is not installed, the file cannot be written, or no joint remains.
    """
    try:
        opensim: Any = importlib.import_module("opensim")
    except ImportError:
        raise missing_extra("opensim", "opensim") from None
    (person,) = take.people
    line = take.rows(person, settings.least_confidence)
    motion = solve_body(line, settings.fill_s)
    marker_names, points, weights = JOINTS, motion.joints, person.table.confidence
    if settings.landmarks:
        certainties = 1 / (1 + (LandmarkModel.load().errors_m(motion.offsets) / _HALF_M) ** 2)
        marker_names += LANDMARK_NAMES
        points = np.concatenate([points, landmark_positions(motion)], 1)
        weights = np.concatenate([weights, landmark_confidence(weights) * certainties], 1)
    seen = np.asarray(~np.isnan(points).any(-1))
    weights = np.maximum(weights, _LEAST_WEIGHT)
    opensim.Logger.setLevelString("Error")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "model.osim").write_text(model_xml(motion.offsets, "person", settings.landmarks), encoding="utf-8")
        write_take_trc(folder / "pose.trc", take, settings)
        try:
            times_s, rows, errors, names = _solve(opensim, folder, marker_names, weights, seen)
        except RuntimeError as error:
            raise InputError(f"OpenSim's inverse kinematics failed: {str(error).splitlines()[0]}") from None
    write_file(path, _text_of(times_s, rows))

    def rms_cm(values: ndarray) -> float | None:
        known = values[np.isfinite(values)]
        return float(100 * np.sqrt((known**2).mean())) if len(known) else None

    return {
        "frames": len(rows),
        "marker_rms_cm": rms_cm(errors.ravel()),
        "by_marker_cm": {name: rms_cm(errors[:, i]) for i, name in enumerate(names)},
    }


def _solve(
    opensim: Any,
    folder: Path,
    marker_names: tuple[str, ...],
    weights: Float[ndarray, "t m"],
    seen: Bool[ndarray, "t m"],
) -> tuple[list[float], Float[ndarray, "n c"], Float[ndarray, "n k"], list[str]]:
    """Times, coordinates (degrees and m), and errors of markers (m, NaN where one was not seen) with their names."""
    model = opensim.Model(str(folder / "model.osim"))
    state = model.initSystem()
    frames = np.flatnonzero(seen.any(axis=1)).tolist()
    marker_weights = opensim.SetMarkerWeights()
    for number, name in enumerate(marker_names):
        marker_weights.cloneAndAppend(opensim.MarkerWeight(name, float(weights[frames[0], number])))
    markers = opensim.MarkersReference(str(folder / "pose.trc"), marker_weights)
    held = opensim.SimTKArrayCoordinateReference()
    for name in UNSURE:
        reference = opensim.CoordinateReference(name, opensim.Constant(0.0))
        reference.setWeight(_HELD)
        held.push_back(reference)
    solver = opensim.InverseKinematicsSolver(model, markers, held, math.inf)
    solver.setAccuracy(_ACCURACY)
    coordinates = [model.getCoordinateSet().get(name) for name in COORDINATES]
    scales = [1.0 if name in PLACES else math.degrees(1.0) for name in COORDINATES]
    times_s = list(markers.getMarkerTable().getIndependentColumn())
    state.setTime(times_s[frames[0]])
    solver.assemble(state)  # before it the solver has no markers
    names = [solver.getMarkerNameForIndex(i) for i in range(solver.getNumMarkersInUse())]
    order = [marker_names.index(name) for name in names]
    rows, errors = [], []
    for i in frames:
        state.setTime(times_s[i])
        for name, number in zip(names, order, strict=True):
            solver.updateMarkerWeight(name, float(weights[i, number]))
        solver.track(state)
        rows.append([each.getValue(state) * scale for each, scale in zip(coordinates, scales, strict=True)])
        squares = opensim.SimTKArrayDouble()
        solver.computeCurrentMarkerErrors(squares)
        values = np.array([squares.getElt(k) for k in range(len(names))])
        errors.append(np.where(seen[i, order], values, np.nan))
    return [times_s[i] for i in frames], np.array(rows), np.array(errors), names


def _text_of(times_s: Sequence[float], rows: Float[ndarray, "n c"]) -> str:
    """A motion file of OpenSim's."""
    head = ["Coordinates", "version=1", f"nRows={len(rows)}", f"nColumns={len(COORDINATES) + 1}", "inDegrees=yes"]
    lines = [*head, "endheader", "\t".join(("time", *COORDINATES))]
    lines += [
        "\t".join([f"{time_s:.6f}", *(f"{value:.6f}" for value in row)])
        for time_s, row in zip(times_s, rows.tolist(), strict=True)
    ]
    return "\n".join(lines) + "\n"
