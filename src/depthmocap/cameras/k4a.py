"""The few functions of the Azure Kinect SDK's C library (libk4a) that depth capture needs.

They are called through ctypes, because the package that ships the library was built for NumPy 1 and cannot be imported
beside NumPy 2. Orbbec's wrapper for its Femto cameras is also a libk4a, and is used where it is installed.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import functools
import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16
from numpy import ndarray

from depthmocap.cameras.modes import Mode
from depthmocap.errors import missing_extra

#: The SDK's number for a colour camera that is switched off.
_COLOR_OFF = 0
#: The SDK's numbers of the depth modes, by name.
_MODES = {"nfov-binned": 1, "nfov": 2, "wfov-binned": 3, "wfov": 4}
#: The SDK's numbers of the frame rates, by frames a second.
_RATES = {5: 0, 15: 1, 30: 2}
#: The SDK's result when no frame came in time.
_TIMEOUT = 2
#: The modes that a camera has, by the same names: the wide picture has half the rate.
MODES = tuple(
    Mode(width, height, fps, name)
    for name, width, height, fastest in (
        ("nfov", 640, 576, 30), ("nfov-binned", 320, 288, 30), ("wfov", 1024, 1024, 15), ("wfov-binned", 512, 512, 30)
    )
    for fps in _RATES if fps <= fastest
)  # fmt: skip


class K4aError(RuntimeError):
    """A function of the SDK failed. Only the SDK's log says why (set K4A_LOG_LEVEL=i in the environment)."""


class _Configuration(ctypes.Structure):
    _fields_ = (
        ("color_format", ctypes.c_int),
        ("color_resolution", ctypes.c_int),
        ("depth_mode", ctypes.c_int),
        ("camera_fps", ctypes.c_int),
        ("synchronized_images_only", ctypes.c_bool),
        ("depth_delay_off_color_usec", ctypes.c_int32),
        ("wired_sync_mode", ctypes.c_int),
        ("subordinate_delay_off_master_usec", ctypes.c_uint32),
        ("disable_streaming_indicator", ctypes.c_bool),
    )


class Lens(ctypes.Structure):
    """The calibration of one of the camera's sensors. ``values``: cx, cy, fx, fy, k1 … k6, codx, cody, p2, p1."""

    _fields_ = (
        ("rotation", ctypes.c_float * 9),
        ("translation", ctypes.c_float * 3),
        ("model", ctypes.c_int),
        ("count", ctypes.c_uint),
        ("values", ctypes.c_float * 15),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("metric_radius", ctypes.c_float),
    )

    @property
    def coefficients(self) -> Float[ndarray, "8"]:
        """k1, k2, p1, p2, k3, k4, k5, k6, in OpenCV's order."""
        k, p2, p1 = self.values[4:10], self.values[12], self.values[13]
        return np.array([k[0], k[1], p1, p2, *k[2:]], np.float64)


class Calibration(ctypes.Structure):
    """The SDK's calibration of a camera in one mode."""

    _fields_ = (
        ("depth", Lens),
        ("color", Lens),
        ("extrinsics", ctypes.c_float * 12 * 16),
        ("depth_mode", ctypes.c_int),
        ("color_resolution", ctypes.c_int),
    )


_POINTER, _HANDLE = ctypes.c_void_p, ctypes.POINTER(ctypes.c_void_p)
#: The result type and the argument types of each function.
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "k4a_device_get_installed_count": (ctypes.c_uint32, ()),
    "k4a_device_open": (ctypes.c_int, (ctypes.c_uint32, _HANDLE)),
    "k4a_device_close": (None, (_POINTER,)),
    "k4a_device_get_serialnum": (ctypes.c_int, (_POINTER, ctypes.c_char_p, ctypes.POINTER(ctypes.c_size_t))),
    "k4a_device_start_cameras": (ctypes.c_int, (_POINTER, ctypes.POINTER(_Configuration))),
    "k4a_device_stop_cameras": (None, (_POINTER,)),
    "k4a_device_get_calibration": (
        ctypes.c_int, (_POINTER, ctypes.c_int, ctypes.c_int, ctypes.POINTER(Calibration))
    ),
    "k4a_device_get_capture": (ctypes.c_int, (_POINTER, _HANDLE, ctypes.c_int32)),
    "k4a_capture_get_depth_image": (_POINTER, (_POINTER,)),
    "k4a_capture_release": (None, (_POINTER,)),
    "k4a_image_get_buffer": (_POINTER, (_POINTER,)),
    "k4a_image_get_width_pixels": (ctypes.c_int, (_POINTER,)),
    "k4a_image_get_height_pixels": (ctypes.c_int, (_POINTER,)),
    "k4a_image_get_stride_bytes": (ctypes.c_int, (_POINTER,)),
    "k4a_image_get_device_timestamp_usec": (ctypes.c_uint64, (_POINTER,)),
    "k4a_image_release": (None, (_POINTER,)),
}  # fmt: skip


def _candidates() -> Iterator[str]:
    """Paths of the library: the system's first, then those in the package pyk4a-bundle."""
    if library := ctypes.util.find_library("k4a"):
        yield library
    spec = importlib.util.find_spec("pyk4a")
    if spec is None or spec.origin is None:
        return
    package = Path(spec.origin).parent
    folders = (package, package.parent / "pyk4a_bundle.libs")
    # The SDK looks up its depth engine by name, and finds one that is already loaded.
    for engine in (path for folder in folders for path in folder.glob("*depthengine*")):
        with contextlib.suppress(OSError):
            ctypes.CDLL(str(engine), mode=ctypes.RTLD_GLOBAL)
    for folder in folders:
        yield from (str(path) for pattern in ("libk4a[-.]*", "k4a.dll") for path in sorted(folder.glob(pattern)))


@functools.cache
def load() -> Any:
    """The library.

    Raises:
        InputError: when it is not installed.
    """
    os.environ.setdefault("K4A_LOG_LEVEL", "c")  # otherwise it prints an error whenever no camera is connected
    for path in _candidates():
        with contextlib.suppress(OSError):
            return declare(ctypes.CDLL(path))
    raise missing_extra("pyk4a-bundle", "azure")


def declare(library: Any) -> Any:
    """Declare the types of the library's functions; returns the library."""
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


class Device:
    """One opened camera."""

    def __init__(self, library: Any, index: int) -> None:
        """Open the camera. Raises K4aError when it is in use, or this user may not open it."""
        self._sdk, self._handle = library, ctypes.c_void_p()
        self._running = False
        if library.k4a_device_open(index, ctypes.byref(self._handle)) != 0:
            raise K4aError("k4a_device_open failed")

    @property
    def serial(self) -> str:
        """The serial number."""
        text, size = ctypes.create_string_buffer(64), ctypes.c_size_t(64)
        if self._sdk.k4a_device_get_serialnum(self._handle, text, ctypes.byref(size)) != 0:
            raise K4aError("k4a_device_get_serialnum failed")
        return text.value.decode(errors="replace")

    def start(self, mode: Mode) -> Lens:
        """Start depth in one of ``MODES``; returns the calibration of its pictures. Raises K4aError."""
        depth_mode = _MODES[mode.name]
        configuration = _Configuration(
            color_resolution=_COLOR_OFF, depth_mode=depth_mode, camera_fps=_RATES[mode.fps],
            synchronized_images_only=False,
        )  # fmt: skip
        if self._sdk.k4a_device_start_cameras(self._handle, ctypes.byref(configuration)) != 0:
            raise K4aError("k4a_device_start_cameras failed")
        self._running = True
        calibration = Calibration()
        if self._sdk.k4a_device_get_calibration(self._handle, depth_mode, _COLOR_OFF, ctypes.byref(calibration)) != 0:
            raise K4aError("k4a_device_get_calibration failed")
        return calibration.depth

    def depth(self, timeout_ms: int) -> tuple[UInt16[ndarray, "h w"], int] | None:
        """The next depth picture (mm) and its device time (µs); None after a timeout, or for a capture without depth.

        Raises:
            K4aError: when the camera was lost.
        """
        capture = ctypes.c_void_p()
        result = self._sdk.k4a_device_get_capture(self._handle, ctypes.byref(capture), timeout_ms)
        if result == _TIMEOUT:
            return None
        if result != 0:
            raise K4aError("k4a_device_get_capture failed")
        image = self._sdk.k4a_capture_get_depth_image(capture)
        try:
            return None if image is None else self._copy(image)
        finally:
            if image is not None:
                self._sdk.k4a_image_release(image)
            self._sdk.k4a_capture_release(capture)

    def _copy(self, image: int) -> tuple[UInt16[ndarray, "h w"], int]:
        sdk = self._sdk
        width, height = sdk.k4a_image_get_width_pixels(image), sdk.k4a_image_get_height_pixels(image)
        stride = sdk.k4a_image_get_stride_bytes(image) // 2
        words = (ctypes.c_uint16 * (stride * height)).from_address(sdk.k4a_image_get_buffer(image))
        rows = np.ctypeslib.as_array(words).reshape(height, stride)
        return np.array(rows[:, :width]), sdk.k4a_image_get_device_timestamp_usec(image)

    def close(self) -> None:
        """Stop and close the camera."""
        if self._running:
            self._sdk.k4a_device_stop_cameras(self._handle)
        self._sdk.k4a_device_close(self._handle)
