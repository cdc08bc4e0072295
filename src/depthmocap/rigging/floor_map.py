"""Where on the floor each camera has seen the person, and where to walk next."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.calibrate import Calibration
from depthmocap.calibration.observations import Observation
from depthmocap.geometry import DepthCamera, Rig, rigid_inverse, transform_points
from depthmocap.text import camera_list

#: Side of a cell of the map (metres).
CELL_M = 0.25
#: What the map has around the cameras and the person (metres).
MARGIN_M = 0.5
#: Most cells along a side.
_MOST_CELLS = 80
#: A person is where a camera sees all of these heights above the floor (metres),
_HEIGHTS_M = (0.4, 1.0, 1.6)
#: from this distance (metres)
_NEAREST_M = 1.0
#: to this one (metres).
_FARTHEST_M = 4.5
#: Share of the picture at its rim in which a person would be cut off.
_RIM = 0.04
#: What is nearer than the person by this (metres) hides them.
_HIDDEN_M = 0.3
#: Frames in a cell after which walking there again helps little.
ENOUGH = 12


@dataclasses.dataclass(frozen=True, eq=False)
class FloorMap:
    """The floor seen from above. Cell [i, j] begins at ``corner_m`` + (j, i) · ``CELL_M`` in the rig's world.

    Attributes:
        seen: by camera, the number of frames that show the person in each cell.
        visible: by camera, the cells in which it would see a person.
        places_m: by camera, where it stands.
        next_m: where to walk next; None where there is nothing to tell.
    """

    corner_m: Float[ndarray, "2"]
    seen: dict[str, Int[ndarray, "ny nx"]]
    visible: dict[str, Bool[ndarray, "ny nx"]]
    places_m: dict[str, Float[ndarray, "2"]]
    next_m: Float[ndarray, "2"] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Cells along y and x."""
        return next(iter(self.seen.values())).shape

    def centres_m(self) -> Float[ndarray, "ny nx 2"]:
        """The middles of the cells."""
        y, x = np.mgrid[: self.shape[0], : self.shape[1]]
        return self.corner_m + CELL_M * (np.stack([x, y], -1) + 0.5)


def draw_map(calibration: Calibration, observations: Sequence[Observation]) -> FloorMap:
    """The map by the cameras that are placed so far."""
    rig = calibration.rig
    of_camera = {observation.camera.name: observation for observation in observations}
    paths = {camera.name: _path_m(camera, of_camera[camera.name]) for camera in rig.cameras}
    places = {camera.name: camera.world_from_camera[:2, 3] for camera in rig.cameras}
    everything = np.concatenate([np.stack(list(places.values())), *paths.values()])
    low, high = everything.min(0) - MARGIN_M, everything.max(0) + MARGIN_M
    middle, size = (low + high) / 2, np.minimum(np.ceil((high - low) / CELL_M), _MOST_CELLS).astype(int)
    corner = middle - size * CELL_M / 2
    nx, ny = size.tolist()
    seen = {}
    for name, path in paths.items():
        x, y = ((path - corner) / CELL_M).astype(int).T
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny)
        seen[name] = np.bincount(y[inside] * nx + x[inside], minlength=nx * ny).reshape(ny, nx)
    drawn = FloorMap(corner, seen, {}, places)
    visible = {
        camera.name: _sees_person(camera, of_camera[camera.name].empty_m, drawn.centres_m()) for camera in rig.cameras
    }
    drawn = dataclasses.replace(drawn, visible=visible)
    return dataclasses.replace(drawn, next_m=_next_place(drawn, calibration))


def _path_m(camera: DepthCamera, observation: Observation) -> Float[ndarray, "n 2"]:
    hips = observation.track.joints[:, JOINT_INDEX["Hip"]]
    hips = hips[np.isfinite(hips).all(1)]
    return transform_points(camera.world_from_camera, hips)[:, :2]


def _sees_person(
    camera: DepthCamera, empty_m: Float[ndarray, "h w"], floor_m: Float[ndarray, "ny nx 2"]
) -> Bool[ndarray, "ny nx"]:
    """Where on the floor a camera would see a whole person, before what stands in the empty scene."""
    seen = np.ones(floor_m.shape[:2], bool)
    camera_from_world = rigid_inverse(camera.world_from_camera)
    for height_m in _HEIGHTS_M:
        world = np.concatenate([floor_m, np.full((*floor_m.shape[:2], 1), height_m)], -1)
        x, y, z = np.moveaxis(transform_points(camera_from_world, world.reshape(-1, 3)), -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        rim = _RIM * camera.width
        inside = (z > _NEAREST_M) & (z < _FARTHEST_M) & (u > rim) & (u < camera.width - 1 - rim)
        inside &= (v > 0) & (v < camera.height - 1)
        hidden = np.zeros(len(z), bool)
        empty_there_m = empty_m[v[inside].astype(int), u[inside].astype(int)]
        hidden[inside] = (empty_there_m > 0) & (empty_there_m < z[inside] - _HIDDEN_M)
        seen &= (inside & ~hidden).reshape(seen.shape)
    return seen


def _next_place(drawn: FloorMap, calibration: Calibration) -> Float[ndarray, "2"] | None:
    """A place that the cameras of the least certain pair both see and where they have seen the person least."""
    for pair in sorted(calibration.pairs, key=lambda pair: -pair.uncertainty_mm):
        both = drawn.visible[pair.cameras[0]] & drawn.visible[pair.cameras[1]]
        counts = np.minimum(drawn.seen[pair.cameras[0]], drawn.seen[pair.cameras[1]])
        around = _around(counts)
        if both.any() and (fewest := int(around[both].min())) < ENOUGH:
            # Of several such places the one in their middle: at the rim the person is soon out of view.
            candidates = drawn.centres_m()[both & (around == fewest)]
            return candidates[np.linalg.norm(candidates - candidates.mean(0), axis=1).argmin()]
    return None


def _around(counts: Int[ndarray, "ny nx"]) -> Int[ndarray, "ny nx"]:
    """The sum over every cell and its neighbours."""
    padded = np.pad(counts, 1)
    ny, nx = counts.shape
    windows = [padded[i : i + ny, j : j + nx] for i, j in itertools.product(range(3), repeat=2)]
    return np.sum(windows, axis=0)


def place_words(place_m: Float[ndarray, "2"], rig: Rig) -> str:
    """A place on the floor by its distance from the cameras that are nearest to it."""
    away = {camera.name: float(np.linalg.norm(camera.world_from_camera[:2, 3] - place_m)) for camera in rig.cameras}
    nearest = sorted(away, key=away.__getitem__)[:2]
    return "where it is " + " and ".join(f"{away[name]:.1f} m to {name!r}" for name in nearest)


def advice(
    names: Sequence[str],
    seen: Mapping[str, tuple[int, int]],
    calibration: Calibration | None,
    drawn: FloorMap | None,
    lack: str,
) -> str:
    """What the person shall do next, in a line.

    Args:
        seen: by camera, frames with the person, and frames.
        lack: why no camera could be placed so far.
    """
    if not any(count for count, _ in seen.values()):
        return "let one person walk into view, and about"
    blind = [name for name in names if not seen.get(name, (0, 0))[0]]
    if blind:
        return f"walk where {camera_list(blind)} can see you, and keep another camera's view"
    if calibration is None:
        return lack or "walk on where two cameras see your whole body"
    if calibration.unplaced:
        name, why = next(iter(calibration.unplaced.items()))
        return f"walk where {name!r} and another camera both see your whole body: {why}"
    if drawn is not None and drawn.next_m is not None and calibration.grade != "good":
        return f"walk next {place_words(drawn.next_m, calibration.rig)} (the ring on the map)"
    return "walk over the whole floor, in turns, with the arms moving"
