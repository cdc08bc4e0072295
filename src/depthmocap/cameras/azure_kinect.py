"""Azure Kinect cameras, and Orbbec's Femto cameras through Orbbec's wrapper of the same SDK.

``mkv_recording`` reads the SDK's recordings. This module was written from the SDK's documentation; the structures were
checked against its library, but nothing was tested on hardware. Timestamps are by the camera's own clock.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from depthmocap.cameras import k4a
from depthmocap.cameras.lens import NARROW_FOV_TAN, five_coefficients
from depthmocap.cameras.modes import ModeRequest
from depthmocap.cameras.sdk import CameraMake, checked
from depthmocap.cameras.source import CameraError, ConnectedCamera, DepthFrame, DepthSource
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera

#: USB vendor number of Microsoft and product number of the depth sensor.
MAKE = CameraMake(
    "azure", "Azure Kinect", "pyk4a-bundle", "pyk4a",
    lambda usb: (usb.vendor, usb.product) == (0x045E, 0x097C), usb3=True,
)  # fmt: skip
#: Metres of one depth unit: the SDK gives millimetres.
_UNIT_M = 0.001
#: Tangent of half the field of view in the wide modes, whose picture is a circle of 120°.
_WIDE_FOV_TAN = 1.75
#: Listing cameras opens each one for a moment, so only one thread at a time may list or open them.
_LOCK = threading.Lock()


def _serials(library: Any) -> list[str]:
    """The serial numbers of the connected cameras; empty for a camera in use, whose number cannot be read."""
    serials = []
    for index in range(library.k4a_device_get_installed_count()):
        try:
            device = k4a.Device(library, index)
        except k4a.K4aError:
            serials.append("")
            continue
        try:
            serials.append(device.serial)
        except k4a.K4aError:
            serials.append("")
        finally:
            device.close()
    return serials


def find_cameras() -> list[ConnectedCamera]:
    """The connected cameras."""
    unopened_problem = MAKE.problem() or "in use, or this user may not open it"
    library = k4a.load()
    with _LOCK:
        cameras = MAKE.list_cameras([(serial, MAKE.name) for serial in _serials(library)])
    return [
        camera if camera.serial else ConnectedCamera(camera.spec, camera.model, "", camera.problem or unopened_problem)
        for camera in cameras
    ]


def make_source(name: str, address: str, request: ModeRequest) -> DepthSource:
    """The camera with this serial number, or the first one if ``address`` is empty.

    Raises:
        InputError: when the address is a recording, or no Azure Kinect has the requested mode.
    """
    if address.lower().endswith(".mkv"):
        raise InputError(f"{address} is a recording and no camera: give its path alone, without {MAKE.kind}:")
    return AzureKinect(name, address, request)


class AzureKinect(DepthSource):
    """One camera's depth, by default in the narrow unbinned mode (640×576, 30 a second)."""

    def __init__(self, name: str, serial: str = "", request: ModeRequest | None = None) -> None:
        """Raises CameraMismatchError when the camera has no such mode."""
        super().__init__(name)
        self._serial = serial
        self._mode = k4a.MODES[(request or ModeRequest()).choose(name, k4a.MODES)]

    def _open(self) -> DepthCamera:
        library = k4a.load()
        with _LOCK:
            serials = _serials(library)
            index = MAKE.choose(serials, self._serial)
            self._serial = serials[index]
            try:
                self._device = k4a.Device(library, index)
            except k4a.K4aError as error:
                raise MAKE.start_error(self.name, error, self._serial) from None
        try:
            lens = self._device.start(self._mode)
            fov_tan = _WIDE_FOV_TAN if self._mode.name.startswith("wfov") else NARROW_FOV_TAN
            return checked(DepthCamera(
                self.name, lens.width, lens.height, lens.values[2], lens.values[3], lens.values[0], lens.values[1],
                distortion=five_coefficients(lens.coefficients, fov_tan), depth_unit_m=_UNIT_M,
            ))  # fmt: skip
        except k4a.K4aError as error:
            self._close()
            raise MAKE.start_error(self.name, error, self._serial) from None
        except CameraError:
            self._close()
            raise

    def _read(self, timeout_s: float) -> DepthFrame | None:
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            try:
                depth = self._device.depth(max(1, round(left_s * 1e3)))
            except k4a.K4aError as error:
                raise CameraError(f"camera {self.name!r} failed: {error}") from None
            if depth is not None:
                arrival_ns = time.monotonic_ns()
                raw, timestamp_us = depth
                clock = f"azure {self._serial or self.name} device"
                return DepthFrame(self.name, raw, timestamp_us * 1000, clock, arrival_ns)
        raise self._frame_timeout(timeout_s)

    def _close(self) -> None:
        self._device.close()
