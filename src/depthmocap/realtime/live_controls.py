"""What may be changed in a capture while it runs, from any thread."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import cast

from depthmocap.core.network_devices import networks_on
from depthmocap.errors import InputError
from depthmocap.exporting.edits import LONGEST_NAME, TakeMarker
from depthmocap.frames import Pose
from depthmocap.geometry import save_rig
from depthmocap.offline.pipeline import Pipeline
from depthmocap.offline.pipeline_settings import PipelineSettings
from depthmocap.realtime.live_capture import BackgroundSource, LiveCapture
from depthmocap.realtime.status import CameraStatus
from depthmocap.realtime.take_recording import TakeRecording
from depthmocap.segment.load_segmenter import load_segmenter
from depthmocap.smooth.filters import AUTO, FILTERS, FilterName, load_filter

#: Most people that can be followed from a viewer.
MOST_PEOPLE = 8


class LiveControls:
    """Changes of a running capture; each takes effect before the next set.

    Attributes:
        folder: of recordings that are begun by name.
        markers: that were set, with times on the frames' clock.
        smoothing: the name of the filter, "none" for none.
        people: so many are followed at most.
    """

    def __init__(
        self,
        capture: LiveCapture,
        settings: PipelineSettings,
        recording: TakeRecording,
        folder: Path,
        write_held: Callable[[Sequence[Pose], Mapping[int, Sequence[Pose]]], None],
        rig_file: Path | None = None,
    ) -> None:
        """
        Args:
            settings: of the capture's pipeline.
            write_held: takes the poses that a filter has held back, when it is replaced by another: of the person
                followed first, and of everybody.
            rig_file: the rig of the cameras, beside which new ones are written; by default rig.json in ``folder``.
        """
        self._capture, self._settings, self._recording = capture, settings, recording
        self._write_held, self.folder = write_held, folder
        self._rig_file = rig_file or folder / "rig.json"
        self.markers: list[TakeMarker] = []
        self.smoothing: str = AUTO if settings.smooth == "auto" else settings.smooth
        self.people = settings.people

    @property
    def filters(self) -> tuple[str, ...]:
        """Names of filters to choose from."""
        return ("none", *FILTERS)

    def statuses(self) -> Sequence[CameraStatus]:
        """The current status of every camera."""
        return self._capture.statuses()

    def apart_m(self) -> dict[str, float]:
        """How far from the others each camera sees the person (metres)."""
        return self._capture.apart_m()

    @property
    def poses(self) -> int:
        """Sets that became poses so far."""
        return self._capture.statistics.poses

    @property
    def dropped(self) -> int:
        """Sets that were left out because the machine was too slow."""
        return self._capture.dropped

    @property
    def problems(self) -> dict[str, int]:
        """Messages for the user, and how often each occurred."""
        return self._capture.problems

    @property
    def recording(self) -> Path | None:
        """The file that is being recorded; None if none is."""
        return self._recording.path

    def record(self, name: str) -> None:
        """Record into a new file of this name.

        Raises:
            InputError: when that is no name of a file, or it cannot be written.
        """
        self._recording.begin_named(self.folder, name)

    def stop_recording(self) -> None:
        """Finish the file; the capture goes on."""
        self._recording.end()

    def smooth(self, name: str) -> None:
        """Smooth by another filter, or by none.

        Raises:
            InputError: when there is no such filter.
        """
        if name not in self.filters:
            raise InputError(f"there is no filter {name!r}: there are {', '.join(self.filters)}")
        settings = self._settings
        bridge_s = settings.bridge_s if name in ("kalman", "fixed-lag") else 0.0
        smoothing = None
        if name != "none":
            smoothing = load_filter(cast(FilterName, name), settings.lag_frames, bridge_s, settings.bones)

        def change(pipeline: Pipeline) -> None:
            self._write_held(pipeline.finish(), pipeline.finish_people())
            pipeline.change_smoothing(smoothing)
            self.smoothing = name

        self._change(change)

    def follow(self, people: int) -> None:
        """Follow up to so many people.

        Raises:
            InputError: when that is no number of people.
        """
        if not 1 <= people <= MOST_PEOPLE:
            raise InputError(f"from 1 to {MOST_PEOPLE} people can be followed, not {people}")

        def change(pipeline: Pipeline) -> None:
            pipeline.segment.people = self.people = people

        self._change(change)

    def learn_background(self) -> None:
        """Learn the empty scene anew; people are looked for anew, too, and their numbers begin at 1."""
        chosen, rig = self._settings, self._capture.rig
        with networks_on(chosen.device):
            segmenter = load_segmenter(
                BackgroundSource(rig, {}), chosen.segment, self.people, chosen.choice_in(rig.area_m)
            )

        def change(pipeline: Pipeline) -> None:
            segmenter.people = self.people
            pipeline.segment = segmenter

        self._change(change)

    @property
    def moved(self) -> tuple[str, ...]:
        """Cameras that were moved while it ran and not placed anew, the last one first."""
        return self._capture.moved

    def place_anew(self, name: str) -> str:
        """Place a camera by the joints of the last minute, go on with it, and write the rig into a new file beside
        the one that it has; gives a line about it. The empty scenes are learnt anew.

        Raises:
            InputError: when it cannot be told where the camera stands, or the file cannot be written.
        """
        placed = self._capture.find_place(name)
        rig = self._capture.rig
        cameras = (placed.camera if camera.name == name else camera for camera in rig.cameras)
        path = _beside(self._rig_file)
        save_rig(dataclasses.replace(rig, cameras=tuple(cameras)), path)
        self._capture.place(placed.camera)
        self.learn_background()
        recorded = "" if self.recording is None else f"; {self.recording} keeps the old pose: run it with --rig {path}"
        return f"{placed}; written to {path}{recorded}"

    def mark(self, text: str, timestamp_ns: int | None = None) -> None:
        """Set a marker, which goes to the streams and into the result.

        Args:
            timestamp_ns: its time on the frames' clock, by default now.
        """
        stamp = time.monotonic_ns() if timestamp_ns is None else timestamp_ns
        self.markers.append(TakeMarker(stamp, text[:LONGEST_NAME]))
        self._capture.mark(text[:LONGEST_NAME])

    def stop(self) -> None:
        """End the capture."""
        self._capture.stop()

    def _change(self, change: Callable[[Pipeline], None]) -> None:
        def call() -> None:
            if self._capture.pipeline is not None:
                change(self._capture.pipeline)

        self._capture.before_next_set(call)


def _beside(path: Path) -> Path:
    """A name in a row that no file has: rig-2.json for rig.json."""
    numbered = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in itertools.count(2))
    return next(other for other in numbered if not other.exists())
