"""Intel RealSense depth cameras through ``pyrealsense2``.

The depth sensor is opened by itself, without the SDK's pipeline: nothing is queued behind other streams, and the SDK's
``software_device`` serves in place of a camera in the tests. Timestamps are by the camera's own clock, or by the
host's where the SDK translates them (``global_time``).
"""

from __future__ import annotations

import ctypes
import functools
import time
from typing import Any

import numpy as np

from depthmocap.cameras.modes import Mode, Wanted
from depthmocap.cameras.sdk import Make, checked
from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FoundCamera, NoFrame
from depthmocap.geometry import DepthCamera

MAKE = Make(
    "realsense", "RealSense camera", "pyrealsense2", "pyrealsense2",
    lambda usb: usb.vendor == 0x8086 and "realsense" in usb.name.lower(), usb3=True,
)  # fmt: skip
_QUEUE = 4


def _info(rs: Any, device: Any, what: str) -> str:
    item = getattr(rs.camera_info, what)
    return device.get_info(item) if device.supports(item) else ""


@functools.cache
def _context() -> Any:
    """The SDK's context, one for as long as the process runs: when one is closed, the SDK writes statistics of use into
    the user's home folder, and has no switch for that."""
    context = MAKE.load().context()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(context))  # so that Python does not close it at its own end, either
    return context


def find() -> list[FoundCamera]:
    """The connected cameras."""
    rs = MAKE.load()
    devices = list(_context().query_devices())
    return MAKE.found([(_info(rs, device, "serial_number"), _info(rs, device, "name")) for device in devices])


def make(name: str, address: str, wanted: Wanted) -> DepthSource:
    """The camera with this serial number, or the first."""
    return RealSenseCamera(name, address, wanted)


class RealSenseCamera(DepthSource):
    """One RealSense camera's depth, at the profile nearest to the wanted size and rate."""

    def __init__(self, name: str, serial: str = "", wanted: Wanted | None = None, device: Any = None) -> None:
        """``device`` is used instead of looking for one."""
        super().__init__(name)
        self._serial, self._wanted, self._device = serial, wanted or Wanted(), device

    def _open(self) -> DepthCamera:
        rs = MAKE.load()
        device = self._device if self._device is not None else self._find(rs)
        usb = _info(rs, device, "usb_type_descriptor")
        if usb.startswith("2"):
            raise CameraError(f"camera {self.name!r} is connected by USB {usb}: use a USB 3 port and cable")
        self._serial = _info(rs, device, "serial_number")
        sensor = device.first_depth_sensor()
        profiles = [
            each.as_video_stream_profile()
            for each in sensor.get_stream_profiles()
            if each.stream_type() == rs.stream.depth and each.format() == rs.format.z16
        ]
        if not profiles:
            raise CameraError(f"camera {self.name!r} has no 16-bit depth stream")
        modes = [Mode(each.width(), each.height(), each.fps()) for each in profiles]
        profile = profiles[self._wanted.choose(self.name, modes)]
        self._queue = rs.frame_queue(_QUEUE)
        try:
            sensor.open(profile)
            sensor.start(self._queue)
        except RuntimeError as error:
            raise MAKE.failed(self.name, error, self._serial) from None
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

    def _find(self, rs: Any) -> Any:
        devices = list(_context().query_devices())
        return devices[MAKE.choose([_info(rs, device, "serial_number") for device in devices], self._serial)]

    def _read(self, timeout_s: float) -> DepthFrame | None:
        came, frame = self._queue.try_wait_for_frame(max(1, round(timeout_s * 1e3)))
        arrival_ns = time.monotonic_ns()
        if not came:
            raise NoFrame(f"camera {self.name!r} gave no frame for {timeout_s:.1f} s: is it still connected?")
        domain = frame.frame_timestamp_domain.name
        clock = f"realsense {self._serial} {domain}" if domain == "hardware_clock" else f"host {domain}"
        raw = np.array(frame.as_depth_frame().get_data(), np.uint16)  # a copy: the SDK reuses its buffers
        # Milliseconds as a float: exact to a microsecond for thousands of years of a hardware clock.
        stamp_ns = round(frame.get_timestamp() * 1e3) * 1000
        return DepthFrame(self.name, raw, stamp_ns, clock, arrival_ns, frame.frame_number)

    def _close(self) -> None:
        self._sensor.stop()
        self._sensor.close()
