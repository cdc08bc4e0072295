"""Functions that all SDK back ends share: loading the SDK, choosing a device, and explaining errors."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import importlib
import sys
from collections.abc import Callable, Sequence
from typing import Any

from depthmocap.cameras.source import CameraError, ConnectedCamera
from depthmocap.cameras.usb import UsbDevice, usb_devices
from depthmocap.errors import InputError, missing_extra
from depthmocap.geometry import DepthCamera
from depthmocap.geometry.depth_camera import check_camera

_SAME_SERIAL = "another has the same serial number: connect one of them"
_NOT_SEEN_BY_SDK = "its SDK does not see it: is another program using it?"
_PERMISSION_HELP = (
    "install the udev rules of its SDK"
    if sys.platform.startswith("linux")
    else "let programs use cameras in the system's privacy settings"
)


@dataclasses.dataclass(frozen=True)
class CameraMake:
    """One make of camera: how to find it on USB, which package it needs, and its name in messages.

    Attributes:
        kind: the word that a user types for it, and the name of the extra that installs its package.
        name: its name in messages.
        package: the package to install.
        module: the module to import.
        usb: whether a USB device is of this make.
        usb3: whether it needs USB 3.
    """

    kind: str
    name: str
    package: str
    module: str
    usb: Callable[[UsbDevice], bool]
    usb3: bool = False

    def load(self) -> Any:
        """Import its SDK.

        Raises:
            InputError: when the SDK is not installed, or does not work here.
        """
        _offer_libusb()
        try:
            return importlib.import_module(self.module)
        except ModuleNotFoundError as error:
            if error.name != self.module.partition(".")[0]:
                raise self.load_error(error) from None
            raise missing_extra(self.package, self.kind) from None
        except ImportError as error:
            raise self.load_error(error) from None

    def load_error(self, error: Exception) -> InputError:
        """The error for a package that is installed but cannot be used."""
        return InputError(f"the package '{self.package}' is installed but cannot be loaded: {error}")

    def spec(self, serial: str) -> str:
        """The text that a user types for one camera."""
        return f"{self.kind}:{serial}" if serial else self.kind

    def on_usb(self, serial: str = "") -> list[UsbDevice]:
        """The cameras on USB. With a serial number: the camera that has it, or the only one connected."""
        matching = [device for device in usb_devices() if self.usb(device)]
        same_serial = [device for device in matching if serial in ("", device.serial)]
        return same_serial or (matching if len(matching) == 1 else [])

    def problem(self, serial: str = "") -> str:
        """The reason why the camera cannot be used, if the operating system knows one; otherwise empty."""
        return next((text for device in self.on_usb(serial) if (text := device.problem(self.usb3))), "")

    def list_cameras(self, cameras: Sequence[tuple[str, str]]) -> list[ConnectedCamera]:
        """The list for ``depthmocap cameras``, from the serial numbers and models that the SDK sees.

        If the SDK sees none, the list has the cameras that are on USB nevertheless, each with the reason.
        """
        if cameras:
            serials = [serial for serial, _ in cameras]
            problems = [
                _SAME_SERIAL if serial and serials.count(serial) > 1 else self.problem(serial) for serial in serials
            ]
            return [
                ConnectedCamera(self.spec(serial), model, serial, problem)
                for (serial, model), problem in zip(cameras, problems, strict=True)
            ]
        return [
            ConnectedCamera(
                self.spec(usb.serial), usb.name or self.name, usb.serial, usb.problem(self.usb3) or _NOT_SEEN_BY_SDK
            )
            for usb in self.on_usb()
        ]

    def choose(self, serials: Sequence[str], serial: str) -> int:
        """Index of the device with this serial number among those that the SDK lists; 0 for an empty one.

        Raises:
            CameraError: when no device or several devices have the serial number.
        """
        if not serials:
            if problem := self.problem():
                raise CameraError(f"no {self.name} can be used: {problem}")
            raise CameraError(f"no {self.name} is connected: check power and cable")
        if not serial:
            return 0
        matching = [index for index, listed in enumerate(serials) if listed == serial]
        if not matching:
            connected = ", ".join(listed or "one that does not tell its number" for listed in serials)
            raise CameraError(f"no {self.name} has the serial number {serial}: connected are {connected}")
        if len(matching) > 1:
            raise CameraError(f"{len(matching)} cameras are {self.spec(serial)}: connect one of them")
        return matching[0]

    def start_error(self, camera: str, error: object, serial: str = "") -> CameraError:
        """The error for a camera that does not start: the reason, what to do, and the SDK's own message."""
        sdk_text = f" ({error})" if str(error) else ""
        if problem := self.problem(serial):
            return CameraError(f"camera {camera!r} cannot be started: {problem}{sdk_text}")
        lower = str(error).lower()
        if any(word in lower for word in ("busy", "in use", "claim")):
            return CameraError(f"camera {camera!r} is in use: close the other program{sdk_text}")
        if any(word in lower for word in ("access", "permission", "denied")):
            return CameraError(f"this user may not use camera {camera!r}: {_PERMISSION_HELP}{sdk_text}")
        return CameraError(f"camera {camera!r} cannot be started: it may be in use by another program{sdk_text}")


def checked(camera: DepthCamera) -> DepthCamera:
    """Check the calibration that a device reports; returns the camera.

    Raises:
        CameraError: when the calibration is impossible.
    """
    try:
        check_camera(camera, f"camera {camera.name!r} tells no usable calibration")
    except InputError as error:
        raise CameraError(str(error)) from None
    return camera


def _offer_libusb() -> None:
    """Load libusb from the package libusb-package on Linux systems without one, for SDKs that are linked to it."""
    if not sys.platform.startswith("linux"):
        return
    try:
        ctypes.CDLL("libusb-1.0.so.0")
    except OSError:
        with contextlib.suppress(ImportError, OSError):
            path = importlib.import_module("libusb_package").get_library_path()
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
