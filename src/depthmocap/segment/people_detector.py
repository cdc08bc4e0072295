"""People in one depth image, by a network: which samples show people, and where the centres of these people are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera
from depthmocap.kernels.people_votes import lift_people
from depthmocap.segment.background import FAR_M
from depthmocap.segment.closer_look import CloserLook, look_closer
from depthmocap.segment.depth_grid import CELL_FOCAL_PX, FARTHEST_M, DepthGrid

#: The packaged network.
PACKAGED = Path(__file__).parent / "weights" / "people.onnx"
#: Angle between samples, and the surface that one shows at a metre (m²).
SAMPLE_RAD = 1 / (2 * CELL_FOCAL_PX)
SAMPLE_M2 = SAMPLE_RAD**2
#: Of a picture of which most shows the empty scene the network sees what does not, with so many cells around it,
CONTEXT_CELLS = 24
#: if that is at most this share of the picture.
_LARGEST_SHARE = 0.8
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
        outputs: of the network, for the whole grid, before closer looks.
        looks: at what was unsure.
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
    outputs: Float[ndarray, "7 rows columns"]
    looks: Sequence[CloserLook] = ()


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
        last: DetectedPeople | None = None,
    ) -> DetectedPeople:
        """The people in a depth image of the grid's camera.

        Args:
            limit_m: at each sample the depth from which on it shows the empty scene (:func:`limits_at`), 0 where it is
                unknown.
            sure: logit above which such samples show people all the same.
            last: what the camera's last image showed: the network looks again where this one does not show the empty
                scene, and where that one showed people; and closer where no look at what was unsure holds.
        """
        samples_m = grid.samples(depth_m)
        in_part = None if limit_m is None else last
        if limit_m is None:
            limit_m = np.zeros_like(samples_m)
        empty = (limit_m > 0) & (samples_m >= limit_m)
        outputs = self._outputs(grid, samples_m, empty, in_part)
        logits, offsets = grid.to_camera(outputs)
        looks = look_closer(
            grid, depth_m, self._run, samples_m, logits, offsets, empty, () if last is None else last.looks
        )
        count = int(np.count_nonzero(logits > BEFORE_LOGIT))
        indices, areas, before = np.empty(count, np.int64), np.empty(count, np.float32), np.empty(count, np.bool_)
        points, votes = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
        count = lift_people(
            samples_m, logits, offsets, grid.rays, grid.camera.world_from_camera, limit_m,
            (PERSON_LOGIT, BEFORE_LOGIT, float(sure)), FARTHEST_M, SAMPLE_M2, indices, points, votes, areas, before,
        )  # fmt: skip
        return DetectedPeople(
            grid, samples_m, logits, indices[:count], points[:count], votes[:count], areas[:count], before[:count],
            limit_m, outputs, looks,
        )  # fmt: skip

    def _outputs(
        self,
        grid: DepthGrid,
        samples_m: Float[ndarray, "rows2 columns2"],
        empty: Bool[ndarray, "rows2 columns2"],
        last: DetectedPeople | None,
    ) -> Float[ndarray, "7 rows columns"]:
        """The network's outputs for the whole grid, where it need not look again those of the last image."""
        cells, part = grid.inputs(samples_m), None
        if last is not None:
            changed = ~(empty | (samples_m <= 0)) | person_mask(last)
            part = grid.part_around(changed, CONTEXT_CELLS, _LARGEST_SHARE)
        if last is None or part is None:
            return self._run(cells)
        outputs = last.outputs.copy()
        rows, columns = part
        if rows.stop > rows.start:
            outputs[:, rows, columns] = self._run(np.ascontiguousarray(cells[:, rows, columns]))
        return outputs

    def _run(self, cells: Float[ndarray, "channels rows columns"]) -> Float[ndarray, "7 rows columns"]:
        return np.asarray(self._session.run(None, {"cells": cells[None]})[0])[0]


def limits_at(grid: DepthGrid, limit_m: Float[ndarray, "h w"]) -> Float[ndarray, "rows2 columns2"]:
    """At each sample the depth (metres) from which on it shows the empty scene, 0 where that is unknown.

    Args:
        limit_m: of every pixel (``BackgroundModel.limit_m``).
    """
    samples_m = grid.samples(limit_m)
    return np.where(samples_m < FAR_M, samples_m, np.float32(0))


def person_mask(detected: DetectedPeople) -> Bool[ndarray, "rows2 columns2"]:
    """The samples that show people."""
    mask = np.zeros(detected.samples_m.size, np.bool_)
    mask[detected.indices] = True
    return mask.reshape(detected.samples_m.shape)


def grid_of(camera: DepthCamera, up_world: Float[ndarray, "3"]) -> DepthGrid:
    """The grid of a camera, upright if its pose tells what is up."""
    return DepthGrid(camera, camera.quarters_upright(up_world))
