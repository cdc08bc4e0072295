"""Kinect 2 through libfreenect2 and its package ``freenect2``.

This module was written from the sources of both; it was not tested on hardware. libfreenect2 gives mirrored pictures,
and this module turns them back. Timestamps are by the camera's own clock, which counts eighths of a millisecond.
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
from depthmocap.cameras.modes import Mode, ModeRequest
from depthmocap.cameras.sdk import CameraMake, checked
from depthmocap.cameras.source import CameraError, ConnectedCamera, DepthFrame, DepthSource
from depthmocap.geometry import DepthCamera

#: USB product numbers: the sensor for Xbox, and the sensor for Windows.
MAKE = CameraMake(
    "kinect2", "Kinect 2", "freenect2", "freenect2",
    lambda usb: usb.vendor == 0x045E and usb.product in (0x02C4, 0x02D8), usb3=True,
)  # fmt: skip
#: The camera's only mode.
_MODE = Mode(512, 424, 30)
#: Metres of one depth unit: libfreenect2 gives floats in millimetres, which are rounded to whole ones.
_UNIT_M = 0.001
#: Nanoseconds of one tick of the camera's clock.
_TICK_NS = 125_000
#: Pixel coordinate of the first pixel's centre in libfreenect2.
_CENTRE = 0.5
#: Frames that may wait to be read; beyond that the oldest is dropped.
_WAITING = 4
#: libfreenect2 allows only one thread at a time to list and open devices.
_LOCK = threading.Lock()


@functools.cache
def _context(sdk: Any) -> Any:
    return sdk.ffi.gc(sdk.lib.freenect2_create(), sdk.lib.freenect2_dispose)


def _serials(sdk: Any) -> list[str]:
    """Serial numbers of the connected devices, from the operating system; empty if it does not tell them."""
    with _LOCK:
        count = sdk.lib.freenect2_enumerate_devices(_context(sdk))
    on_usb = [device.serial for device in MAKE.on_usb()]
    return on_usb if len(on_usb) == count else [""] * count


def find_cameras() -> list[ConnectedCamera]:
    """The connected cameras."""
    return MAKE.list_cameras([(serial, MAKE.name) for serial in _serials(MAKE.load())])


def make_source(name: str, address: str, request: ModeRequest) -> DepthSource:
    """The camera with this serial number, or the first one if ``address`` is empty.

    Raises:
        CameraMismatchError: when another mode is requested than the camera's only one.
    """
    request.choose(name, (_MODE,))
    return Kinect2(name, address)


def to_raw(depth_mm: Float32[ndarray, "h w"]) -> UInt16[ndarray, "h w"]:
    """Depth in whole millimetres, not mirrored; 0 where the input is NaN, infinite or not positive."""
    valid = (depth_mm > 0) & (depth_mm < 65535)  # false for NaN
    return np.rint(np.where(valid, depth_mm, 0)).astype(np.uint16)[:, ::-1].copy()


class Kinect2(DepthSource):
    """One camera's depth (512×424, 30 frames a second). libfreenect2 also decodes colour, which is not used."""

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
            raise MAKE.start_error(self.name, error, self._serial) from None
        self._device.start(self._receive)
        try:
            lens = self._device.ir_camera_params
            if not lens.fx > 0:  # the package does not report a failed start
                raise MAKE.start_error(self.name, "libfreenect2 did not start it", self._serial)
            return unmirrored(checked(DepthCamera(
                self.name, _MODE.width, _MODE.height, lens.fx, lens.fy, lens.cx - _CENTRE, lens.cy - _CENTRE,
                distortion=(lens.k1, lens.k2, lens.p1, lens.p2, lens.k3), depth_unit_m=_UNIT_M,
            )))  # fmt: skip
        except CameraError:
            self._close()
            raise

    def _receive(self, kind: Any, frame: Any) -> None:
        """Queue a depth frame. A thread of libfreenect2 calls this with every frame of every kind."""
        arrival_ns = time.monotonic_ns()
        if kind is not self._sdk.FrameType.Depth or frame.status:
            return
        clock = f"kinect2 {self._serial or self.name} device"
        raw = to_raw(frame.to_array())
        depth_frame = DepthFrame(self.name, raw, frame.timestamp * _TICK_NS, clock, arrival_ns, frame.sequence)
        while True:
            try:
                self._frames.put_nowait(depth_frame)
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
            raise self._frame_timeout(timeout_s) from None

    def _close(self) -> None:
        self._device.stop()
        self._device.close()
