"""Cameras with an OpenNI 2 driver (Xtion, Astra, Kinect 1, …) and its ONI files, through the package ``openni``.

Files were tested with OpenNI's own library, and devices with a fake of the package; nothing was tested on hardware.
Timestamps are by the camera's own clock. OpenNI tells a field of view, but neither the principal point nor distortion.
This module takes the middle of the picture as the principal point; calibrate the camera for a better one.
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
from depthmocap.cameras.modes import Mode, ModeRequest
from depthmocap.cameras.sdk import CameraMake, checked
from depthmocap.cameras.source import CameraError, ConnectedCamera, DepthFrame, DepthSource
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera

#: USB numbers of PrimeSense, Orbbec, and Microsoft's first Kinect.
MAKE = CameraMake(
    "openni", "OpenNI camera", "openni", "openni.openni2",
    lambda usb: usb.vendor in (0x1D27, 0x2BC5) or (usb.vendor, usb.product) == (0x045E, 0x02AE),
)  # fmt: skip
#: Where Linux systems keep OpenNI's library; the package itself searches only a few folders.
_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib/arm-linux-gnueabihf")
#: OpenNI's playback speed at which a file gives each frame when it is read, and skips none.
_MANUAL_SPEED = -1.0
#: A file whose next frame takes longer than this (seconds) was cut off.
_FILE_TIMEOUT_S = 2.0
#: Only one thread at a time may start OpenNI, or open or close a device.
_LOCK = threading.Lock()


def load() -> Any:
    """The package, with OpenNI's library started.

    Raises:
        InputError: when one of them is not installed.
    """
    sdk = MAKE.load()
    folders = [os.environ[name] for name in ("OPENNI2_REDIST64", "OPENNI2_REDIST") if name in os.environ]
    folders += [folder for folder in _FOLDERS if Path(folder, "libOpenNI2.so").exists()]
    try:
        with _LOCK:
            sdk.initialize(folders) if folders else sdk.initialize()
            atexit.unregister(sdk.unload)  # it crashes with some drivers, and waits for devices that hang
    except (sdk.InitializationError, sdk.OpenNIError) as error:
        raise InputError(
            "OpenNI 2 itself was not found: install it (Debian: apt install libopenni2-dev), or set OPENNI2_REDIST to "
            f"the folder of its library ({' '.join(str(error).split())})"
        ) from None
    return sdk


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def _uris(sdk: Any) -> list[str]:
    """URIs of the connected devices, without the opened files that OpenNI lists as devices as well."""
    with _LOCK:
        return [uri for listed in sdk.Device.enumerate_uris() if not (uri := _text(listed)).lower().endswith(".oni")]


def find_cameras() -> list[ConnectedCamera]:
    """The connected cameras. OpenNI identifies them by the URI of their USB port, not by a serial number."""
    return MAKE.list_cameras([(uri, MAKE.name) for uri in _uris(load())])


def make_source(name: str, address: str, request: ModeRequest) -> DepthSource:
    """The camera with this URI, the first, or an ONI file."""
    return OpenNICamera(name, address, request)


class OpenNICamera(DepthSource):
    """The depth of one camera, or of an ONI file, which gives every frame in order, as fast as it is read."""

    def __init__(self, name: str, address: str = "", request: ModeRequest | None = None) -> None:
        """``address``: a URI, the path of an ONI file, or nothing for the first camera."""
        super().__init__(name)
        self._address, self._request = address, request or ModeRequest()
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
            raise MAKE.start_error(self.name, _error_text(error)) from None
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
            raise CameraError(f"{path} is no ONI file that OpenNI can read ({_error_text(error)})") from None

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
            raise MAKE.start_error(self.name, _error_text(error)) from None

    def _start(self) -> DepthCamera:
        error = self._sdk.OpenNIError
        self._stream = self._device.create_depth_stream()
        if self._stream is None:
            raise CameraError(f"camera {self.name!r} has no depth")
        if self._file:
            self._frames_left = self._stream.get_number_of_frames()
            recorded = self._stream.get_video_mode()
            self._request.choose(self.name, [Mode(recorded.resolutionX, recorded.resolutionY, recorded.fps)])
            self._device.playback.set_repeat_enabled(False)
            self._device.playback.set_speed(_MANUAL_SPEED)
        else:
            self._choose_mode()
            with contextlib.suppress(error):  # some drivers mirror their pictures by default
                self._stream.set_mirroring_enabled(False)
        self._mirrored = False
        with contextlib.suppress(error):
            self._mirrored = self._stream.get_mirroring_enabled()
        camera = self._describe()
        self._stream.start()
        return unmirrored(camera) if self._mirrored else camera

    def _choose_mode(self) -> None:
        modes = [mode for mode in self._stream.get_sensor_info().videoModes if int(mode.pixelFormat) in self._units()]
        if not modes:
            raise CameraError(f"camera {self.name!r} has no depth in millimetres")
        mode = modes[
            self._request.choose(self.name, [Mode(mode.resolutionX, mode.resolutionY, mode.fps) for mode in modes])
        ]
        if _mode_key(mode) != _mode_key(self._stream.get_video_mode()):
            self._stream.set_video_mode(mode)

    def _units(self) -> dict[int, float]:
        """Metres of one depth unit, by pixel format."""
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
            if self._frames_left == 0:
                return None
            timeout_s = _FILE_TIMEOUT_S
        try:
            if self._sdk.wait_for_any_stream([self._stream], max(timeout_s, 1e-3)) is None:
                if self._file:
                    raise CameraError(f"{self._file} is cut off: its last {self._frames_left} frames are missing")
                raise self._frame_timeout(timeout_s)
            frame = self._stream.read_frame()
        except self._sdk.OpenNIError as error:
            raise CameraError(f"camera {self.name!r} failed: {_error_text(error)}") from None
        arrival_ns = time.monotonic_ns()
        rows = np.ctypeslib.as_array(frame.get_buffer_as_uint16()).reshape(frame.height, frame.stride // 2)
        raw = np.array(rows[:, : frame.width][:, :: -1 if self._mirrored else 1])  # a copy: OpenNI reuses its buffers
        timestamp_ns, number = frame.timestamp * 1000, frame.frameIndex
        frame.close()
        if self._file:
            self._frames_left -= 1
        clock = f"openni {self._file.name if self._file else self._address} device"
        return DepthFrame(self.name, raw, timestamp_ns, clock, arrival_ns, number)

    def _close(self) -> None:
        with _LOCK:
            if self._stream is not None:
                self._stream.close()
            self._device.close()


def _focal(pixels: int, fov: float) -> float:
    """Focal length in pixels of a picture so many pixels wide (or high) with this field of view (radians)."""
    return pixels / (2 * math.tan(fov / 2)) if 0 < fov < math.pi else math.nan


def _mode_key(mode: Any) -> tuple[int, int, int, int]:
    return mode.resolutionX, mode.resolutionY, mode.fps, int(mode.pixelFormat)


def _error_text(error: Any) -> str:
    """OpenNI's message in an error of the package, whose arguments are code, message and log file."""
    code, message, *_ = error.args
    return _text(message) if isinstance(message, bytes) and message else repr(code)
