"""A camera of your own: a class with three functions, and everything else follows.

`Device` stands for the SDK of your camera; here it plays the frames of a folder. `MyCamera` is what you write.

python examples/03_own_camera.py RECORDING_FOLDER
"""

import sys
import time
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray

import depthmocap


class Device:
    """The SDK: it is opened, gives 16-bit pictures with the device's own time, and is closed."""

    width, height, focal_px, centre_px, metres_a_step = 320, 288, 252.25, (160.7, 165.8), 0.001
    _clock_ahead_ns: int | None = None  # one clock for all devices, as a trigger wire gives them

    def __init__(self, folder: Path) -> None:
        self._files = sorted(path for path in folder.glob("*.png") if path.stem.isdecimal())

    def wait_for_picture(self, seconds: float) -> tuple[int, ndarray] | None:
        """Device time in nanoseconds and depth, as soon as it is taken; None once the device is at its end.

        Raises:
            TimeoutError: when there is none within so many seconds.
        """
        if not self._files:
            return None
        taken_ns = int(self._files[0].stem)
        if Device._clock_ahead_ns is None:
            Device._clock_ahead_ns = taken_ns - time.monotonic_ns()
        due_s = (taken_ns - Device._clock_ahead_ns - time.monotonic_ns()) * 1e-9
        time.sleep(min(max(due_s, 0), seconds))
        if due_s > seconds:
            raise TimeoutError
        return taken_ns, np.asarray(cv2.imread(str(self._files.pop(0)), cv2.IMREAD_UNCHANGED), np.uint16)

    def stop(self) -> None:
        self._files.clear()


class MyCamera(depthmocap.DepthSource):
    """Opens, reads and closes one device. The name is that of the camera in rig.json."""

    def __init__(self, name: str, folder: Path) -> None:
        super().__init__(name)
        self._folder, self._number = folder, 0

    def _open(self) -> depthmocap.DepthCamera:
        if not self._folder.is_dir():
            raise depthmocap.CameraError(
                f"camera {self.name!r}: there is no {self._folder}"
            )  # one line that says what to do
        self._device = Device(self._folder)
        cx, cy = Device.centre_px
        return depthmocap.DepthCamera(
            self.name, Device.width, Device.height, Device.focal_px, Device.focal_px, cx, cy,
            depth_unit_m=Device.metres_a_step,
        )  # fmt: skip

    def _read(self, timeout_s: float) -> depthmocap.DepthFrame | None:
        try:
            picture = self._device.wait_for_picture(timeout_s)
        except TimeoutError:
            raise depthmocap.FrameTimeoutError(f"camera {self.name!r}: no frame in {timeout_s:.1f} s") from None
        arrival_ns = time.monotonic_ns()  # before anything else is done
        if picture is None:
            return None
        timestamp_ns, raw = picture
        self._number += 1
        # Frames whose clocks have one name are compared as they are; other clocks are related by arrival times.
        return depthmocap.DepthFrame(self.name, raw, timestamp_ns, "trigger wire", arrival_ns, self._number)

    def _close(self) -> None:
        self._device.stop()


def main(recording: Path) -> None:
    """Motion capture of all cameras of a folder, each read by `MyCamera`."""
    rig = depthmocap.load_rig(recording / "rig.json")
    results = depthmocap.live(*(MyCamera(name, recording / name) for name in rig.names), rig=rig)
    pelvis = depthmocap.JOINTS.index("Hip")
    for result in results:
        pose = result.pose
        if pose.confidence.max() == 0:
            continue  # nobody in view yet
        x, y, z = pose.joints[pelvis]
        print(f"{pose.timestamp_ns}: pelvis at {x:.2f} {y:.2f} {z:.2f} m")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
