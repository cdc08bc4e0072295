"""Azure Kinect (and Femto Bolt by Orbbec's wrapper of its SDK) through ``pyk4a``; MKV recordings of its recorder too.

Written from the SDK's and pyk4a's documentation; untested on hardware.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.capture.source import CameraError, DepthFrame, DepthSource, FoundCamera, NoFrame
from depthmocap.errors import missing_extra
from depthmocap.geometry import DepthCamera

#: The SDK gives depth in millimetres.
_UNIT_M = 0.001
#: Half the diagonal field of view (tangent) over which the lens is fitted: the narrow mode's 75° × 65°.
_FIELD = 1.0


def load_sdk() -> Any:
    """pyk4a. Raises InputError when it, or the SDK under it, is not installed."""
    try:
        import pyk4a  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise missing_extra("pyk4a-bundle", "azure") from None
    return pyk4a


def find() -> list[FoundCamera]:
    """The connected cameras. A serial number can only be read of one that is not in use."""
    sdk = load_sdk()
    found = []
    for index in range(sdk.connected_device_count()):
        device = sdk.PyK4A(device_id=index)
        try:
            device.open()
            serial = device.serial
            device.close()
        except sdk.K4AException:
            found.append(FoundCamera("azure", "Azure Kinect", "", "in use, or this user may not open it"))
        else:
            found.append(FoundCamera(f"azure:{serial}", "Azure Kinect", serial))
    return found


def make(name: str, address: str) -> DepthSource:
    """The camera with this serial number, the first, or an MKV recording."""
    return AzureKinect(name, address)


def five_coefficients(eight: Float[ndarray, "8"]) -> tuple[float, float, float, float, float]:
    """k1, k2, p1, p2, k3 nearest to OpenCV's rational lens model (k1, k2, p1, p2, k3, k4, k5, k6) over the field.

    Least squares of the radial factor at radii weighted by the pixels there; the tangential part is the same.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = eight.tolist()
    r2 = np.linspace(0, _FIELD, 200) ** 2
    factor = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    powers = np.stack([r2, r2**2, r2**3], 1)
    weight = r2[:, None] ** 0.75  # displacement is radius × factor, and pixels grow with the radius
    a, b, c = np.linalg.lstsq(powers * weight, (factor - 1) * weight[:, 0], rcond=None)[0].tolist()
    return a, b, p1, p2, c


class AzureKinect(DepthSource):
    """One camera's depth in the narrow unbinned mode (640×576, 30 a second), or an MKV recording's."""

    def __init__(self, name: str, address: str = "") -> None:
        """``address``: a serial number, the path of an MKV file, or nothing for the first camera."""
        super().__init__(name)
        self._address = address
        self._playback = address.lower().endswith(".mkv")

    def _open(self) -> DepthCamera:
        sdk = self._sdk = load_sdk()
        if self._playback:
            if not Path(self._address).is_file():
                raise CameraError(f"{self._address} is not a file")
            self._device = sdk.PyK4APlayback(self._address)
            start = self._device.open
        else:
            config = sdk.Config(
                color_resolution=sdk.ColorResolution.OFF, depth_mode=sdk.DepthMode.NFOV_UNBINNED,
                camera_fps=sdk.FPS.FPS_30, synchronized_images_only=False,
            )  # fmt: skip
            self._device = sdk.PyK4A(config=config, device_id=self._index())
            start = self._device.start
        try:
            start()
        except sdk.K4AException as error:
            what = "is a damaged recording" if self._playback else (
                "cannot be started: it is in use, connected by USB 2, or this user may not use it (udev rules)"
            )  # fmt: skip
            raise CameraError(f"camera {self.name!r} {what} ({error})") from None
        try:
            return self._describe()
        except BaseException:
            self._close()
            raise

    def _describe(self) -> DepthCamera:
        sdk, calibration = self._sdk, self._device.calibration
        # The size is only in the pictures; the first is kept for the reader.
        self._waiting = self._capture(5.0)
        if self._waiting is None:
            raise CameraError(f"{self._address} has no depth frame")
        height, width = self._waiting.depth.shape
        matrix = np.asarray(calibration.get_camera_matrix(sdk.CalibrationType.DEPTH), np.float64)
        lens = np.asarray(calibration.get_distortion_coefficients(sdk.CalibrationType.DEPTH), np.float64)
        return DepthCamera(
            self.name, width, height, float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]),
            float(matrix[1, 2]), distortion=five_coefficients(lens), depth_unit_m=_UNIT_M,
        )  # fmt: skip

    def _index(self) -> int:
        found = find()
        if not found:
            raise CameraError(
                "no Azure Kinect is connected, or this user may not use it: check power, cable, udev rules"
            )
        if not self._address:
            return 0
        for index, camera in enumerate(found):
            if camera.serial == self._address:
                return index
        serials = ", ".join(camera.serial or camera.problem for camera in found)
        raise CameraError(f"no Azure Kinect has the serial number {self._address}: connected are {serials}")

    def _capture(self, timeout_s: float) -> Any:
        """The next capture with depth; None at a recording's end."""
        until = time.monotonic() + timeout_s
        while True:
            try:
                if self._playback:
                    capture = self._device.get_next_capture()
                else:
                    left_s = until - time.monotonic()
                    capture = self._device.get_capture(timeout=max(1, round(left_s * 1e3)))
            except EOFError:
                return None
            except self._sdk.K4ATimeoutException:
                raise NoFrame(f"camera {self.name!r} gave no frame for {timeout_s:.1f} s") from None
            except self._sdk.K4AException as error:
                raise CameraError(f"camera {self.name!r} was lost: {error}") from None
            if capture.depth is not None:
                return capture

    def _read(self, timeout_s: float) -> DepthFrame | None:
        capture, self._waiting = self._waiting or self._capture(timeout_s), None
        if capture is None:
            return None
        arrival_ns = time.monotonic_ns()
        raw = np.array(capture.depth, np.uint16)
        clock = f"azure {self._address or self.name} device"
        return DepthFrame(self.name, raw, int(capture.depth_timestamp_usec) * 1000, clock, arrival_ns)

    def _close(self) -> None:
        (self._device.close if self._playback else self._device.stop)()
