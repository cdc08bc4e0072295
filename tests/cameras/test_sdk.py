"""Finding out what is wrong with a camera: packages, USB devices, choosing one of several."""

import dataclasses
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from depthmocap.cameras import sdk
from depthmocap.cameras.sdk import CameraMake, checked
from depthmocap.cameras.source import CameraError
from depthmocap.cameras.usb import UsbDevice, usb_devices
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera

MAKE = CameraMake("toy", "Toy camera", "toy-package", "toymodule", lambda usb: usb.vendor == 0x1234, usb3=True)


def plug(root: Path, name: str, **files: str) -> None:
    folder = root / "sys" / name
    folder.mkdir(parents=True)
    for key, value in files.items():
        (folder / key).write_text(value + "\n")


@pytest.fixture
def usb(tmp_path: Path) -> list[UsbDevice]:
    """A computer with a hub's interface, a good device, a slow one and one without permission."""
    plug(tmp_path, "1-0:1.0", bInterfaceClass="09")
    for number, speed, serial in ((3, "5000", "A"), (4, "480", "B"), (5, "5000", "C")):
        plug(
            tmp_path, f"1-{number}", idVendor="1234", idProduct="00ff", busnum="1", devnum=str(number), speed=speed,
            serial=serial, product=f"Toy {serial}",
        )  # fmt: skip
    plug(tmp_path, "2-1", idVendor="0001", idProduct="0002", busnum="2", devnum="1", speed="12")
    nodes = tmp_path / "dev" / "001"
    nodes.mkdir(parents=True)
    for number in (3, 4):
        (nodes / f"{number:03d}").touch()  # the third's node is missing: as good as forbidden, also for root
    return usb_devices(tmp_path / "sys", tmp_path / "dev")


def test_usb_devices(usb: list[UsbDevice], tmp_path: Path) -> None:
    assert [(each.vendor, each.product, each.serial, each.name) for each in usb] == [
        (0x1234, 0xFF, "A", "Toy A"), (0x1234, 0xFF, "B", "Toy B"), (0x1234, 0xFF, "C", "Toy C"), (1, 2, "", "")
    ]  # fmt: skip
    good, slow, forbidden, _ = usb
    assert good.problem(usb3=True) == ""
    assert "USB 2 (480 Mbit/s): use a USB 3 port" in slow.problem(usb3=True)
    assert slow.problem(usb3=False) == ""
    assert "may not open" in forbidden.problem(usb3=True)
    assert "001/005" in forbidden.problem(usb3=True)
    assert usb_devices(tmp_path / "nothing") == []


def test_a_package_that_is_missing_or_broken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'toy-package': pip install 'depthmocap\[toy\]'"):
        MAKE.load()
    monkeypatch.syspath_prepend(tmp_path)
    for body in ("import no_such_thing", "raise ImportError('libtoy.so: cannot open shared object file')"):
        (tmp_path / "toymodule.py").write_text(body)
        with pytest.raises(InputError, match=r"is installed but cannot be loaded: .*(no_such_thing|libtoy.so)"):
            MAKE.load()
    monkeypatch.setitem(sys.modules, "toymodule", types.ModuleType("toymodule"))
    assert MAKE.load().__name__ == "toymodule"


def test_choosing(monkeypatch: pytest.MonkeyPatch, usb: list[UsbDevice]) -> None:
    monkeypatch.setattr(sdk, "usb_devices", lambda: usb)
    assert MAKE.choose(["A", "B"], "B") == 1
    assert MAKE.choose(["A", "B"], "") == 0
    with pytest.raises(CameraError, match="serial number X: connected are A, one that does not tell its number"):
        MAKE.choose(["A", ""], "X")
    with pytest.raises(CameraError, match="2 cameras are toy:A: connect one of them"):
        MAKE.choose(["A", "A"], "A")
    with pytest.raises(CameraError, match="no Toy camera can be used: it is connected by USB 2"):
        MAKE.choose([], "")
    monkeypatch.setattr(sdk, "usb_devices", lambda: usb[:1])
    with pytest.raises(CameraError, match="no Toy camera is connected: check power and cable"):
        MAKE.choose([], "")


def test_the_list_tells_what_the_sdk_does_not_see(monkeypatch: pytest.MonkeyPatch, usb: list[UsbDevice]) -> None:
    monkeypatch.setattr(sdk, "usb_devices", lambda: usb)
    seen = MAKE.list_cameras([("A", "Toy 2"), ("B", "Toy 2")])
    assert [(each.spec, each.model, bool(each.problem)) for each in seen] == [
        ("toy:A", "Toy 2", False), ("toy:B", "Toy 2", True)
    ]  # fmt: skip
    assert [bool(each.problem) for each in MAKE.list_cameras([("A", "Toy"), ("D", "Toy"), ("D", "Toy")])] == [
        False,
        True,
        True,
    ]
    unseen = {each.serial: each.problem for each in MAKE.list_cameras([])}
    assert set(unseen) == {"A", "B", "C"}
    assert "does not see it" in unseen["A"]
    assert "USB 2" in unseen["B"]
    assert "may not open" in unseen["C"]


def test_why_it_failed(monkeypatch: pytest.MonkeyPatch, usb: list[UsbDevice]) -> None:
    monkeypatch.setattr(sdk, "usb_devices", lambda: usb)
    for serial, said, told in (
        ("B", "error 5", "USB 2.*error 5"),
        ("C", "", "may not open"),
        ("A", "LIBUSB_ERROR_BUSY", "in use: close the other program"),
        ("A", "LIBUSB_ERROR_ACCESS", "may not use camera 'left': (install the udev rules|let programs use)"),
        ("A", "", "may be in use by another program$"),
    ):
        with pytest.raises(CameraError, match=told):
            raise MAKE.start_error("left", said, serial)


@pytest.mark.parametrize("change", [{"fx": 0.0}, {"fy": float("nan")}, {"depth_unit_m": 0.0}, {"width": 0}])
def test_a_calibration_that_cannot_be(change: dict[str, Any]) -> None:
    good = DepthCamera(name="left", width=8, height=6, fx=7.0, fy=7.0, cx=4.0, cy=3.0)
    assert checked(good).name == "left"
    with pytest.raises(CameraError, match="'left' tells no usable calibration"):
        checked(dataclasses.replace(good, **change))
