"""People in one depth image, by a network: which samples show people, and where the centres of these people are."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera
from depthmocap.kernels.people_votes import lift_people
from depthmocap.segment.background import FAR_M
from depthmocap.segment.depth_grid import CELL_FOCAL_PX, FARTHEST_M, DepthGrid

#: The packaged network.
PACKAGED = Path(__file__).parent / "weights" / "people.onnx"
#: Angle between samples, and the surface that one shows at a metre (m²).
SAMPLE_RAD = 1 / (2 * CELL_FOCAL_PX)
SAMPLE_M2 = SAMPLE_RAD**2
#: A sample shows a person if its logit is above this:
PERSON_LOGIT = -1.0
#: above this where it lies before the empty scene,
BEFORE_LOGIT = -3.0
#: and above this where it looks like the empty scene that was learnt while people were there.
SURE_LOGIT = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class DetectedPeople:
    """What one image shows of people.

    Attributes:
        grid: of the camera.
        samples_m: depth of every sample (metres).
        logits: that it shows a person.
        indices: of the samples that show people, in the flat image of samples.
        points: where they are in the world (metres).
        votes: for the centre of their person (metres).
        areas_m2: their surface.
        before: whether they are where the scene was seen empty.
        limit_m: at each sample the depth (metres) from which on it shows the empty scene, 0 where it is unknown.
    """

    grid: DepthGrid
    samples_m: Float[ndarray, "rows2 columns2"]
    logits: Float[ndarray, "rows2 columns2"]
    indices: ndarray
    points: Float[ndarray, "n 3"]
    votes: Float[ndarray, "n 3"]
    areas_m2: Float[ndarray, " n"]
    before: Bool[ndarray, " n"]
    limit_m: Float[ndarray, "rows2 columns2"]


class PeopleDetector:
    """Finds people in whole depth images, one by one. Nothing is remembered."""

    def __init__(self, source: Path | None = None) -> None:
        """
        Args:
            source: a people.onnx that ``train people`` wrote; by default the packaged one.

        Raises:
            InputError: when it cannot be read or is another network.
        """
        source = source or PACKAGED
        self._session = open_network(source, "train one with `depthmocap train people`")
        names = [end.name for end in (*self._session.get_inputs(), *self._session.get_outputs())]
        if names != ["cells", "people"]:
            raise InputError(f"{source} is not a network that finds people: it has {', '.join(names)}")

    def __call__(
        self,
        grid: DepthGrid,
        depth_m: Float[ndarray, "h w"],
        limit_m: Float[ndarray, "rows2 columns2"] | None = None,
        sure: float = SURE_LOGIT,
    ) -> DetectedPeople:
        """The people in a depth image of the grid's camera.

        Args:
            limit_m: at each sample the depth from which on it shows the empty scene, by ``grid.samples``; ``FAR_M`` or
                more where it is unknown.
            sure: logit above which such samples show people all the same.
        """
        samples_m = grid.samples(depth_m)
        (outputs,) = self._session.run(None, {"cells": grid.inputs(samples_m)[None]})
        logits, offsets = grid.to_camera(np.asarray(outputs)[0])
        least = np.full(samples_m.shape, PERSON_LOGIT, np.float32)
        if limit_m is not None:
            least[limit_m < FAR_M] = BEFORE_LOGIT
            least[samples_m >= limit_m] = sure
        count = int(np.count_nonzero(logits > BEFORE_LOGIT))
        indices, areas = np.empty(count, np.int64), np.empty(count, np.float32)
        points, votes = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
        count = lift_people(
            samples_m, logits, offsets, grid.rays, grid.camera.world_from_camera, least, FARTHEST_M, SAMPLE_M2,
            indices, points, votes, areas,
        )  # fmt: skip
        indices = indices[:count]
        known_m = np.zeros_like(samples_m) if limit_m is None else np.where(limit_m < FAR_M, limit_m, np.float32(0))
        before = samples_m.ravel()[indices] < known_m.ravel()[indices]
        return DetectedPeople(
            grid, samples_m, logits, indices, points[:count], votes[:count], areas[:count], before, known_m
        )  # fmt: skip


def person_mask(detected: DetectedPeople) -> Bool[ndarray, "rows2 columns2"]:
    """The samples that show people."""
    mask = np.zeros(detected.samples_m.size, np.bool_)
    mask[detected.indices] = True
    return mask.reshape(detected.samples_m.shape)


def grid_of(camera: DepthCamera, up_world: Float[ndarray, "3"]) -> DepthGrid:
    """The grid of a camera, upright if its pose tells what is up."""
    return DepthGrid(camera, camera.quarters_upright(up_world))
