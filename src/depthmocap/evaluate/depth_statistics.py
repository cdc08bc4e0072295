"""Numbers that tell how a depth sensor behaves, from its pictures alone: to set generated depth beside real depth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.errors import InputError

#: Limits of the steps between neighbours that are counted (metres).
STEPS_M = (0.1, 0.2, 0.4, 0.8, 1.6, np.inf)
#: Limits of the distances that noise is told for (metres).
DISTANCES_M = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0)
#: A step between pixels of more than this share of the distance is a silhouette, not a slope.
_EDGE_SHARE = 0.04
#: Side of the windows that planes are fitted to (pixels).
_WINDOW = 5
#: Largest slope in them (depth a pixel, of the depth).
_SLOPE = 0.015


@dataclasses.dataclass(frozen=True, eq=False)
class DepthStatistics:
    """Of one or more depth images.

    Attributes:
        silhouette_px: pixels beside a silhouette or beside nothing.
        step_share: of the steps beyond ``STEPS_M[0]`` between valid neighbours, the share in each class of ``STEPS_M``.
        steps_per_px: number of such steps per silhouette pixel. A sensor that loses pixels at silhouettes has few.
        stray_share: pixels that are a silhouette away from all valid ones around them but one, per silhouette pixel.
        hole_share: invalid pixels in holes of up to about 7 px, per valid pixel.
        gap_px: mean width of what is invalid between a near and a far surface along a row, with the near one on the
            left and on the right. They differ by the shadow of a projector or a second camera. NaN without any.
        noise_m: deviation from planes fitted to windows of 5×5, the median in each class of ``DISTANCES_M``; NaN with
            fewer than 20 windows. What neighbours have in common does not show in it.
    """

    silhouette_px: int
    step_share: Float[ndarray, "steps"]
    steps_per_px: float
    stray_share: float
    hole_share: float
    gap_px: tuple[float, float]
    noise_m: Float[ndarray, "distances"]


def depth_statistics(
    depths_m: Sequence[Float[ndarray, "_h _w"]], masks: Sequence[Bool[ndarray, "_h _w"]] | None = None
) -> DepthStatistics:
    """Statistics of depth images (metres, 0 invalid); with masks, of the masked pixels alone.

    Raises:
        InputError: when there are no images, or not a mask for each.
    """
    if not depths_m or (masks is not None and len(masks) != len(depths_m)):
        raise InputError(
            f"expected depth images and as many masks, got {len(depths_m)} and {len(masks) if masks is not None else 0}"
        )
    edges = strays = holes = valid = 0
    steps, near_left, near_right = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    residuals: list[Float[ndarray, "_"]] = []
    distances: list[Float[ndarray, "_"]] = []
    for i, image in enumerate(depths_m):
        depth = image.astype(np.float32) if masks is None else np.where(masks[i], image, 0).astype(np.float32)
        edge, stray, jumps = _silhouettes(depth)
        edges, strays, valid = edges + int(edge.sum()), strays + int(stray.sum()), valid + int((depth > 0).sum())
        holes += int(_holes(depth).sum())
        steps.append(jumps)
        # Gaps lie between the person and what is behind: a mask would hide them.
        left, right = _gaps(image.astype(np.float32))
        near_left.append(left)
        near_right.append(right)
        residual, distance = _noise(depth)
        residuals.append(residual)
        distances.append(distance)
    step_counts, _ = np.histogram(np.concatenate(steps), STEPS_M)
    total, residual, distance = max(int(step_counts.sum()), 1), np.concatenate(residuals), np.concatenate(distances)
    classes = np.digitize(distance, DISTANCES_M) - 1
    noise = [residual[classes == k] for k in range(len(DISTANCES_M) - 1)]
    return DepthStatistics(
        silhouette_px=edges,
        step_share=step_counts / total,
        steps_per_px=float(step_counts.sum() / max(edges, 1)),
        stray_share=strays / max(edges, 1),
        hole_share=holes / max(valid, 1),
        gap_px=(_mean(np.concatenate(near_left)), _mean(np.concatenate(near_right))),
        noise_m=np.array(
            [np.median(residuals_of_class) if len(residuals_of_class) >= 20 else np.nan for residuals_of_class in noise]
        ),
    )


def _mean(values: Float[ndarray, "_"]) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _silhouettes(
    depth: Float[ndarray, "h w"],
) -> tuple[Bool[ndarray, "h w"], Bool[ndarray, "h w"], Float[ndarray, "_"]]:
    """Pixels at silhouettes, strays among them, and the steps between neighbours."""
    around = np.pad(depth, 1)
    height, width = depth.shape
    close = np.zeros(depth.shape, np.uint8)
    edge = np.zeros(depth.shape, bool)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            if dv or du:
                other = around[1 + dv : 1 + dv + height, 1 + du : 1 + du + width]
                alike = (other > 0) & (np.abs(other - depth) <= _EDGE_SHARE * depth)
                close += alike
                if not (dv and du):
                    edge |= ~alike
    inside = np.zeros(depth.shape, bool)
    inside[1:-1, 1:-1] = True  # what lies beyond the picture is not known
    valid = (depth > 0) & inside
    across = np.abs(np.diff(depth, axis=1))[(depth[:, 1:] > 0) & (depth[:, :-1] > 0)]
    down = np.abs(np.diff(depth, axis=0))[(depth[1:] > 0) & (depth[:-1] > 0)]
    return edge & valid, (close <= 1) & valid, np.concatenate([across, down])


def _holes(depth: Float[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
    """Invalid pixels that closing the picture by 3 px on all sides makes valid; gaps at silhouettes are left out."""
    valid = (depth > 0).astype(np.uint8)
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    closed = cv2.morphologyEx(valid, cv2.MORPH_CLOSE, ball, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    # Both sides of a gap as wide as that are seen from all of it.
    around = np.ones((15, 15), np.uint8)
    far = cv2.dilate(depth, around)
    near = cv2.erode(np.where(depth > 0, depth, np.float32(100)), around)
    return (closed > 0) & (valid == 0) & (far - near < 2 * _EDGE_SHARE * near)


def _gaps(depth: Float[ndarray, "h w"]) -> tuple[Float[ndarray, "_"], Float[ndarray, "_"]]:
    """Widths (up to 30 px) of what is invalid between two distances: with the near one on the left, on the right."""
    rows, columns = np.nonzero(depth > 0)
    z = depth[rows, columns]
    width = np.diff(columns) - 1
    is_gap = (np.diff(rows) == 0) & (width > 0) & (width <= 30)
    step = np.diff(z) / z[:-1]
    left = width[is_gap & (step > 3 * _EDGE_SHARE)].astype(np.float64)
    right = width[is_gap & (step < -3 * _EDGE_SHARE)].astype(np.float64)
    return left, right


def _noise(depth: Float[ndarray, "h w"]) -> tuple[Float[ndarray, "_"], Float[ndarray, "_"]]:
    """Deviation from the best plane in every whole and fairly even window, and the window's distance."""
    half = _WINDOW // 2
    z = depth.astype(np.float64)
    steps = np.arange(-half, half + 1, dtype=np.float64)
    ones, size = np.ones(_WINDOW), _WINDOW**2
    whole = cv2.erode((depth > 0).astype(np.uint8), np.ones((_WINDOW, _WINDOW)), borderValue=0) > 0

    def filtered(image: Float[ndarray, "h w"], along_u: ndarray, along_v: ndarray) -> Float[ndarray, "h w"]:
        return cv2.sepFilter2D(image, cv2.CV_64F, along_u, along_v)

    mean = filtered(z, ones, ones) / size
    # Centred so that squares of metres lose no digits to squares of millimetres.
    square = filtered(z * z, ones, ones) - size * mean**2
    moment = _WINDOW * (steps**2).sum()
    p, q = filtered(z, steps, ones) / moment, filtered(z, ones, steps) / moment
    rest = np.maximum(square - moment * (p**2 + q**2), 0) / (size - 3)
    even = whole & (np.hypot(p, q) < _SLOPE * mean) & (rest < (_EDGE_SHARE / 2 * mean) ** 2)
    return np.sqrt(rest[even]), mean[even]
