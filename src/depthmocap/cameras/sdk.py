"""What the back ends of all SDKs share: loading them, choosing a device, saying what is wrong."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import importlib
import sys
from collections.abc import Callable, Sequence
from typing import Any

from depthmocap.cameras.source import CameraError, FoundCamera
from depthmocap.cameras.usb import UsbDevice, usb_devices
from depthmocap.errors import InputError, missing_extra
from depthmocap.geometry import DepthCamera
from depthmocap.geometry.depth_camera import check_camera

_TWINS = "another has the same serial number: connect one of them"
_UNSEEN = "its SDK does not see it: is another program using it?"
_ALLOWING = (
    "install the udev rules of its SDK"
    if sys.platform.startswith("linux")
    else "let programs use cameras in the system's privacy settings"
)


@dataclasses.dataclass(frozen=True)
class Make:
    """One kind of camera, for finding it on USB and for messages.

    Attributes:
        kind: what a user types for it, and the extra that brings its package.
        name: what it is called.
        package: what is installed for it.
        module: what is imported.
        usb: tells whether a USB device is one of them.
        usb3: it needs USB 3.
    """

    kind: str
    name: str
    package: str
    module: str
    usb: Callable[[UsbDevice], bool]
    usb3: bool = False

    def load(self) -> Any:
        """Its SDK.

        Raises:
            InputError: when it is not installed, or does not work here.
        """
        _offer_libusb()
        try:
            return importlib.import_module(self.module)
        except ModuleNotFoundError as error:
            if error.name != self.module.partition(".")[0]:
                raise self.broken(error) from None
            raise missing_extra(self.package, self.kind) from None
        except ImportError as error:
            raise self.broken(error) from None

    def broken(self, error: Exception) -> InputError:
        """The error for a package that is installed but cannot be used."""
        return InputError(f"the package '{self.package}' is installed but cannot be loaded: {error}")

    def spec(self, serial: str) -> str:
        """What a user types for one camera."""
        return f"{self.kind}:{serial}" if serial else self.kind

    def connected(self, serial: str = "") -> list[UsbDevice]:
        """Those on USB; with a serial number the one that has it, or the only one there is."""
        every = [each for each in usb_devices() if self.usb(each)]
        own = [each for each in every if serial in ("", each.serial)]
        return own or (every if len(every) == 1 else [])

    def problem(self, serial: str = "") -> str:
        """What keeps the camera from being used, as far as the operating system knows."""
        return next((text for each in self.connected(serial) if (text := each.problem(self.usb3))), "")

    def found(self, cameras: Sequence[tuple[str, str]]) -> list[FoundCamera]:
        """The list for ``depthmocap cameras`` of the serial numbers and models that the SDK sees.

        Where it sees none, those that are on USB all the same are listed, with the reason.
        """
        if cameras:
            serials = [serial for serial, _ in cameras]
            problems = [_TWINS if each and serials.count(each) > 1 else self.problem(each) for each in serials]
            return [
                FoundCamera(self.spec(serial), model, serial, problem)
                for (serial, model), problem in zip(cameras, problems, strict=True)
            ]
        return [
            FoundCamera(self.spec(usb.serial), usb.name or self.name, usb.serial, usb.problem(self.usb3) or _UNSEEN)
            for usb in self.connected()
        ]

    def choose(self, serials: Sequence[str], wanted: str) -> int:
        """Which of the devices that an SDK found is the wanted one; the first, where none is named.

        Raises:
            CameraError: when there is none, or several have the serial number.
        """
        if not serials:
            if known := self.problem():
                raise CameraError(f"no {self.name} can be used: {known}")
            raise CameraError(f"no {self.name} is connected: check power and cable")
        if not wanted:
            return 0
        matching = [index for index, serial in enumerate(serials) if serial == wanted]
        if not matching:
            known = ", ".join(serial or "one that does not tell its number" for serial in serials)
            raise CameraError(f"no {self.name} has the serial number {wanted}: connected are {known}")
        if len(matching) > 1:
            raise CameraError(f"{len(matching)} cameras are {self.spec(wanted)}: connect one of them")
        return matching[0]

    def failed(self, camera: str, error: object, serial: str = "") -> CameraError:
        """The error for a camera that will not start: what is wrong, what to do, and the SDK's own words."""
        said = f" ({error})" if str(error) else ""
        if known := self.problem(serial):
            return CameraError(f"camera {camera!r} cannot be started: {known}{said}")
        lower = str(error).lower()
        if any(word in lower for word in ("busy", "in use", "claim")):
            return CameraError(f"camera {camera!r} is in use: close the other program{said}")
        if any(word in lower for word in ("access", "permission", "denied")):
            return CameraError(f"this user may not use camera {camera!r}: {_ALLOWING}{said}")
        return CameraError(f"camera {camera!r} cannot be started: it may be in use by another program{said}")


def checked(camera: DepthCamera) -> DepthCamera:
    """The camera, if what its device told of it can be.

    Raises:
        CameraError: when it cannot.
    """
    try:
        check_camera(camera, f"camera {camera.name!r} tells no usable calibration")
    except InputError as error:
        raise CameraError(str(error)) from None
    return camera


def _offer_libusb() -> None:
    """Where Linux has no libusb, the one in the package libusb-package stands in for SDKs that are linked to it."""
    if not sys.platform.startswith("linux"):
        return
    try:
        ctypes.CDLL("libusb-1.0.so.0")
    except OSError:
        with contextlib.suppress(ImportError, OSError):
            path = importlib.import_module("libusb_package").get_library_path()
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
