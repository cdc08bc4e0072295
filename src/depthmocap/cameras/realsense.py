"""Intel RealSense depth cameras, and the files that their SDK's viewer records, through ``pyrealsense2``.

The depth sensor is opened directly, without the SDK's pipeline. So depth never waits for other streams, and tests can
use the SDK's ``software_device`` in place of a camera. Timestamps are by the camera's own clock, or by the host's clock
where the SDK converts them (``global_time``).
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import time
from pathlib import Path
from typing import Any

import numpy as np

from depthmocap.cameras.modes import Mode, ModeRequest
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.sdk import CameraMake, checked
from depthmocap.cameras.sdk_files import sdk_of
from depthmocap.cameras.source import CameraError, ConnectedCamera, DepthFrame, DepthSource, FrameTimeoutError
from depthmocap.geometry import DepthCamera

MAKE = CameraMake(
    "realsense", "RealSense camera", "pyrealsense2", "pyrealsense2",
    lambda usb: usb.vendor == 0x8086 and "realsense" in usb.name.lower(), usb3=True,
)  # fmt: skip
#: Frames that the SDK may keep for reading.
_QUEUE_FRAMES = 4
#: Name endings of the recordings of the SDK's viewer.
RECORDED = (".bag", ".db3")


def _info(rs: Any, device: Any, field: str) -> str:
    item = getattr(rs.camera_info, field)
    return device.get_info(item) if device.supports(item) else ""


@functools.cache
def _context() -> Any:
    """The SDK's context, kept for as long as the process runs: closing one makes the SDK write usage statistics into
    the user's home folder, and no option prevents that."""
    context = MAKE.load().context()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(context))  # so that Python does not close it when it exits
    return context


def find_cameras() -> list[ConnectedCamera]:
    """The connected cameras."""
    rs = MAKE.load()
    devices = list(_context().query_devices())
    return MAKE.list_cameras([(_info(rs, device, "serial_number"), _info(rs, device, "name")) for device in devices])


def make_source(name: str, address: str, request: ModeRequest) -> DepthSource:
    """The camera with this serial number, a file that the SDK recorded, or the first camera if ``address`` is empty."""
    return RealSenseCamera(name, address, request)


class RealSenseCamera(DepthSource):
    """One RealSense camera's depth, with the profile nearest to the requested size and rate. A file plays at its own
    speed."""

    def __init__(self, name: str, address: str = "", request: ModeRequest | None = None, device: Any = None) -> None:
        """``address``: a serial number or a file. ``device``, if given, is used instead of searching for one."""
        super().__init__(name)
        self._file = Path(address) if address.lower().endswith(RECORDED) else None
        self._serial = "" if self._file else address
        self._request, self._device = request or ModeRequest(), device
        self.reopens = self._file is None
        self._early: DepthFrame | None = None

    def _open(self) -> DepthCamera:
        rs = self._sdk = MAKE.load()
        self._playback_clock, self._early = PlaybackClock(1.0), None  # which begins with the first frame
        if self._file is not None:
            device = self._playback = self._open_file(self._file)
        else:
            device = self._device if self._device is not None else self._find(rs)
        usb = _info(rs, device, "usb_type_descriptor")
        if usb.startswith("2") and self._file is None:
            raise CameraError(f"camera {self.name!r} is connected by USB {usb}: use a USB 3 port and cable")
        self._serial = _info(rs, device, "serial_number")
        sensor = device.first_depth_sensor()
        profiles = [
            profile.as_video_stream_profile()
            for profile in sensor.get_stream_profiles()
            if profile.stream_type() == rs.stream.depth and profile.format() == rs.format.z16
        ]
        if not profiles:
            raise CameraError(f"camera {self.name!r} has no 16-bit depth stream")
        modes = [Mode(profile.width(), profile.height(), profile.fps()) for profile in profiles]
        profile = profiles[self._request.choose(self.name, modes)]
        self._queue = rs.frame_queue(_QUEUE_FRAMES)
        try:
            sensor.open(profile)
            sensor.start(self._queue)
        except RuntimeError as error:
            raise MAKE.start_error(self.name, error, self._serial) from None
        self._sensor = sensor
        try:
            return self._describe(rs, profile.get_intrinsics())
        except CameraError:
            self._close()
            raise

    def _describe(self, rs: Any, lens: Any) -> DepthCamera:
        if lens.model not in (rs.distortion.none, rs.distortion.brown_conrady) and any(lens.coeffs):
            raise CameraError(f"camera {self.name!r} has the lens model {lens.model}: expected Brown-Conrady")
        k1, k2, p1, p2, k3 = lens.coeffs
        return checked(DepthCamera(
            self.name, lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy,
            distortion=(k1, k2, p1, p2, k3), depth_unit_m=float(self._sensor.get_option(rs.option.depth_units)),
        ))  # fmt: skip

    def _open_file(self, file: Path) -> Any:
        if sdk_of(file) == "orbbec":
            raise CameraError(f"{file} was recorded by an Orbbec camera: name it orbbec:{file}")
        try:
            playback = _context().load_device(str(file))
            playback.set_real_time(False)  # in real time the SDK drops frames; so it waits until each is taken
            return playback
        except RuntimeError as error:
            raise CameraError(f"{file} is no recording of a RealSense camera ({error})") from None

    def _file_ended(self) -> bool:
        """Whether the file was played to its end."""
        if self._file is None:
            return False
        return bool(self._playback.current_status() == self._sdk.playback_status.stopped)

    def _find(self, rs: Any) -> Any:
        devices = list(_context().query_devices())
        return devices[MAKE.choose([_info(rs, device, "serial_number") for device in devices], self._serial)]

    def _read(self, timeout_s: float) -> DepthFrame | None:
        frame, self._early = self._early or self._next(timeout_s), None
        if frame is not None and self._file is not None:
            if not self._playback_clock.wait(frame.timestamp_ns, timeout_s):
                self._early = frame
                raise FrameTimeoutError(f"camera {self.name!r}: the next frame is not due yet")
            frame = dataclasses.replace(frame, arrival_ns=time.monotonic_ns())
        return frame

    def _next(self, timeout_s: float) -> DepthFrame | None:
        """The SDK's next frame; None at the end of a file."""
        ended = self._file_ended()  # asked first: frames may still wait after the file has ended
        arrived, frame = self._queue.try_wait_for_frame(max(1, round(timeout_s * 1e3)))
        arrival_ns = time.monotonic_ns()
        if not arrived:
            if ended:
                return None
            raise self._frame_timeout(timeout_s)
        domain = frame.frame_timestamp_domain.name
        clock = f"realsense {self._serial} {domain}" if domain == "hardware_clock" else f"host {domain}"
        raw = np.array(frame.as_depth_frame().get_data(), np.uint16)  # a copy: the SDK reuses its buffers
        # The SDK gives milliseconds as a float, which is exact to a microsecond for thousands of years.
        timestamp_ns = round(frame.get_timestamp() * 1e3) * 1000
        return DepthFrame(self.name, raw, timestamp_ns, clock, arrival_ns, frame.frame_number)

    def _close(self) -> None:
        self._sensor.stop()
        self._sensor.close()
