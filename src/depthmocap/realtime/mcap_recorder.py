"""Records live frames into an MCAP file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from depthmocap.cameras.source import DepthFrame
from depthmocap.geometry import DepthCamera
from depthmocap.recordings.mcap_writer import SHARED_CLOCK, McapWriter


def not_recorded_problem(frame: DepthFrame) -> str:
    """The message for a frame that ``write`` refused as unfit."""
    return f"camera {frame.camera!r}: a frame of another size, or of an impossible time, is not recorded"


class McapRecorder:
    """Writes frames into an MCAP file, with the host's time of day. It adds cameras that are opened later."""

    def __init__(self, writer: McapWriter, camera: Callable[[str], DepthCamera | None]) -> None:
        """``camera`` gives the opened camera of a name, or None, as ``MultiCameraReader.camera`` does."""
        self._writer, self._camera = writer, camera
        self._adding = threading.Lock()
        self._day_ns = time.time_ns() - time.monotonic_ns()

    @staticmethod
    def recorded_ns(frame: DepthFrame, day_ns: int) -> int:
        """When a frame came, as it is recorded; ``day_ns`` added to ``time.monotonic_ns`` gives the time of day."""
        return frame.timestamp_ns if frame.clock == SHARED_CLOCK else frame.arrival_ns + day_ns

    def write(self, frame: DepthFrame) -> None:
        """Add a frame, from any thread.

        Raises:
            UnfitFrameError: when its camera is unknown, or the frame does not have its size, or the file cannot hold
                its time.
            InputError: when the file cannot be written any further.
        """
        if frame.camera not in self._writer.rig.names:
            with self._adding:
                camera = self._camera(frame.camera)
                if camera is not None and frame.camera not in self._writer.rig.names:
                    self._writer.add_camera(camera)
        arrival_ns = self.recorded_ns(frame, self._day_ns)
        self._writer.write(frame.camera, frame.timestamp_ns, frame.raw, arrival_ns, frame.clock)
