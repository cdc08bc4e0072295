"""A blanket over somebody who lies: a height field that falls over the body and the bed beside it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, grey_dilation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.render import Layer, Material, PosedPerson

#: Spacing of the height field (metres).
_STEP_M = 0.04


def blanket_over(rng: np.random.Generator, person: PosedPerson) -> Layer:
    """A blanket or sheet from beyond the feet up to anywhere between the hips and the neck of a lying person."""
    head = person.joints[JOINT_INDEX["Head"], :2]
    feet = (person.joints[JOINT_INDEX["RFoot"], :2] + person.joints[JOINT_INDEX["LFoot"], :2]) / 2
    along = head - feet
    along /= max(float(np.linalg.norm(along)), 1e-6)
    axes = np.stack([along, [-along[1], along[0]]])
    points = np.concatenate([person.vertices, *(layer.vertices for layer in person.layers)]).astype(float)
    local = points[:, :2] @ axes.T
    hips, neck = (axes[0] @ person.joints[JOINT_INDEX[name], :2] for name in ("Hip", "Neck"))
    end = rng.uniform(*sorted((hips, neck)))
    low = np.array([local[:, 0].min() - rng.uniform(0.05, 0.3), local[:, 1].min() - rng.uniform(0.05, 0.35)])
    high = np.array([end, local[:, 1].max() + rng.uniform(0.05, 0.35)])
    count = np.maximum(((high - low) / _STEP_M).astype(int) + 1, 3)
    cells = ((local - low) / _STEP_M).astype(int)
    inside = ((cells >= 0) & (cells < count)).all(1)
    under = points[:, 2].min()
    heights = np.full(tuple(count), under)
    np.maximum.at(heights, tuple(cells[inside].T), points[inside, 2])
    thick = rng.uniform(0.005, 0.05)
    size = 2 * int(rng.integers(1, 3)) + 1
    draped = gaussian_filter(grey_dilation(heights, size=(size, size)), rng.uniform(0.7, 2.0))
    # Smoothed cloth must not cut through the body.
    heights = np.maximum(draped, heights) + thick
    i, j = np.meshgrid(np.arange(count[0]), np.arange(count[1]), indexing="ij")
    flat = np.stack([low[0] + (i + 0.5) * _STEP_M, low[1] + (j + 0.5) * _STEP_M], -1).reshape(-1, 2) @ axes
    vertices = np.concatenate([flat, heights.reshape(-1, 1)], 1)
    corner = (i[:-1, :-1] * count[1] + j[:-1, :-1]).ravel()
    right, up, both = corner + count[1], corner + 1, corner + count[1] + 1
    faces = np.concatenate([np.stack([corner, right, both], 1), np.stack([corner, both, up], 1)])
    return Layer(vertices.astype(np.float32), faces.astype(np.int64), Material.CLOTH)
