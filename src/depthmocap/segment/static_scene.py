"""Segmentation of one person in the view of a static depth camera: the largest body in front of the empty scene.

The empty scene is the source's background frame. Without one it is estimated per pixel, as the far end of all depths of
the recording, because a person who moves covers a pixel only some of the time.
"""

from __future__ import annotations

import collections
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int32
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera
from depthmocap.segment.background import FAR_M, estimate_background, foreground_limit
from depthmocap.text import camera_list

Mode = Literal["auto", "none"]

#: Frames that a background is estimated from, spread over the recording.
SAMPLES = 45
#: Neighbouring pixels whose depths differ by more than this (metres) belong to different surfaces.
DEPTH_STEP_M = 0.15
#: A flying pixel at a silhouette is at least this far behind one surface and in front of another (metres).
FLYING_M = 0.08
#: A candidate pixel with fewer candidates than this in its 3×3 is noise. A majority would erode noisy silhouettes.
FEWEST_TOGETHER = 3
#: Least surface of a person (m²).
SMALLEST_PERSON_M2 = 0.05
#: Larger surfaces (m²) are parts of the room where its depth was unknown.
LARGEST_PERSON_M2 = 3.0
#: Least surface (m²) of a part that occlusion cuts off the body.
SMALLEST_PART_M2 = 0.001
#: Greatest distance (metres) of such a part's centre from the body's bounding box.
PART_REACH_M = 0.6
#: Less surface than this (m²) in most frames suggests that a part of the body never moved: a standing person shows
#: 0.4 m² or more.
FULL_BODY_M2 = 0.2

_BOX = np.ones((3, 3), np.uint8)


class PersonSegmenter:
    """Segments the person in the views of static cameras.

    Mode ``"none"`` takes every pixel with depth for the person: for scenes recorded without a room. In mode ``"auto"``
    the mask is empty where a camera's background is unknown or nobody is in view. A view's own mask is returned as it
    is.

    Attributes:
        backgrounds_m: the empty scenes, given or estimated, by camera.
    """

    def __init__(self, backgrounds_m: Mapping[str, Float[ndarray, "_ _"]], mode: Mode = "auto") -> None:
        """Segment against the given empty scenes: depth in metres by camera name, 0 = unknown."""
        self.mode: Mode = mode
        #: Cameras that rarely show the full body, with the share of the sampled frames in which they do.
        self._full_body_shares: dict[str, float] = {}
        self.backgrounds_m: dict[str, ndarray] = dict(backgrounds_m)
        self._limits = {name: foreground_limit(background_m) for name, background_m in backgrounds_m.items()}

    @classmethod
    def from_recording(cls, source: FrameSource, mode: Mode = "auto") -> PersonSegmenter:
        """Use each camera's background frame; without one, estimate its empty scene from the recording."""
        if mode != "auto":
            return cls({}, mode)
        backgrounds: dict[str, ndarray | None] = {name: source.background(name) for name in source.camera_names}
        samples: dict[str, list[View]] = collections.defaultdict(list)
        if not backgrounds or any(background_m is None for background_m in backgrounds.values()):
            for frame_set in _evenly_spaced(source, SAMPLES):
                for view in frame_set.views:
                    if backgrounds.setdefault(view.camera.name, None) is None and view.mask is None:
                        samples[view.camera.name].append(view)
                if frame_set.views and all(view.mask is not None for view in frame_set.views):
                    break  # a data set with true masks needs no background
        known = {name: background_m for name, background_m in backgrounds.items() if background_m is not None}
        segmenter = cls(known, mode)
        for name, views in samples.items():
            segmenter._estimate(name, views)
        return segmenter

    @property
    def doubtful(self) -> set[str]:
        """Cameras whose estimated empty scene may hold the person, who rarely shows before it."""
        return set(self._full_body_shares)

    def scaled(self, name: str, factor: float) -> PersonSegmenter:
        """The segmenter of one camera for depths that are all larger by a factor."""
        if name not in self.backgrounds_m:
            return self
        return PersonSegmenter({name: self.backgrounds_m[name] * np.float32(factor)}, self.mode)

    def __call__(self, view: View) -> Bool[ndarray, "h w"]:
        """The person's mask; all False when nobody is there.

        Raises:
            InputError: when the view differs in size from its camera's background.
        """
        if view.mask is not None:
            return view.mask
        if self.mode == "none":
            return view.depth_m > 0
        mask = np.zeros(view.depth_m.shape, bool)
        limit_m = self._limits.get(view.camera.name)
        if limit_m is None:
            return mask
        if limit_m.shape != mask.shape:
            raise InputError(f"camera {view.camera.name!r}: view of shape {mask.shape}, background {limit_m.shape}")
        depth_m = view.depth_m.astype(np.float32, copy=False)
        candidate = ((depth_m > 0) & (depth_m < limit_m)).view(np.uint8)
        neighbours = cv2.boxFilter(candidate, -1, (3, 3), normalize=False)
        candidate &= (neighbours >= FEWEST_TOGETHER).view(np.uint8)
        x, y, width, height = cv2.boundingRect(candidate)
        if width == 0:
            return mask
        # The rest needs only the candidates and their neighbours.
        window = np.s_[max(y - 1, 0) : y + height + 1, max(x - 1, 0) : x + width + 1]
        mask[window] = _person(depth_m[window], candidate[window] > 0, view.camera.rays[window], view.camera)
        return mask

    def _estimate(self, name: str, views: Sequence[View]) -> None:
        self.backgrounds_m[name] = estimate_background([view.depth_m for view in views])
        self._limits[name] = foreground_limit(self.backgrounds_m[name])
        pixel = views[0].camera.fx * views[0].camera.fy
        areas = np.array([(view.depth_m[self(view)] ** 2).sum() / pixel for view in views])
        whole = np.count_nonzero(areas > FULL_BODY_M2)
        if 2 * whole < len(views):
            self._full_body_shares[name] = whole / len(views)

    @property
    def problems(self) -> list[str]:
        """What makes good masks unlikely, one line each, with a remedy."""
        if not self._full_body_shares:
            return []
        names, share = camera_list(list(self._full_body_shares)), max(self._full_body_shares.values())
        return [
            f"{names}: a whole person is found in at most {share:.0%} of the sampled frames; if they were there more "
            "often, they hardly moved: take --segment auto, which needs no empty scene, give that scene "
            "(background.png in a recording folder), or take --segment none where there is no room around the person"
        ]


def _evenly_spaced(source: FrameSource, count: int) -> Iterator[FrameSet]:
    """At most ``count`` frame sets, evenly spread over the source."""
    indices = sorted({int(i) for i in np.linspace(0, max(len(source) - 1, 0), count)})[: len(source)]
    return (source[i] for i in indices)


def _person(
    depth_m: Float[ndarray, "h w"],
    candidate: Bool[ndarray, "h w"],
    rays: Float[ndarray, "h w 2"],
    camera: DepthCamera,
) -> Bool[ndarray, "h w"]:
    """The largest body among the candidate pixels, with the parts that belong to it and without flying pixels."""
    nearest = cv2.erode(np.where(depth_m > 0, depth_m, FAR_M), _BOX)
    behind = depth_m - nearest
    candidate = candidate & ((behind < FLYING_M) | (cv2.dilate(depth_m, _BOX) - depth_m < FLYING_M))
    # Without the far side of every depth step, surfaces are separate connected components.
    rim = candidate & (behind > DEPTH_STEP_M)
    solid = candidate & ~rim
    labels = np.empty(solid.shape, np.int32)
    count, _ = cv2.connectedComponents(solid.view(np.uint8), labels, connectivity=8)
    person = _body_labels(labels, count, depth_m, rays, camera)[labels]
    # A rim pixel belongs to the surface whose depth it continues.
    surface = cv2.dilate(np.where(person, depth_m, np.float32(0)), _BOX)
    return person | (rim & (np.abs(surface - depth_m) < DEPTH_STEP_M))


def _body_labels(
    labels: Int32[ndarray, "h w"],
    count: int,
    depth_m: Float[ndarray, "h w"],
    rays: Float[ndarray, "h w 2"],
    camera: DepthCamera,
) -> Bool[ndarray, " labels"]:
    """Which connected components belong to the person; component 0 is the rest of the image."""
    pixels = np.flatnonzero(labels)
    label, z = labels.ravel()[pixels], depth_m.ravel()[pixels]
    points = np.concatenate([rays.reshape(-1, 2)[pixels] * z[:, None], z[:, None]], 1)
    area_m2 = np.bincount(label, z * z, count) / (camera.fx * camera.fy)
    area_m2[area_m2 > LARGEST_PERSON_M2] = 0
    main = int(area_m2.argmax())
    if area_m2[main] < SMALLEST_PERSON_M2:
        return np.zeros(count, bool)
    body = points[label == main]
    centres = np.stack([np.bincount(label, axis, count) for axis in points.T], 1)
    centres /= np.maximum(np.bincount(label, minlength=count), 1)[:, None]
    outside = np.maximum(np.maximum(body.min(0) - centres, centres - body.max(0)), 0)
    chosen = (area_m2 >= SMALLEST_PART_M2) & (np.linalg.norm(outside, axis=1) <= PART_REACH_M)
    chosen[0] = False
    return chosen
