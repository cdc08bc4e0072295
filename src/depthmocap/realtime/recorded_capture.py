"""Motion capture of a recording as if it were live, as fast as the machine can."""

from __future__ import annotations

import time
from collections.abc import Iterator

from depthmocap.calibration.rig_watch import RigWatch
from depthmocap.geometry import DepthCamera
from depthmocap.offline.pipeline import mix_up_lines
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.realtime.ingest import FrameIngest, frame_set, recorded_frames
from depthmocap.realtime.live_capture import LivePose, PipelineMaker, count_pose
from depthmocap.realtime.status import CameraStatus, RunStatistics, camera_statuses
from depthmocap.realtime.sync import SyncSettings
from depthmocap.recordings.recording import Recording


class RecordedCapture:
    """Runs a recording through the same stages as fast as the machine can; no set is left out.

    It is used like a :class:`LiveCapture`. The latency is the time that the pipeline takes.
    """

    dropped = labelled_in_part = sets_before_ready = recorded_minus_timestamp_ns = 0

    def __init__(
        self,
        recording: Recording,
        sync: SyncSettings | None = None,
        make_pipeline: PipelineMaker = load_pipeline,
    ) -> None:
        """``make_pipeline`` is called with the recording, which has its backgrounds."""
        self.pipeline = make_pipeline(recording)
        self.ingest = FrameIngest(sync or SyncSettings(rate_hz=1e9 / recording.period_ns))
        self.statistics, self.up, self.area_m = RunStatistics(), recording.up, recording.area_m
        self._rig_watch = RigWatch(self.up, explain=True)
        self._recording, self._now_ns = recording, 0
        for camera in recording.rig.cameras:
            if recording.stamps(camera.name):
                self.ingest.add_camera(camera)
        self.ingest.problems.update([*recording.problems, *self.pipeline.segment.problems])

    @property
    def cameras(self) -> dict[str, DepthCamera]:
        """The cameras of the recording that have frames, by name."""
        return dict(self.ingest.cameras)

    def __enter__(self) -> RecordedCapture:
        return self

    def __exit__(self, *failure: object) -> None:
        """Do nothing: no camera is open."""

    @property
    def problems(self) -> dict[str, int]:
        """Messages for the user, one line each, and how often each occurred."""
        return self.ingest.problems.counts()

    def apart_m(self) -> dict[str, float]:
        """How far apart the cameras see the person (metres), by the extrinsics check."""
        return self._rig_watch.distances_m()

    def statuses(self) -> list[CameraStatus]:
        """The current status of every camera."""
        return camera_statuses(self.ingest, dict.fromkeys(self.ingest.cameras, "running"), self._now_ns)

    def __iter__(self) -> Iterator[LivePose]:
        for synced in self.ingest.run(recorded_frames(self._recording, self.ingest.problems)):
            self._now_ns = synced.timestamp_ns
            start_s = time.perf_counter()
            frames = frame_set(synced, self.ingest.cameras)
            result = self.pipeline(frames)
            latency_ms = (time.perf_counter() - start_s) * 1e3
            self.ingest.problems.update([*self._rig_watch(frames, result.cloud), *mix_up_lines(result)])
            yield count_pose(self.statistics, LivePose(result.pose, synced, result, latency_ms))
        self.ingest.problems.update(self._rig_watch.finish())
