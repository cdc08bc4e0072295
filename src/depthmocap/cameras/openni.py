"""Cameras with an OpenNI 2 driver (Xtion, Astra, Kinect 1, …) and its ONI files, through the package ``openni``.

Tested with OpenNI's own library on files; its devices against a fake of the package; untested on hardware.
Timestamps are by the camera's own clock. OpenNI tells a field of view, and neither principal point nor distortion:
calibrate such a camera, or take the middle of the picture as it is taken here.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from depthmocap.cameras.lens import unmirrored
from depthmocap.cameras.modes import Mode, Wanted
from depthmocap.cameras.sdk import Make, checked
from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FoundCamera, NoFrame
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera

#: PrimeSense, Orbbec, and Microsoft's first Kinect.
MAKE = Make(
    "openni", "OpenNI camera", "openni", "openni.openni2",
    lambda usb: usb.vendor in (0x1D27, 0x2BC5) or (usb.vendor, usb.product) == (0x045E, 0x02AE),
)  # fmt: skip
#: Where Linux systems keep OpenNI's library, which the package looks for in a few folders only.
_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib/arm-linux-gnueabihf")
#: A file is played by hand: the next frame comes when it is asked for, and none is left out.
_BY_HAND = -1.0
#: A file whose next frame does not come within this has ended too early.
_FILE_S = 2.0
#: OpenNI is started, and devices are opened and closed, by one thread at a time.
_LOCK = threading.Lock()


def load() -> Any:
    """The package, with OpenNI's library started.

    Raises:
        InputError: when one of them is not installed.
    """
    sdk = MAKE.load()
    folders = [os.environ[each] for each in ("OPENNI2_REDIST64", "OPENNI2_REDIST") if each in os.environ]
    folders += [each for each in _FOLDERS if Path(each, "libOpenNI2.so").exists()]
    try:
        with _LOCK:
            sdk.initialize(folders) if folders else sdk.initialize()
            atexit.unregister(sdk.unload)  # it crashes with some drivers, and would wait for a device that hangs
    except (sdk.InitializationError, sdk.OpenNIError) as error:
        raise InputError(
            "OpenNI 2 itself was not found: install it (Debian: apt install libopenni2-dev), or set OPENNI2_REDIST to "
            f"the folder of its library ({' '.join(str(error).split())})"
        ) from None
    return sdk


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def _uris(sdk: Any) -> list[str]:
    """The connected devices; OpenNI counts files that were opened as such as well."""
    with _LOCK:
        return [uri for each in sdk.Device.enumerate_uris() if not (uri := _text(each)).lower().endswith(".oni")]


def find() -> list[FoundCamera]:
    """The connected cameras. OpenNI knows them by a URI of their place on USB, not by a serial number."""
    return MAKE.found([(uri, MAKE.name) for uri in _uris(load())])


def make(name: str, address: str, wanted: Wanted) -> DepthSource:
    """The camera with this URI, the first, or an ONI file."""
    return OpenNICamera(name, address, wanted)


class OpenNICamera(DepthSource):
    """One camera's depth, or that of an ONI file: every frame in order, as fast as it is read."""

    def __init__(self, name: str, address: str = "", wanted: Wanted | None = None) -> None:
        """``address``: a URI, the path of an ONI file, or nothing for the first camera."""
        super().__init__(name)
        self._address, self._wanted = address, wanted or Wanted()
        self._file = Path(address).resolve() if address.lower().endswith(".oni") else None
        self.reopens = self._file is None

    def _open(self) -> DepthCamera:
        sdk = self._sdk = load()
        self._device = self._open_file(sdk, self._file) if self._file else self._open_device(sdk)
        self._stream: Any = None
        try:
            return self._start()
        except sdk.OpenNIError as error:
            self._close()
            raise MAKE.failed(self.name, _said(error)) from None
        except CameraError:
            self._close()
            raise

    def _open_file(self, sdk: Any, path: Path) -> Any:
        if not path.is_file():
            raise CameraError(f"{path} is not a file")
        try:
            with _LOCK:
                return sdk.Device(os.fsencode(path))
        except sdk.OpenNIError as error:
            raise CameraError(f"{path} is no ONI file that OpenNI can read ({_said(error)})") from None

    def _open_device(self, sdk: Any) -> Any:
        uris = _uris(sdk)
        if not self._address:
            self._address = uris[MAKE.choose(uris, "")]
        try:
            with _LOCK:
                return sdk.Device(self._address.encode())
        except sdk.OpenNIError as error:
            if self._address not in uris:  # some drivers open what they do not list
                MAKE.choose(uris, self._address)
            raise MAKE.failed(self.name, _said(error)) from None

    def _start(self) -> DepthCamera:
        error = self._sdk.OpenNIError
        self._stream = self._device.create_depth_stream()
        if self._stream is None:
            raise CameraError(f"camera {self.name!r} has no depth")
        if self._file:
            self._left = self._stream.get_number_of_frames()
            recorded = self._stream.get_video_mode()
            self._wanted.choose(self.name, [Mode(recorded.resolutionX, recorded.resolutionY, recorded.fps)])
            self._device.playback.set_repeat_enabled(False)
            self._device.playback.set_speed(_BY_HAND)
        else:
            self._choose_mode()
            with contextlib.suppress(error):  # pictures as in a mirror are the default of some
                self._stream.set_mirroring_enabled(False)
        self._mirrored = False
        with contextlib.suppress(error):
            self._mirrored = self._stream.get_mirroring_enabled()
        camera = self._describe()
        self._stream.start()
        return unmirrored(camera) if self._mirrored else camera

    def _choose_mode(self) -> None:
        modes = [each for each in self._stream.get_sensor_info().videoModes if int(each.pixelFormat) in self._units()]
        if not modes:
            raise CameraError(f"camera {self.name!r} has no depth in millimetres")
        mode = modes[
            self._wanted.choose(self.name, [Mode(each.resolutionX, each.resolutionY, each.fps) for each in modes])
        ]
        if _mode_key(mode) != _mode_key(self._stream.get_video_mode()):
            self._stream.set_video_mode(mode)

    def _units(self) -> dict[int, float]:
        """Metres a unit by the format of pixels."""
        return {int(self._sdk.PIXEL_FORMAT_DEPTH_1_MM): 1e-3, int(self._sdk.PIXEL_FORMAT_DEPTH_100_UM): 1e-4}

    def _describe(self) -> DepthCamera:
        mode = self._stream.get_video_mode()
        unit = self._units().get(int(mode.pixelFormat))
        if unit is None:
            raise CameraError(f"camera {self.name!r} has no depth in millimetres")
        try:
            across, down = self._stream.get_horizontal_fov(), self._stream.get_vertical_fov()
        except self._sdk.OpenNIError:
            raise CameraError(f"camera {self.name!r} does not tell its field of view") from None
        width, height = mode.resolutionX, mode.resolutionY
        return checked(DepthCamera(
            self.name, width, height, _focal(width, across), _focal(height, down), (width - 1) / 2, (height - 1) / 2,
            depth_unit_m=unit,
        ))  # fmt: skip

    def _read(self, timeout_s: float) -> DepthFrame | None:
        if self._file:
            if self._left == 0:
                return None
            timeout_s = _FILE_S
        try:
            if self._sdk.wait_for_any_stream([self._stream], max(timeout_s, 1e-3)) is None:
                if self._file:
                    raise CameraError(f"{self._file} is cut off: its last {self._left} frames are missing")
                raise NoFrame(f"camera {self.name!r} gave no frame for {timeout_s:.1f} s: is it still connected?")
            frame = self._stream.read_frame()
        except self._sdk.OpenNIError as error:
            raise CameraError(f"camera {self.name!r} failed: {_said(error)}") from None
        arrival_ns = time.monotonic_ns()
        rows = np.ctypeslib.as_array(frame.get_buffer_as_uint16()).reshape(frame.height, frame.stride // 2)
        raw = np.array(rows[:, : frame.width][:, :: -1 if self._mirrored else 1])  # a copy: OpenNI reuses its buffers
        timestamp_ns, number = frame.timestamp * 1000, frame.frameIndex
        frame.close()
        if self._file:
            self._left -= 1
        clock = f"openni {self._file.name if self._file else self._address} device"
        return DepthFrame(self.name, raw, timestamp_ns, clock, arrival_ns, number)

    def _close(self) -> None:
        with _LOCK:
            if self._stream is not None:
                self._stream.close()
            self._device.close()


def _focal(pixels: int, field: float) -> float:
    """Focal length in pixels, of so many across a field of view (radians)."""
    return pixels / (2 * math.tan(field / 2)) if 0 < field < math.pi else math.nan


def _mode_key(mode: Any) -> tuple[int, int, int, int]:
    return mode.resolutionX, mode.resolutionY, mode.fps, int(mode.pixelFormat)


def _said(error: Any) -> str:
    """OpenNI's own words in an error of the package: (code, message, file of its log)."""
    code, message, *_ = error.args
    return _text(message) if isinstance(message, bytes) and message else repr(code)
