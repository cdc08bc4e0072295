"""The recording of what cameras deliver."""

from __future__ import annotations

import time
from collections.abc import Mapping

from depthmocap.capture.mcap_writer import SHARED_CLOCK, McapWriter
from depthmocap.capture.source import DepthFrame
from depthmocap.geometry import DepthCamera


class McapRecorder:
    """Frames into an MCAP file, with the host's time of day. Cameras that come later than the file are added to it."""

    def __init__(self, writer: McapWriter, cameras: Mapping[str, DepthCamera]) -> None:
        """``cameras``: those that were opened so far, by name; it may grow, or be empty where none comes later."""
        self._writer, self._cameras = writer, cameras
        self._day_ns = time.time_ns() - time.monotonic_ns()

    def write(self, frame: DepthFrame) -> None:
        """Add a frame, from any thread.

        Raises:
            UnfitFrameError: when its camera is not known, it is not of that one's size, or of a time that the file
                cannot tell.
            InputError: when the file cannot be written any further.
        """
        if frame.camera in self._cameras and frame.camera not in self._writer.rig.names:
            self._writer.add_camera(self._cameras[frame.camera])
        arrival_ns = frame.timestamp_ns if frame.clock == SHARED_CLOCK else frame.arrival_ns + self._day_ns
        self._writer.write(frame.camera, frame.timestamp_ns, frame.raw, arrival_ns, frame.clock)
