"""Kinect 2 through libfreenect2 and its package ``freenect2``.

Written from the sources of both; untested on hardware. libfreenect2 gives pictures as in a mirror; here they are
turned back. Timestamps are by the camera's own clock, which counts in eighths of a millisecond.
"""

from __future__ import annotations

import functools
import queue
import threading
import time
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt16
from numpy import ndarray

from depthmocap.cameras.lens import unmirrored
from depthmocap.cameras.modes import Mode, Wanted
from depthmocap.cameras.sdk import Make, checked
from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FoundCamera, NoFrame
from depthmocap.geometry import DepthCamera

#: The numbers are the sensor's for Xbox and the one's for Windows.
MAKE = Make(
    "kinect2", "Kinect 2", "freenect2", "freenect2",
    lambda usb: usb.vendor == 0x045E and usb.product in (0x02C4, 0x02D8), usb3=True,
)  # fmt: skip
#: All that it can.
_MODE = Mode(512, 424, 30)
#: libfreenect2 gives depth as floats in millimetres; it is rounded to whole ones.
_UNIT_M = 0.001
_TICK_NS = 125_000
#: Where libfreenect2 has the centre of the first pixel, as it makes point clouds.
_CENTRE = 0.5
#: Frames that wait to be read; when there are more, the oldest is dropped.
_WAITING = 4
#: libfreenect2 lists and opens devices from one thread at a time.
_LOCK = threading.Lock()


@functools.cache
def _context(sdk: Any) -> Any:
    return sdk.ffi.gc(sdk.lib.freenect2_create(), sdk.lib.freenect2_dispose)


def _serials(sdk: Any) -> list[str]:
    """The serial numbers of the connected devices, empty where the system does not tell them (the package does not)."""
    with _LOCK:
        count = sdk.lib.freenect2_enumerate_devices(_context(sdk))
    on_usb = [device.serial for device in MAKE.connected()]
    return on_usb if len(on_usb) == count else [""] * count


def find() -> list[FoundCamera]:
    """The connected cameras."""
    return MAKE.found([(serial, MAKE.name) for serial in _serials(MAKE.load())])


def make(name: str, address: str, wanted: Wanted) -> DepthSource:
    """The camera with this serial number, or the first.

    Raises:
        MisfitError: when another mode is wanted than the one there is.
    """
    wanted.choose(name, (_MODE,))
    return Kinect2(name, address)


def to_raw(depth_mm: Float32[ndarray, "h w"]) -> UInt16[ndarray, "h w"]:
    """Whole millimetres, 0 where libfreenect2 has no depth (not a number, infinite, or not positive), not mirrored."""
    valid = (depth_mm > 0) & (depth_mm < 65535)  # false for NaN
    return np.rint(np.where(valid, depth_mm, 0)).astype(np.uint16)[:, ::-1].copy()


class Kinect2(DepthSource):
    """One camera's depth (512×424, 30 a second). libfreenect2 reads and decodes colour as well; it is thrown away."""

    def __init__(self, name: str, serial: str = "") -> None:
        super().__init__(name)
        self._serial = serial
        self._frames: queue.Queue[DepthFrame] = queue.Queue(_WAITING)

    def _open(self) -> DepthCamera:
        sdk = self._sdk = MAKE.load()
        serials = _serials(sdk)
        if not self._serial or "" not in serials:
            self._serial = serials[MAKE.choose(serials, self._serial)]
        self._frames = queue.Queue(_WAITING)
        with _LOCK:
            reference = (
                sdk.lib.freenect2_open_device_by_serial(_context(sdk), self._serial.encode())
                if self._serial
                else sdk.lib.freenect2_open_default_device(_context(sdk))
            )
        try:
            self._device = sdk.Device(reference)
        except sdk.NoDeviceError as error:
            raise MAKE.failed(self.name, error, self._serial) from None
        self._device.start(self._take)
        try:
            lens = self._device.ir_camera_params
            if not lens.fx > 0:  # the package does not tell that starting failed
                raise MAKE.failed(self.name, "libfreenect2 did not start it", self._serial)
            return unmirrored(checked(DepthCamera(
                self.name, _MODE.width, _MODE.height, lens.fx, lens.fy, lens.cx - _CENTRE, lens.cy - _CENTRE,
                distortion=(lens.k1, lens.k2, lens.p1, lens.p2, lens.k3), depth_unit_m=_UNIT_M,
            )))  # fmt: skip
        except CameraError:
            self._close()
            raise

    def _take(self, kind: Any, frame: Any) -> None:
        """Called by a thread of libfreenect2, with every frame of every kind."""
        arrival_ns = time.monotonic_ns()
        if kind is not self._sdk.FrameType.Depth or frame.status:
            return
        clock = f"kinect2 {self._serial or self.name} device"
        raw = to_raw(frame.to_array())
        made = DepthFrame(self.name, raw, frame.timestamp * _TICK_NS, clock, arrival_ns, frame.sequence)
        while True:
            try:
                self._frames.put_nowait(made)
                return
            except queue.Full:
                try:
                    self._frames.get_nowait()
                except queue.Empty:
                    continue

    def _read(self, timeout_s: float) -> DepthFrame | None:
        try:
            return self._frames.get(timeout=timeout_s)
        except queue.Empty:
            raise NoFrame(f"camera {self.name!r} gave no frame for {timeout_s:.1f} s: is it still connected?") from None

    def _close(self) -> None:
        self._device.stop()
        self._device.close()
