"""The recording of what cameras deliver."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from depthmocap.cameras.source import DepthFrame
from depthmocap.geometry import DepthCamera
from depthmocap.recordings.mcap_writer import SHARED_CLOCK, McapWriter


def not_recorded(frame: DepthFrame) -> str:
    """The line for a frame that ``write`` refused as unfit."""
    return f"camera {frame.camera!r}: a frame of another size, or of an impossible time, is not recorded"


class McapRecorder:
    """Frames into an MCAP file, with the host's time of day. Cameras that come later than the file are added to it."""

    def __init__(self, writer: McapWriter, camera: Callable[[str], DepthCamera | None]) -> None:
        """``camera`` gives the one of a name, once it was opened; see ``Readers.camera``."""
        self._writer, self._camera = writer, camera
        self._adding = threading.Lock()
        self._day_ns = time.time_ns() - time.monotonic_ns()

    def write(self, frame: DepthFrame) -> None:
        """Add a frame, from any thread.

        Raises:
            UnfitFrameError: when its camera is not known, it is not of that one's size, or of a time that the file
                cannot tell.
            InputError: when the file cannot be written any further.
        """
        if frame.camera not in self._writer.rig.names:
            with self._adding:
                camera = self._camera(frame.camera)
                if camera is not None and frame.camera not in self._writer.rig.names:
                    self._writer.add_camera(camera)
        arrival_ns = frame.timestamp_ns if frame.clock == SHARED_CLOCK else frame.arrival_ns + self._day_ns
        self._writer.write(frame.camera, frame.timestamp_ns, frame.raw, arrival_ns, frame.clock)
