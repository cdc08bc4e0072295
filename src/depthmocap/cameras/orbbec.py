"""Orbbec cameras (Femto, Gemini, Astra), and the bag files that their SDK's viewer records, through ``pyorbbecsdk2``.

This module was written from the SDK's documentation and the signatures of its package; it was not tested on hardware.
Timestamps are by the camera's own clock.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from depthmocap.cameras.lens import five_coefficients
from depthmocap.cameras.modes import Mode, ModeRequest
from depthmocap.cameras.sdk import CameraMake, checked
from depthmocap.cameras.sdk_files import sdk_of
from depthmocap.cameras.source import CameraError, ConnectedCamera, DepthFrame, DepthSource, FrameTimeoutError
from depthmocap.geometry import DepthCamera

MAKE = CameraMake("orbbec", "Orbbec camera", "pyorbbecsdk2", "pyorbbecsdk", lambda usb: usb.vendor == 0x2BC5)
#: How long to wait (seconds) for a camera's first frame, which tells the depth scale.
_FIRST_FRAME_S = 5.0
#: Name endings of the recordings of the SDK's viewer.
RECORDED = (".bag", ".mcap")
#: The SDK's names of the lens models that ``five_coefficients`` covers.
_LENSES = ("NONE", "BROWN_CONRADY", "BROWN_CONRADY_K6")


def _disable_log_file(sdk: Any) -> None:
    """Without this, the SDK writes a folder Log into the current folder."""
    sdk.Context.set_logger_to_file(sdk.OBLogLevel.NONE, "")


def _devices(sdk: Any) -> tuple[Any, list[str]]:
    """The SDK's list of devices, and their serial numbers."""
    _disable_log_file(sdk)
    devices = sdk.Context().query_devices()
    return devices, [devices.get_device_serial_number_by_index(index) for index in range(devices.get_count())]


def find_cameras() -> list[ConnectedCamera]:
    """The cameras that are connected by USB or network."""
    devices, serials = _devices(MAKE.load())
    return MAKE.list_cameras([(serial, devices.get_device_name_by_index(i)) for i, serial in enumerate(serials)])


def make_source(name: str, address: str, request: ModeRequest) -> DepthSource:
    """The camera with this serial number, a bag file, or the first camera if ``address`` is empty."""
    return OrbbecCamera(name, address, request)


class OrbbecCamera(DepthSource):
    """One camera's depth, in the 16-bit mode nearest to the requested size and rate. A file plays at its own speed."""

    def __init__(self, name: str, address: str = "", request: ModeRequest | None = None) -> None:
        super().__init__(name)
        self._request = request or ModeRequest()
        self._file = Path(address) if address.lower().endswith(RECORDED) else None
        self._serial = "" if self._file else address
        self.reopens = self._file is None

    def _open(self) -> DepthCamera:
        sdk = self._sdk = MAKE.load()
        device = self._device = self._open_file(self._file) if self._file else self._choose_device()
        try:
            self._pipeline = sdk.Pipeline(device)
            profile = self._choose_profile(self._pipeline.get_stream_profile_list(sdk.OBSensorType.DEPTH_SENSOR))
            config = sdk.Config()
            config.enable_stream(profile)
            self._pipeline.start(config)
        except (sdk.OBError, RuntimeError) as error:
            raise MAKE.start_error(self.name, error, self._serial) from None
        try:
            first = self._frame(_FIRST_FRAME_S)
            camera = self._describe(profile, first)
        except CameraError:
            self._close()
            raise
        self._first_frame: Any = first
        return camera

    def _choose_device(self) -> Any:
        devices, serials = _devices(self._sdk)
        index = MAKE.choose(serials, self._serial)
        self._serial = serials[index]
        return devices.get_device_by_index(index)

    def _open_file(self, file: Path) -> Any:
        if not file.is_file():
            raise CameraError(f"{file} does not exist")
        if sdk_of(file) == "realsense":
            raise CameraError(f"{file} was recorded by a RealSense camera: name it realsense:{file}")
        _disable_log_file(self._sdk)
        try:
            device = self._sdk.PlaybackDevice(str(file))
            self._serial = device.get_device_info().get_serial_number()
        except (self._sdk.OBError, RuntimeError) as error:
            raise CameraError(f"{file} is no bag file of an Orbbec camera ({error})") from None
        return device

    def _file_ended(self) -> bool:
        """Whether the file was played to its end."""
        return self._file is not None and self._device.get_playback_status() == self._sdk.OBPlaybackStatus.STOPPED

    def _choose_profile(self, profiles: Any) -> Any:
        formats = (self._sdk.OBFormat.Y16, self._sdk.OBFormat.Z16)
        profiles_listed = [profiles.get_stream_profile_by_index(i) for i in range(profiles.get_count())]
        depth = [profile.as_video_stream_profile() for profile in profiles_listed if profile.get_format() in formats]
        if not depth:
            raise CameraError(f"camera {self.name!r} has no 16-bit depth stream")
        modes = [Mode(profile.get_width(), profile.get_height(), profile.get_fps()) for profile in depth]
        return depth[self._request.choose(self.name, modes)]

    def _describe(self, profile: Any, frame: Any) -> DepthCamera:
        intrinsic, lens = profile.get_intrinsic(), profile.get_distortion()
        coefficients = np.array(
            [getattr(lens, name) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")], np.float64
        )
        model = getattr(lens, "model", None)  # the package's first versions do not tell it
        if model is not None and model.name not in _LENSES and coefficients.any():
            raise CameraError(f"camera {self.name!r} has the lens model {model.name}: expected Brown-Conrady")
        # The SDK gives the depth scale in millimetres.
        return checked(DepthCamera(
            self.name, frame.get_width(), frame.get_height(), intrinsic.fx, intrinsic.fy, intrinsic.cx, intrinsic.cy,
            distortion=five_coefficients(coefficients), depth_unit_m=frame.get_depth_scale() / 1000,
        ))  # fmt: skip

    def _frame(self, timeout_s: float) -> Any:
        """The SDK's next depth frame."""
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            try:
                frames = self._pipeline.wait_for_frames(max(1, round(left_s * 1e3)))
            except (self._sdk.OBError, RuntimeError) as error:
                raise CameraError(f"camera {self.name!r} failed: {error}") from None
            if frames is not None and (depth := frames.get_depth_frame()) is not None:
                return depth
        raise self._frame_timeout(timeout_s)

    def _read(self, timeout_s: float) -> DepthFrame | None:
        ended = self._file_ended()  # asked first: frames may still wait after the file has ended
        try:
            frame, self._first_frame = self._first_frame or self._frame(timeout_s), None
        except FrameTimeoutError:
            if ended:
                return None
            raise
        arrival_ns = time.monotonic_ns()
        size = frame.get_height(), frame.get_width()
        raw = np.array(frame.get_data()).view(np.uint16).reshape(size)  # a copy: the SDK reuses its buffers
        clock = f"orbbec {self._serial} device"
        return DepthFrame(self.name, raw, frame.get_timestamp_us() * 1000, clock, arrival_ns, frame.get_index())

    def _close(self) -> None:
        self._pipeline.stop()
