"""Azure Kinect, and Femto cameras by Orbbec's wrapper of its SDK. Recordings are read by ``mkv_recording``.

Written from the SDK's documentation; its structures were checked with its library, but untested on hardware.
Timestamps are by the camera's own clock.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from depthmocap.cameras import k4a
from depthmocap.cameras.lens import NARROW, five_coefficients
from depthmocap.cameras.modes import Wanted
from depthmocap.cameras.sdk import Make, checked
from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FoundCamera, NoFrame
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera

#: Microsoft's number, and that of the depth sensor.
MAKE = Make(
    "azure", "Azure Kinect", "pyk4a-bundle", "pyk4a",
    lambda usb: (usb.vendor, usb.product) == (0x045E, 0x097C), usb3=True,
)  # fmt: skip
#: The SDK gives depth in millimetres.
_UNIT_M = 0.001
#: Half the field of view (tangent) of the wide modes, whose picture is a circle of 120°.
_WIDE = 1.75
#: Looking for cameras opens each for a moment: nobody else may try meanwhile.
_LOCK = threading.Lock()


def _serials(library: Any) -> list[str]:
    """The serial numbers of the connected cameras; that of one that is in use cannot be read, and is empty."""
    found = []
    for index in range(library.k4a_device_get_installed_count()):
        try:
            device = k4a.Device(library, index)
        except k4a.K4aError:
            found.append("")
            continue
        try:
            found.append(device.serial)
        except k4a.K4aError:
            found.append("")
        finally:
            device.close()
    return found


def find() -> list[FoundCamera]:
    """The connected cameras."""
    closed = MAKE.problem() or "in use, or this user may not open it"
    library = k4a.load()
    with _LOCK:
        found = MAKE.found([(serial, MAKE.name) for serial in _serials(library)])
    return [each if each.serial else FoundCamera(each.spec, each.model, "", each.problem or closed) for each in found]


def make(name: str, address: str, wanted: Wanted) -> DepthSource:
    """The camera with this serial number, or the first.

    Raises:
        InputError: when it is a recording, or no Azure Kinect has the wanted mode.
    """
    if address.lower().endswith(".mkv"):
        raise InputError(f"{address} is a recording and no camera: give its path alone, without {MAKE.kind}:")
    return AzureKinect(name, address, wanted)


class AzureKinect(DepthSource):
    """One camera's depth, by default in the narrow unbinned mode (640×576, 30 a second)."""

    def __init__(self, name: str, serial: str = "", wanted: Wanted | None = None) -> None:
        """Raises MisfitError when there is no such mode."""
        super().__init__(name)
        self._serial = serial
        self._mode = k4a.MODES[(wanted or Wanted()).choose(name, k4a.MODES)]

    def _open(self) -> DepthCamera:
        library = k4a.load()
        with _LOCK:
            serials = _serials(library)
            index = MAKE.choose(serials, self._serial)
            self._serial = serials[index]
            try:
                self._device = k4a.Device(library, index)
            except k4a.K4aError as error:
                raise MAKE.failed(self.name, error, self._serial) from None
        try:
            lens = self._device.start(self._mode)
            field = _WIDE if self._mode.name.startswith("wfov") else NARROW
            return checked(DepthCamera(
                self.name, lens.width, lens.height, lens.values[2], lens.values[3], lens.values[0], lens.values[1],
                distortion=five_coefficients(lens.coefficients, field), depth_unit_m=_UNIT_M,
            ))  # fmt: skip
        except k4a.K4aError as error:
            self._close()
            raise MAKE.failed(self.name, error, self._serial) from None
        except CameraError:
            self._close()
            raise

    def _read(self, timeout_s: float) -> DepthFrame | None:
        until = time.monotonic() + timeout_s
        while (left_s := until - time.monotonic()) > 0:
            try:
                depth = self._device.depth(max(1, round(left_s * 1e3)))
            except k4a.K4aError as error:
                raise CameraError(f"camera {self.name!r} failed: {error}") from None
            if depth is not None:
                arrival_ns = time.monotonic_ns()
                raw, timestamp_us = depth
                clock = f"azure {self._serial or self.name} device"
                return DepthFrame(self.name, raw, timestamp_us * 1000, clock, arrival_ns)
        raise NoFrame(f"camera {self.name!r} gave no frame for {timeout_s:.1f} s: is it still connected?")

    def _close(self) -> None:
        self._device.close()
