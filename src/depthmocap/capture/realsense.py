"""Intel RealSense depth cameras through ``pyrealsense2``.

The depth sensor is opened by itself, without the SDK's pipeline: nothing is queued behind other streams, and the SDK's
``software_device`` serves in place of a camera in the tests. Timestamps are by the camera's own clock, or by the
host's where the SDK translates them (``global_time``).
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from depthmocap.capture.source import CameraError, DepthFrame, DepthSource, FoundCamera, NoFrame
from depthmocap.errors import missing_extra
from depthmocap.geometry import DepthCamera

_QUEUE = 4


def load_sdk() -> Any:
    """The SDK. Raises InputError when it is not installed."""
    try:
        import pyrealsense2
    except ImportError:
        raise missing_extra("pyrealsense2", "realsense") from None
    return pyrealsense2


def _info(rs: Any, device: Any, what: str) -> str:
    item = getattr(rs.camera_info, what)
    return device.get_info(item) if device.supports(item) else ""


def _problem(rs: Any, device: Any) -> str:
    usb = _info(rs, device, "usb_type_descriptor")
    if usb.startswith("2"):
        return f"connected by USB {usb}: use a USB 3 port and cable"
    return ""


def find() -> list[FoundCamera]:
    """The connected cameras."""
    rs = load_sdk()
    found = []
    for device in rs.context().query_devices():
        serial = _info(rs, device, "serial_number")
        found.append(FoundCamera(f"realsense:{serial}", _info(rs, device, "name"), serial, _problem(rs, device)))
    return found


def make(name: str, address: str) -> DepthSource:
    """The camera with this serial number, or the first."""
    return RealSenseCamera(name, address)


class RealSenseCamera(DepthSource):
    """One RealSense camera's depth, at the profile nearest to the wanted size and rate."""

    def __init__(
        self, name: str, serial: str = "", size: tuple[int, int] = (640, 480), rate: int = 30, device: Any = None
    ) -> None:
        """``size`` is (width, height). ``device`` is used instead of looking for one."""
        super().__init__(name)
        self._serial, self._size, self._rate, self._device = serial, size, rate, device

    def _open(self) -> DepthCamera:
        rs = load_sdk()
        device = self._device if self._device is not None else self._find(rs)
        if problem := _problem(rs, device):
            raise CameraError(f"camera {self.name!r} is {problem}")
        self._serial = _info(rs, device, "serial_number")
        sensor = device.first_depth_sensor()
        profiles = [
            each.as_video_stream_profile()
            for each in sensor.get_stream_profiles()
            if each.stream_type() == rs.stream.depth and each.format() == rs.format.z16
        ]
        if not profiles:
            raise CameraError(f"camera {self.name!r} has no 16-bit depth stream")

        def distance(profile: Any) -> tuple[int, int]:
            off = abs(profile.width() - self._size[0]) + abs(profile.height() - self._size[1])
            return off, abs(profile.fps() - self._rate)

        profile = min(profiles, key=distance)
        self._queue = rs.frame_queue(_QUEUE)
        try:
            sensor.open(profile)
            sensor.start(self._queue)
        except RuntimeError as error:
            raise CameraError(_told(self.name, str(error))) from None
        self._sensor = sensor
        lens = profile.get_intrinsics()
        if lens.model not in (rs.distortion.none, rs.distortion.brown_conrady) and any(lens.coeffs):
            self._close()
            raise CameraError(f"camera {self.name!r} has the lens model {lens.model}: expected Brown-Conrady")
        k1, k2, p1, p2, k3 = lens.coeffs
        return DepthCamera(
            self.name, lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy,
            distortion=(k1, k2, p1, p2, k3), depth_unit_m=float(sensor.get_option(rs.option.depth_units)),
        )  # fmt: skip

    def _find(self, rs: Any) -> Any:
        devices = list(rs.context().query_devices())
        for device in devices:
            if self._serial in ("", _info(rs, device, "serial_number")):
                return device
        if not devices:
            raise CameraError(
                "no RealSense camera is connected, or this user may not use it: check the cable, and on Linux install "
                "librealsense's udev rules"
            )
        serials = ", ".join(_info(rs, device, "serial_number") for device in devices)
        raise CameraError(f"no RealSense camera has the serial number {self._serial}: connected are {serials}")

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


def _told(name: str, error: str) -> str:
    """The SDK's words for a camera that will not start, with what to do."""
    lower = error.lower()
    if "busy" in lower or "in use" in lower:
        return f"camera {name!r} is in use: close the other program ({error})"
    if "access" in lower or "permission" in lower:
        return f"this user may not use camera {name!r}: install librealsense's udev rules ({error})"
    return f"camera {name!r} cannot be started: {error}"
