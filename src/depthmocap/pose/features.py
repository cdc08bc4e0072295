"""The paper's 24 statistics per body region (section "View Aggregation"): a labelled cloud as one vector of 1032."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray

from depthmocap.body.regions import REGION_COUNT
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.kernels.stats import region_statistics, sort_by_region
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.pose.parts import heading_frame, part_statistics

#: Per region, in this order: median (3), covariance (9, row-major), its eigenvalues (3, ascending), standard
#: deviation (3), minimum (3), maximum (3).
FEATURES_PER_REGION = 24
FEATURE_COUNT = REGION_COUNT * FEATURES_PER_REGION
#: Frame of the features: the Z-up world, as in the paper; the same centred on the cloud; or also rotated so that the
#: body faces +x (``parts.heading_frame``).
FeatureFrame = Literal["world", "cloud", "body"]
#: A region with fewer points counts as unobserved: its statistics would be those of stray pixels.
MIN_POINTS = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Features:
    """A cloud's feature vector and the frame it is in: ``point_feature = rotation @ (point_world - origin_world)``.

    ``values`` is region-major and NaN for unobserved regions. ``counts`` are the points of each region and
    ``mean_weights`` their mean label probability, 0 where there are none.
    """

    values: Float32[ndarray, "1032"]
    origin_world: Float[ndarray, "3"]
    rotation: Float[ndarray, "3 3"]
    counts: Int[ndarray, "43"]
    mean_weights: Float[ndarray, "43"]

    def to_world(self, points_feature: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
        """Points of the feature frame in the world, metres."""
        return points_feature @ self.rotation + self.origin_world

    def from_world(self, points_world: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
        """World points in the feature frame, metres: the targets that a regressor learns."""
        return (points_world - self.origin_world) @ self.rotation.T


def cloud_features(
    cloud: LabelledCloud, up: str = "z", frame: FeatureFrame = "cloud", min_points: int = MIN_POINTS
) -> Features:
    """Statistics of each region of a labelled cloud, in metres and square metres.

    The frame is the world rotated Z-up: as it is ("world", the paper's form); centred on the median of all points along
    each axis, so that the person's position makes no difference ("cloud"); or also rotated so that the body faces +x,
    so that the person's direction makes none either ("body"). Covariances are divided by n. Label probabilities do not
    weight the statistics.

    Args:
        up: the world's up axis, ``"z"``, ``"y"`` or ``"-y"``.
        frame: "body" requires a cloud with cameras.
        min_points: regions with fewer points are NaN.

    Raises:
        InputError: for another ``up``, ``min_points`` below 1, a label outside 1–43, a point that is not finite, or a
            cloud without cameras where the frame is the body's.
    """
    if min_points < 1:
        raise InputError(f"min_points must be at least 1, not {min_points}")
    try:
        rotation = z_up_from(up)
    except ValueError as error:
        raise InputError(str(error)) from None
    if frame == "body":
        rotation = heading_frame(part_statistics(cloud, up)).rotation @ rotation
    by_region, starts, weight_sums, bad = sort_by_region(
        np.ascontiguousarray(cloud.points_world),
        np.ascontiguousarray(cloud.labels),
        np.ascontiguousarray(cloud.weights),
        rotation,
        REGION_COUNT,
    )
    if bad:
        raise InputError(f"{bad} of {len(cloud)} points have a label outside 1–{REGION_COUNT} or are not finite")
    statistics, centre = region_statistics(by_region, starts, min_points)
    if frame == "world":
        centre = np.zeros(3)

    values = np.full((REGION_COUNT, FEATURES_PER_REGION), np.nan, np.float32)
    observed = ~np.isnan(statistics[:, 0])
    median, low, high, covariance = np.split(statistics[observed], [3, 6, 9], axis=1)
    values[observed] = np.concatenate(
        [
            median - centre,
            covariance,
            # Rounding may make the variance of a flat region slightly negative.
            np.linalg.eigvalsh(covariance.reshape(-1, 3, 3)).clip(0),
            np.sqrt(covariance[:, [0, 4, 8]]),
            low - centre,
            high - centre,
        ],
        axis=1,
    )
    counts = np.diff(starts)
    return Features(values.ravel(), rotation.T @ centre, rotation, counts, weight_sums / np.maximum(counts, 1))
