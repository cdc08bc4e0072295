"""Labelled depth pixels to labelled world points."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def unproject_labelled(
    depth_m,
    labels,
    weights,
    box,
    rays,
    intrinsics,
    world_from_camera,
    label_count,
    start,
    out_points,
    out_labels,
    out_weights,
):
    """Write one view's pixels with a label 1…``label_count`` and a finite depth above 0 into the output arrays from row
    ``start``; the next free row.

    All labels are inside ``box`` (first row, row after the last, first column, column after the last). An empty
    ``weights`` means ones. An empty ``rays`` means no lens distortion: the rays follow from ``intrinsics`` (fx, fy, cx,
    cy).
    """
    fx, fy, cx, cy = intrinsics
    r, row = world_from_camera, start
    for v in range(box[0], box[1]):
        for u in range(box[2], box[3]):
            label, z = labels[v, u], depth_m[v, u]
            if label < 1 or label > label_count or not (z > 0 and z < np.inf):
                continue
            if rays.size:
                x, y = z * rays[v, u, 0], z * rays[v, u, 1]
            else:
                x, y = z * ((u - cx) / fx), z * ((v - cy) / fy)
            for axis in range(3):
                out_points[row, axis] = r[axis, 0] * x + r[axis, 1] * y + r[axis, 2] * z + r[axis, 3]
            out_labels[row] = label
            out_weights[row] = weights[v, u] if weights.size else 1.0
            row += 1
    return row
