"""Segmentation and tracking of people by the network that finds them, in any posture and without an empty scene."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from depthmocap.core.shared_work import SharedWork
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera, transform_points, z_up_from
from depthmocap.kernels.people_votes import grow_people, paint_people
from depthmocap.segment.background import BackgroundModel
from depthmocap.segment.choice import ANYBODY, Choice, Follower
from depthmocap.segment.depth_grid import DepthGrid
from depthmocap.segment.floor import find_floor
from depthmocap.segment.mix_ups import CERTAIN, find_mix_ups
from depthmocap.segment.people_detector import (
    SAMPLE_RAD,
    SURE_LOGIT,
    DetectedPeople,
    PeopleDetector,
    grid_of,
    limits_at,
    person_mask,
)
from depthmocap.segment.people_segmenter import PersonMasks
from depthmocap.segment.person_tracks import PersonTrack, PersonTracker, measure_statures
from depthmocap.segment.tracking_rules import STATURE
from depthmocap.segment.vote_clusters import Votes

#: Neighbouring pixels whose depths differ by less than this (metres) show one surface.
STEP_M = 0.1
#: What continues somebody's surface before the empty scene is theirs, too, if its logit is above this,
GROW_LOGIT = -5.0
#: so far from what the network found (metres): hands and feet, and legs of who is far.
GROW_M = 0.8
#: Somebody is certain to be a person after some sets; so many first sets of a recording are seen before it begins.
_SETS_BEFORE = 8
#: Where the empty scene is known, the network sees the whole picture in one of so many sets, in the others a part.
_WHOLE_EVERY = 15
#: What a camera has shown stands in for what it shows for so long (seconds) at most.
_STANDS_S = 0.15
#: So many points of somebody are looked up in all views.
_POINTS = 80
#: The top of a head is looked for this near to the highest sample (metres).
_HEAD_M = 0.08
#: A view sees somebody if it sees this share of the points.
_LEAST_SEEN = 0.15


class NetworkSegmenter:
    """Finds people by a network and follows them in space.

    Every sample that shows a person votes for the centre of that person's trunk. The votes of all cameras form a
    cluster for each person, which is tracked. With ``background`` each camera's empty scene is learnt, except where
    people are, and sharpens the masks: what lies on it is nobody.

    Attributes:
        people: the most people returned. A person once selected stays selected until they leave; free places go to
            others by ``choice``.
        problems: what makes good masks unlikely, one line each.
    """

    def __init__(
        self,
        backgrounds_m: Mapping[str, Float[ndarray, "_ _"]],
        up: str = "z",
        people: int = 1,
        background: bool = True,
        detector: PeopleDetector | None = None,
        choice: Choice = ANYBODY,
    ) -> None:
        """
        Args:
            backgrounds_m: empty scenes, depth in metres by camera name, 0 where not known; of any of the cameras.
            up: the world's up axis.
            background: whether empty scenes are used and learnt.
            choice: who is followed.
        """
        self.people, self.problems = people, []
        self._detector = detector or PeopleDetector()
        self._follower = Follower(choice, up)
        self._up_axis, self._up = up, z_up_from(up)[2]
        self._floor_from_world: Float[ndarray, "4 4"] | None = None
        self._known = set(backgrounds_m)
        self._backgrounds: dict[str, BackgroundModel] | None = (
            {name: BackgroundModel((m.shape[0], m.shape[1]), m) for name, m in backgrounds_m.items()}
            if background
            else None
        )
        self._grids: dict[str, DepthGrid] = {}
        #: By camera: the foreground limit, and the same at the samples of its grid.
        self._limits: dict[str, tuple[ndarray, ndarray]] = {}
        #: By camera: what its last image showed, and how many of these in a row were seen in part.
        self._last: dict[str, tuple[DetectedPeople, int]] = {}
        #: By camera: whose the pixels of its last image are, and when that was (seconds).
        self._painted: dict[str, tuple[UInt8[ndarray, "_ _"], float]] = {}
        self._work, self._pool = SharedWork(), ThreadPoolExecutor(max_workers=1)
        #: What is learnt of the empty scene from the last set: nobody waits for it before the next one.
        self._learning: list[Future[None]] = []
        self._at_start = PersonTracker()
        self.reset()

    @classmethod
    def for_source(
        cls, source: FrameSource, people: int = 1, background: bool = True, choice: Choice = ANYBODY
    ) -> NetworkSegmenter:
        """A segmenter that knows a source's empty scenes, as far as it has them, and who is there when it begins."""
        empty = {name: source.background(name) for name in source.camera_names} if background else {}
        known = {name: background_m for name, background_m in empty.items() if background_m is not None}
        segmenter = cls(known, source.up, people, background, choice=choice)
        if source.continuous and len(source):
            first = [source[i] for i in range(min(_SETS_BEFORE, len(source)))]
            # Backwards, so that nobody jumps: the set before the first is the second one, seen in a mirror of time.
            for frames in first[:0:-1]:
                mirrored_ns = 2 * first[0].timestamp_ns - frames.timestamp_ns
                segmenter(dataclasses.replace(frames, timestamp_ns=mirrored_ns))
            segmenter._at_start = segmenter._tracker
            segmenter.reset()
        return segmenter

    def reset(self) -> None:
        """Forget everybody but those who are there at a recording's start; what is known of the empty scene is kept."""
        self._tracker = copy.deepcopy(self._at_start)
        self._follower.reset()
        self._last.clear()
        self._painted.clear()

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        """The people in a frame set, those selected first at the front; an empty tuple when nobody is there."""
        return self.find(frames)

    def find(self, frames: FrameSet, left_out: Collection[str] = ()) -> tuple[PersonMasks, ...]:
        """The same, where nobody is looked for in some cameras: what they showed in the set before stands, and so do
        their masks.

        Args:
            left_out: names of the cameras; one that showed nothing just now is looked at all the same.
        """
        views, now_s = frames.views, frames.timestamp_ns * 1e-9
        if not views:
            return ()
        if all(view.mask is not None for view in views):
            masks = tuple(view.mask for view in views if view.mask is not None)
            return (PersonMasks(1, masks),) if any(mask.any() for mask in masks) else ()
        while self._learning:
            self._learning.pop().result()
        depths = [np.ascontiguousarray(view.depth_m, np.float32) for view in views]
        grids = [self._grid(view) for view in views]
        limits = [self._limit(view) for view in views]
        names = [view.camera.name for view in views]
        stands = [
            name in left_out and self._stands(name, grid, depth_m, now_s)
            for name, grid, depth_m in zip(names, grids, depths, strict=True)
        ]
        looked_at = [i for i, stood in enumerate(stands) if not stood]
        found = self._work.map(lambda i: self._detect(views[i], depths[i], grids[i], limits[i]), looked_at)
        by_view = dict(zip(looked_at, found, strict=True))
        detected = [by_view[i] if i in by_view else self._last[name][0] for i, name in enumerate(names)]
        votes = Votes(
            np.concatenate([view.votes for view in detected]),
            np.concatenate([view.points for view in detected]),
            np.concatenate([view.areas_m2 for view in detected]),
            np.concatenate([_certainties(view) for view in detected]),
            np.concatenate([view.before for view in detected]),
        )
        labels = self._tracker.update(votes, now_s, lambda points: probability_in_views(points, detected))
        of_views = np.split(labels, np.cumsum([len(view.indices) for view in detected])[:-1])
        painted = self._work.map(lambda i: _paint(depths[i], detected[i], of_views[i], limits[i]), looked_at)
        self._painted.update({names[i]: (image, now_s) for i, image in zip(looked_at, painted, strict=True)})
        images = [self._painted[name][0] for name in names]
        floor_from_world = self._floor(views)
        measure_statures(
            self._tracker.active, votes, labels, floor_from_world,
            lambda place: is_open(place, detected),
            lambda label, place: highest_near(place, floor_from_world[2, :3], views, images, label),
            now_s,
        )  # fmt: skip
        self._learn(frames.timestamp_ns, [(names[i], depths[i], detected[i]) for i in looked_at])
        mix_ups, people = find_mix_ups(self._tracker.active), []
        for track in self._select([view.camera for view in views]):
            mix_up = mix_ups.get(track.number, CERTAIN)
            masks = tuple(image == track.label for image in images)
            people.append(PersonMasks(track.number, masks, mix_up.others, mix_up.doubt))
        return tuple(people)

    def _grid(self, view: View) -> DepthGrid:
        name = view.camera.name
        if name not in self._grids or self._grids[name].camera is not view.camera:
            self._grids[name] = grid_of(view.camera, self._up)
        return self._grids[name]

    def _floor(self, views: Sequence[View]) -> Float[ndarray, "4 4"]:
        """The floor, found once in the first frame set: people and furniture matter little."""
        if self._floor_from_world is None:
            self._floor_from_world = find_floor(views, self._up_axis)
        return self._floor_from_world

    def _limit(self, view: View) -> Float[ndarray, "h w"] | None:
        """The depth from which on a pixel shows the empty scene, ``FAR_M`` or more where it is unknown."""
        if self._backgrounds is None:
            return None
        name, shape = view.camera.name, view.depth_m.shape
        background = self._backgrounds.get(name)
        if background is None or background.shape != shape:
            background = self._backgrounds[name] = BackgroundModel((shape[0], shape[1]))
        return background.limit_m

    def _detect(
        self, view: View, depth_m: ndarray, grid: DepthGrid, limit_m: Float[ndarray, "h w"] | None
    ) -> DetectedPeople:
        name = view.camera.name
        last, parts = self._last.get(name, (None, 0))
        if last is None or last.grid is not grid or parts >= _WHOLE_EVERY:
            last, parts = None, 0
        limit_at_samples_m = None
        if limit_m is not None:
            if name not in self._limits or self._limits[name][0] is not limit_m:
                self._limits[name] = limit_m, limits_at(grid, limit_m)
            limit_at_samples_m = self._limits[name][1]
        sure = np.inf if name in self._known else SURE_LOGIT
        detected = self._detector(grid, depth_m, limit_at_samples_m, sure, last)
        self._last[name] = detected, parts + 1
        return detected

    def _stands(self, name: str, grid: DepthGrid, depth_m: ndarray, now_s: float) -> bool:
        """Whether what a camera showed last can stand in for what it shows now."""
        if name not in self._last or name not in self._painted:
            return False
        image, painted_s = self._painted[name]
        return self._last[name][0].grid is grid and image.shape == depth_m.shape and 0 < now_s - painted_s < _STANDS_S

    def _learn(self, timestamp_ns: int, looked_at: Sequence[tuple[str, ndarray, DetectedPeople]]) -> None:
        if self._backgrounds is None:
            return
        due = [
            (background, depth_m, people)
            for name, depth_m, people in looked_at
            if (background := self._backgrounds[name]).is_due(timestamp_ns)
        ]
        if due:
            self._learning.append(self._pool.submit(_update_backgrounds, due, timestamp_ns))

    def _select(self, cameras: Sequence[DepthCamera]) -> list[PersonTrack]:
        return self._follower(self._tracker.active, self.people, lambda track: track.centre_m, cameras)


def probability_in_views(points: Float[ndarray, "n 3"], detected: Sequence[DetectedPeople]) -> float:
    """The probability that points show a person, by the mean of the log odds of all views that see them: one view alone
    may err, and one that is sure says more than one that is not.

    Returns:
        0–1; 0 where no view sees the points.
    """
    points = points[:: max(len(points) // _POINTS, 1)]
    log_odds = []
    for view in detected:
        rows, columns, beyond_m = _samples_behind(view, points)
        seen = (rows >= 0) & (np.abs(beyond_m) < STEP_M)
        if np.count_nonzero(seen) >= _LEAST_SEEN * len(points):
            share = float(np.mean(1 / (1 + np.exp(-view.logits[rows[seen], columns[seen]]))))
            log_odds.append(np.log((share + 1e-3) / (1 - share + 1e-3)))
    return float(1 / (1 + np.exp(-np.mean(log_odds)))) if log_odds else 0.0


def is_open(place: Float[ndarray, "3"], detected: Sequence[DetectedPeople]) -> bool:
    """Whether a view from not too far shows that nothing is at a place (metres, in the world) or before it."""
    for view in detected:
        rows, columns, beyond_m = _samples_behind(view, place[None])
        place_m = view.samples_m[rows[0], columns[0]] - beyond_m[0]
        if rows[0] >= 0 and beyond_m[0] > STEP_M and place_m < STATURE.farthest_m:
            return True
    return False


def _samples_behind(
    view: DetectedPeople, points: Float[ndarray, "n 3"]
) -> tuple[Int[ndarray, " n"], Int[ndarray, " n"], Float[ndarray, " n"]]:
    """Rows and columns of the samples that show points (metres, in the world; rows are -1 where none does), and how far
    beyond the points (metres) these are."""
    u, v, z = view.grid.camera.project(points).T
    rows, columns = view.grid.samples_at(np.nan_to_num(np.stack([u, v], 1), nan=-1.0))
    return rows, columns, view.samples_m[rows, columns] - z


def highest_near(
    place: Float[ndarray, "3"],
    up: Float[ndarray, "3"],
    views: Sequence[View],
    images: Sequence[UInt8[ndarray, "_ _"]],
    label: int,
) -> Float[ndarray, "3"]:
    """The highest point of a label's pixels within ``_HEAD_M`` of a place (metres, in the world), or the place."""
    best = place
    for view, image in zip(views, images, strict=True):
        camera = view.camera
        u, v, z = camera.project(place[None])[0]
        if not z > 0 or not np.isfinite(u + v):
            continue
        reach = int(np.ceil(_HEAD_M * camera.fx / z))
        rows = np.s_[max(int(v) - reach, 0) : max(int(v) + reach + 1, 0)]
        columns = np.s_[max(int(u) - reach, 0) : max(int(u) + reach + 1, 0)]
        own = image[rows, columns] == label
        if not own.any():
            continue
        near = own & (np.abs(view.depth_m[rows, columns] - z) < STEP_M)
        if np.count_nonzero(near) < 3:
            continue
        depth_m, rays = view.depth_m[rows, columns][near], camera.rays[rows, columns][near]
        points = transform_points(camera.world_from_camera, np.column_stack([rays * depth_m[:, None], depth_m]))
        heights = points @ up
        top = points[np.argpartition(heights, -3)[-3]]  # single pixels at a rim err
        if top @ up > best @ up:
            best = top
    return best


def _certainties(detected: DetectedPeople) -> Float[ndarray, " n"]:
    return 1 / (1 + np.exp(-detected.logits.ravel()[detected.indices]))


def _paint(
    depth_m: ndarray, detected: DetectedPeople, labels: ndarray, limit_m: Float[ndarray, "h w"] | None
) -> UInt8[ndarray, "h w"]:
    """The label of every pixel."""
    out = np.zeros(depth_m.shape, np.uint8)
    of_samples = np.zeros(detected.samples_m.shape, np.uint8)
    of_samples.reshape(-1)[detected.indices] = labels
    if not of_samples.any():
        return out
    beyond = (detected.logits > SURE_LOGIT).view(np.uint8)
    if limit_m is None:
        limit_m = np.full((1, 1), np.inf, np.float32)
        limit_m = np.broadcast_to(limit_m, depth_m.shape)
    grid = detected.grid
    grow_people(
        detected.samples_m, detected.limit_m, detected.logits, GROW_LOGIT, STEP_M, GROW_M, SAMPLE_RAD, of_samples
    )
    paint_people(
        depth_m, limit_m, grid.row_starts, grid.column_starts, detected.samples_m, of_samples, beyond, STEP_M, out
    )
    return out


def _update_backgrounds(due: Sequence[tuple[BackgroundModel, ndarray, DetectedPeople]], timestamp_ns: int) -> None:
    for background, depth_m, people in due:
        background.update(depth_m, _occupied(people, depth_m.shape), timestamp_ns)


def _occupied(detected: DetectedPeople, shape: tuple[int, int]) -> Bool[ndarray, "h w"]:
    """Pixels near samples that show people, at full resolution."""
    grid, mask = detected.grid, person_mask(detected)
    rows = np.repeat(np.arange(mask.shape[0]), np.diff(grid.row_starts))
    columns = np.repeat(np.arange(mask.shape[1]), np.diff(grid.column_starts))
    return mask[rows][:, columns]
