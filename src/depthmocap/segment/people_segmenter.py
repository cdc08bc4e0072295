"""Segmentation and tracking of people: each person's mask in every camera, one frame set after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.core.shared_work import SharedWork
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera, rigid_inverse, transform_points
from depthmocap.kernels.segmentation import paint_labels
from depthmocap.segment.background import BackgroundModel
from depthmocap.segment.blob_divider import BlobDivider
from depthmocap.segment.choice import ANYBODY, Choice, Follower
from depthmocap.segment.floor import find_floor
from depthmocap.segment.occupancy_map import Foreground, OccupancyMap
from depthmocap.segment.static_scene import Mode, PersonSegmenter
from depthmocap.segment.track import Track
from depthmocap.segment.tracking import PeopleTracker
from depthmocap.text import camera_list

#: Pixels in front of an unknown background count this near to a tracked person (metres).
UNCERTAIN_NEAR_PEOPLE_M = 0.6
#: A camera whose place nobody knows, and which sees no floor, is taken to be so high over it (metres).
CAMERA_HEIGHT_M = 1.4
#: Label of columns whose blob several people share: there the divided volume holds the label of each voxel.
_DIVIDED = 255


@dataclasses.dataclass(frozen=True, eq=False)
class PersonMasks:
    """A person in a frame set.

    Attributes:
        number: from 1; it stays the same over time.
        masks: in every view.
        mistakable: numbers of those from whom the person cannot be told apart now.
        doubt: probability that the number is one of theirs.
    """

    number: int
    masks: tuple[Bool[ndarray, "_ _"], ...]
    mistakable: tuple[int, ...] = ()
    doubt: float = 0.0


class PeopleSegmenter:
    """Segments and tracks people in frame sets of static cameras.

    The foreground of all cameras forms blobs in an occupancy map of the floor. Blobs of a body's size are tracked. The
    background model of each camera is learnt and updated all the time, except where people are. Mode ``"none"`` takes
    every pixel with depth for one person. Where all views come with masks, these are returned.

    Attributes:
        people: the most people returned. A person once selected stays selected until they leave; free places go to
            others by ``choice``.
        problems: what makes good masks unlikely, one line each, with a remedy.
    """

    def __init__(
        self,
        backgrounds_m: Mapping[str, Float[ndarray, "_ _"]],
        up: str = "z",
        mode: Mode = "auto",
        people: int = 1,
        problems: Sequence[str] = (),
        choice: Choice = ANYBODY,
    ) -> None:
        """
        Args:
            backgrounds_m: empty scenes, depth in metres by camera name, 0 where not known; of any of the cameras.
            up: the world's up axis.
            choice: who is followed.

        Raises:
            InputError: when ``people`` is less than one.
        """
        if people < 1:
            raise InputError(f"--people must be at least 1, got {people}")
        self.mode: Mode = mode
        self.people, self.problems = people, list(problems)
        self._up = up
        self._follower = Follower(choice, up)
        self._backgrounds = {
            name: BackgroundModel((background_m.shape[0], background_m.shape[1]), background_m)
            for name, background_m in backgrounds_m.items()
        }
        self._work = SharedWork()
        self._map: OccupancyMap | None = None
        self._cameras: dict[str, DepthCamera] = {}
        self._floor_from_world = np.eye(4)
        self.reset()

    @classmethod
    def from_recording(
        cls, source: FrameSource, mode: Mode = "auto", people: int = 1, choice: Choice = ANYBODY
    ) -> PeopleSegmenter:
        """Use the empty scenes of a recording; those that it lacks are estimated from its frames."""
        static_scene = PersonSegmenter.from_recording(source, mode)
        problems = [*static_scene.problems]
        unknown = [name for name in source.camera_names if name not in static_scene.backgrounds_m]
        if mode == "auto" and unknown and not len(source):  # live
            problems.append(
                f"{camera_list(unknown)}: the empty scene is not known and is learnt on the run, and with --segment "
                "background who is there from the start and hardly moves becomes a part of it: leave the view for some "
                "seconds, or take --segment auto"
            )
        return cls(static_scene.backgrounds_m, source.up, mode, people, problems, choice)

    def reset(self) -> None:
        """Forget all tracks; background models are kept."""
        self._tracker, self._divider = PeopleTracker(), BlobDivider()
        self._follower.reset()

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        """The people in a frame set, those selected first at the front; an empty tuple when nobody is there.

        Raises:
            InputError: when a view differs in size from its camera's background.
        """
        views = frames.views
        if not views:
            return ()
        if self.mode == "none" or all(view.mask is not None for view in views):
            masks = tuple(view.depth_m > 0 if view.mask is None else view.mask for view in views)
            return (PersonMasks(1, masks),) if any(mask.any() for mask in masks) else ()
        depths = [np.ascontiguousarray(view.depth_m, np.float32) for view in views]
        backgrounds = [self._background(view) for view in views]
        occupancy = self._map_for(views)

        def segment(view: View, depth_m: ndarray, background: BackgroundModel) -> Foreground:
            return occupancy.foreground(view.camera, depth_m, background.limit_m, not background.learning)

        foregrounds = self._work.map(segment, views, depths, backgrounds)
        foregrounds, labels = self._track(occupancy, foregrounds, views, frames.timestamp_ns * 1e-9)

        def label(view: Foreground, background: BackgroundModel) -> UInt8[ndarray, "h w"]:
            image = np.zeros(view.depth_m.shape, np.uint8)
            paint_labels(view.pixels, view.columns, view.levels, labels, self._divider.volume, image.reshape(-1))
            if background.is_due(frames.timestamp_ns):
                background.update(view.depth_m, self._people_mask(image), frames.timestamp_ns)
            return image

        images = self._work.map(label, foregrounds, backgrounds)
        return tuple(
            PersonMasks(track.number, tuple(image == track.label for image in images)) for track in self._select()
        )

    def _track(
        self, occupancy: OccupancyMap, foregrounds: Sequence[Foreground], views: Sequence[View], now_s: float
    ) -> tuple[list[Foreground], UInt8[ndarray, " columns"]]:
        """Update the tracks; the foreground that counts, and the track's label of each column (``_DIVIDED`` where
        several people share its blob)."""
        near = occupancy.columns_near(self._tracker.predict(now_s), UNCERTAIN_NEAR_PEOPLE_M)
        foregrounds = [view.without_uncertain(near) for view in foregrounds]
        blobs = occupancy.blobs(foregrounds)
        labels, shared = self._tracker.assign(blobs, now_s)
        measured = self._divider.divide(occupancy, blobs, foregrounds, self._tracker.active, shared)

        def is_visible(position_m: Float[ndarray, "2"], height_m: float) -> bool:
            return occupancy.is_visible(views, position_m, height_m)

        learning = not any(view.trusted for view in foregrounds)
        self._tracker.update(labels, blobs, measured, learning, is_visible, now_s)
        label_of_blob = np.concatenate([[0], labels]).astype(np.uint8)
        label_of_blob[[blob.index + 1 for blob in shared]] = _DIVIDED
        label_of_column = label_of_blob[blobs.labels.ravel()]
        self._divider.remember(occupancy, foregrounds, label_of_column, self._tracker.active)
        return foregrounds, label_of_column

    def _background(self, view: View) -> BackgroundModel:
        name, shape = view.camera.name, view.depth_m.shape
        if name not in self._backgrounds:
            self._backgrounds[name] = BackgroundModel((shape[0], shape[1]))
        background = self._backgrounds[name]
        if background.shape != shape:
            raise InputError(f"camera {name!r}: view of shape {shape}, background {background.shape}")
        return background

    def _map_for(self, views: Sequence[View]) -> OccupancyMap:
        """The occupancy map of all cameras so far; the floor is estimated once, from the first frame set."""
        if self._map is not None and all(view.camera.name in self._cameras for view in views):
            return self._map
        previous = self._map
        if previous is None:
            empty = [self._empty_view(view) for view in views]
            if len(views) == 1 and np.array_equal(views[0].camera.world_from_camera, np.eye(4)):
                # Nobody knows where it stands: it is taken to be upright.
                self._floor_from_world = find_floor(empty, "-y", -CAMERA_HEIGHT_M)
            else:
                self._floor_from_world = find_floor(empty, self._up)
        self._cameras |= {view.camera.name: view.camera for view in views}
        self._map = OccupancyMap(list(self._cameras.values()), self._floor_from_world)
        if previous is not None:
            self._tracker.shift((self._map.map_from_world - previous.map_from_world)[:2, 3])
            self._divider = BlobDivider()
        return self._map

    def _empty_view(self, view: View) -> View:
        """The known depth of the empty scene, and the view's depth where it is unknown."""
        background_m = self._backgrounds[view.camera.name].background_m
        return View(view.camera, np.where(background_m > 0, background_m, view.depth_m).astype(np.float32))

    def _people_mask(self, label_image: UInt8[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
        """The pixels of all tracks that are known to be people."""
        person = np.zeros(256, np.bool_)
        person[[track.label for track in self._tracker.active if track.number]] = True
        return person[label_image]

    def _select(self) -> list[Track]:
        assert self._map is not None
        world_from_map = rigid_inverse(self._map.map_from_world)

        def point(track: Track) -> Float[ndarray, "3"]:
            return transform_points(world_from_map, np.array([*track.position_m, 0.0]))

        return self._follower(self._tracker.active, self.people, point, list(self._cameras.values()))
