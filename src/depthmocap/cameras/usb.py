"""USB devices on Linux: connection speed and access rights, which explain why an SDK cannot open a camera."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

_ROOT = Path("/sys/bus/usb/devices")
_NODES = Path("/dev/bus/usb")
#: Lowest speed of USB 3 (Mbit/s).
_USB3_MBPS = 5000


@dataclasses.dataclass(frozen=True)
class UsbDevice:
    """A device as sysfs describes it. ``speed_mbps`` is the speed of its connection; an SDK opens the file ``node``."""

    vendor: int
    product: int
    name: str
    serial: str
    speed_mbps: float
    node: Path

    def problem(self, usb3: bool) -> str:
        """The reason why no SDK can use the device; empty if there is none. ``usb3``: the camera needs USB 3."""
        if not os.access(self.node, os.R_OK | os.W_OK):
            return f"this user may not open {self.node}: install the udev rules of its SDK, and plug it in again"
        if usb3 and self.speed_mbps < _USB3_MBPS:
            return f"it is connected by USB 2 ({self.speed_mbps:.0f} Mbit/s): use a USB 3 port and cable"
        return ""


def usb_devices(root: Path = _ROOT, nodes: Path = _NODES) -> list[UsbDevice]:
    """The USB devices of this computer; empty on systems without sysfs."""

    def read(folder: Path, name: str) -> str:
        try:
            return (folder / name).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return ""

    devices = []
    for folder in sorted(root.glob("*")):
        try:
            vendor, product = int(read(folder, "idVendor"), 16), int(read(folder, "idProduct"), 16)
            bus, number = int(read(folder, "busnum")), int(read(folder, "devnum"))
            speed = float(read(folder, "speed") or "nan")
        except ValueError:  # an interface of a device, or one that was just unplugged
            continue
        node = nodes / f"{bus:03d}" / f"{number:03d}"
        devices.append(UsbDevice(vendor, product, read(folder, "product"), read(folder, "serial"), speed, node))
    return devices
