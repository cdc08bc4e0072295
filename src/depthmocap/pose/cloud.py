"""View aggregation (paper, section "View Aggregation"): labelled depth images to one labelled world point cloud."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

from depthmocap.body.regions import REGION_COUNT
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.kernels.box import bounding_box
from depthmocap.kernels.point_cloud import unproject_labelled
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.mirrored import undo_mirrored

#: A cloud with fewer points contains no person.
MIN_CLOUD_POINTS = 50


_NO_RAYS = np.empty((0, 0, 2), np.float32)
_NO_WEIGHTS = np.empty((0, 0), np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class LabelledCloud:
    """World points (metres) with their regions 1–43 and the probability of each label, 1 for true labels.

    The points of a camera are consecutive: first ``view_sizes[0]`` points of ``cameras[0]``, and so on. A cloud may
    have no cameras; the paper's features do not need them. ``joints`` are the joints estimated from each view alone
    (see ``LabelledView``), NaN where there are none. ``front_log_odds`` are the log odds of all views together that
    what is labelled front is not the back, NaN where no view tells.
    """

    points_world: Float32[ndarray, "n 3"]
    labels: UInt8[ndarray, "n"]
    weights: Float32[ndarray, "n"]
    view_sizes: tuple[int, ...] = ()
    cameras: tuple[DepthCamera, ...] = ()
    joints: tuple[Float[ndarray, "18 4"] | None, ...] = ()
    front_log_odds: float = float("nan")

    def __len__(self) -> int:
        return len(self.labels)


def merge_views(parts: Sequence[LabelledView]) -> LabelledCloud:
    """Labelled pixels of all views as world points, view after view in row-major order.

    Mirrored views are corrected first (``mirrored.undo_mirrored``); :func:`merge_agreeing_views` leaves that out.

    Raises:
        InputError: as :func:`merge_agreeing_views`.
    """
    return merge_agreeing_views(undo_mirrored(parts))


def merge_agreeing_views(parts: Sequence[LabelledView]) -> LabelledCloud:
    """Labelled pixels of views of which none is mirrored against another, as of :func:`merge_views`.

    Pixels without a finite depth above 0, and those with a label other than 1–43 (background 0, unknown 255), are left
    out.

    Raises:
        InputError: when the depth, labels, weights or (for a lens with distortion) camera of a view differ in shape.
    """
    capacity = sum(int(np.count_nonzero(part.labels)) for part in parts)
    points_world = np.empty((capacity, 3), np.float32)
    all_labels, all_weights = np.empty(capacity, np.uint8), np.empty(capacity, np.float32)
    row, sizes = 0, []
    for view, labels, weights, *_ in parts:
        start = row
        row = _unproject(view, labels, weights, row, points_world, all_labels, all_weights)
        sizes.append(row - start)
    cameras, joints = tuple(part.view.camera for part in parts), tuple(part.joints for part in parts)
    odds = [part.front_log_odds for part, size in zip(parts, sizes, strict=True) if size]
    known = [value for value in odds if np.isfinite(value)]
    return LabelledCloud(
        points_world[:row], all_labels[:row], all_weights[:row], tuple(sizes), cameras, joints,
        float(sum(known)) if known else float("nan"),
    )  # fmt: skip


def _unproject(
    view: View, labels: UInt8[ndarray, "_ _"], weights: Float[ndarray, "_ _"] | None, start: int, *arrays: ndarray
) -> int:
    """Write a view's points, their labels and weights into three arrays from row ``start``; the next free row."""
    camera, shape = view.camera, view.depth_m.shape
    if labels.shape != shape or (weights is not None and weights.shape != shape):
        weights_shape = "" if weights is None else f" and weights {weights.shape}"
        raise InputError(f"camera {camera.name!r}: depth is {shape}, but labels are {labels.shape}{weights_shape}")
    # Without lens distortion the rays are two multiplications: cheaper than a table when cameras come and go.
    rays = camera.rays if any(camera.distortion) else _NO_RAYS
    if rays.size and rays.shape[:2] != shape:
        raise InputError(f"camera {camera.name!r} is {rays.shape[:2]} (rows, columns), but its depth is {shape}")
    box = bounding_box(np.ascontiguousarray(labels))
    if box is None:
        return start
    # A pixel without a ray, outside the lens model, has no position in the world.
    depth_m = np.where(np.isfinite(rays[..., 0]), view.depth_m, 0) if rays.size else view.depth_m
    return unproject_labelled(
        np.ascontiguousarray(depth_m, np.float32),
        np.ascontiguousarray(labels),
        _NO_WEIGHTS if weights is None else np.ascontiguousarray(weights, np.float32),
        (box[0].start, box[0].stop, box[1].start, box[1].stop),
        rays,
        (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)),
        np.ascontiguousarray(camera.world_from_camera, np.float64),
        REGION_COUNT,
        start,
        *arrays,
    )
