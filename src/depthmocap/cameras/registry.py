"""Cameras by name: what a user types to open one, and ``depthmocap cameras``, the list of those that are connected."""

from __future__ import annotations

import dataclasses
import importlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from depthmocap.cameras.modes import Wanted
from depthmocap.cameras.pace import Pace
from depthmocap.cameras.source import OPEN_S, CameraError, DepthSource, FoundCamera
from depthmocap.cameras.time_limit import HangsError, within
from depthmocap.core.console import Terminal
from depthmocap.core.names import safe_name
from depthmocap.errors import InputError

#: Module of each back end. It has ``find()``, the connected devices, and ``make(name, address, wanted)``, a source.
BACK_ENDS = {
    "realsense": "depthmocap.cameras.realsense",
    "azure": "depthmocap.cameras.azure_kinect",
    "orbbec": "depthmocap.cameras.orbbec",
    "kinect2": "depthmocap.cameras.kinect2",
    "openni": "depthmocap.cameras.openni",
}
#: Modules of what is played like cameras. Each has ``make_sources(address, wanted, pace)``, the cameras of one take;
#: they stand above this package and are found by their names.
RECORDED, SYNTHETIC = "recording", "synthetic"
_PLAYED = {RECORDED: "depthmocap.recordings.recorded_camera", SYNTHETIC: "depthmocap.synth.synthetic_camera"}
#: Recordings of SDKs that are given like cameras.
_FILES = (".oni", ".bag")


@dataclasses.dataclass(frozen=True)
class _Spec:
    """What a user types for a camera: ``[NAME=]KIND[:ADDRESS][?MODE]``, or ``synthetic[#NAME][?MODE]``."""

    name: str
    kind: str
    address: str
    wanted: Wanted

    @classmethod
    def parse(cls, spec: str) -> _Spec | None:
        """Its parts; None where it names no kind of camera.

        Raises:
            InputError: when what stands after the ``?`` asks for no mode.
        """
        device = rf"(?:(?P<name>.*?)=)??(?P<kind>{'|'.join(BACK_ENDS)})(?::(?P<address>.*?))?"
        # No slash in it: URIs of OpenNI on Windows have a question mark too.
        asked = r"(?:\?(?P<asked>[^?/\\]*))?"
        found = re.fullmatch(rf"(?:{device}|{SYNTHETIC}(?:#(?P<one>.*?))?){asked}", spec, re.DOTALL)
        if found is None:
            return None
        if found["kind"] is None:
            address = found["one"] or ""
        else:
            address = found["address"] or ""
            if found["asked"] is not None and Path(whole := f"{address}?{found['asked']}").exists():
                return cls(found["name"] or "", found["kind"], whole, Wanted())
        wanted = Wanted() if found["asked"] is None else Wanted.parse(spec, found["asked"])
        return cls(found["name"] or "", found["kind"] or SYNTHETIC, address, wanted)


def make_sources(
    specs: Sequence[str], pace: Pace | None = None, tell: Callable[[str], None] = lambda line: None
) -> list[DepthSource]:
    """Sources, not opened yet, by what a user types.

    ``[NAME=]realsense[:SERIAL]`` and the like are devices, the first that is found without a serial number, each with
    ``?mode=NAME&size=WIDTHxHEIGHT&fps=NUMBER`` or part of that; a path is a recording with all its cameras,
    ``PATH#NAME`` one of them; ``synthetic`` is the generator, ``synthetic#NAME`` one of its cameras.

    Args:
        tell: takes a line before something that takes long.

    Raises:
        InputError: when a spec is none of these, or two cameras have one name or are one device.
    """
    pace = pace or Pace()
    sources: list[DepthSource] = []
    devices: dict[tuple[str, str], str] = {}
    for given in specs:
        if "\0" in given:
            raise InputError(f"{given} has a zero byte in it, which no path or address has")
        spec = _Spec.parse(given)
        if spec is None:
            sources += importlib.import_module(_PLAYED[RECORDED]).make_sources(given, Wanted(), pace)
        elif spec.kind == SYNTHETIC:
            tell(
                "making the synthetic scene: the first time on a machine takes a minute or two, because it is compiled"
            )
            sources += importlib.import_module(_PLAYED[SYNTHETIC]).make_sources(spec.address, spec.wanted, pace)
        else:
            for (kind, address), other in devices.items():
                # One without a serial number is the first that is found, which may be any.
                if kind == spec.kind and (address == spec.address or "" in (address, spec.address)):
                    raise InputError(f"{other} and {given} may be one device: give each its own serial number")
            devices[spec.kind, spec.address] = given
            module = importlib.import_module(BACK_ENDS[spec.kind])
            name = spec.name or _called(spec.kind, spec.address)
            sources.append(module.make(name, spec.address, spec.wanted))
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"two cameras are called {name!r}: put another name before one, as in left=realsense:SERIAL"
            )
    return sources


def _called(back_end: str, address: str) -> str:
    """A camera's name where the user gives none."""
    stem = Path(address).stem if Path(address).suffix.lower() in _FILES else address
    return safe_name(re.sub(r"[^\w.-]+", "-", f"{back_end}-{stem}" if stem else back_end))


@dataclasses.dataclass(frozen=True)
class CamerasSettings:
    """List the depth cameras that are connected."""


def find_cameras() -> tuple[list[FoundCamera], dict[str, str]]:
    """The connected devices of all back ends, and why a back end could not look, by its name."""
    found: list[FoundCamera] = []
    unable: dict[str, str] = {}
    for back_end, module in BACK_ENDS.items():
        try:
            found += within(OPEN_S, importlib.import_module(module).find)
        except HangsError:
            unable[back_end] = f"its SDK did not answer for {OPEN_S:.0f} s: unplug its cameras and plug them in again"
        except InputError as error:
            unable[back_end] = str(error)
        except Exception as error:  # whatever an SDK raises, the others are listed
            unable[back_end] = f"its SDK failed: {error or type(error).__name__}"
    return found, unable


def list_cameras(settings: CamerasSettings, console: Console | None = None) -> list[FoundCamera]:
    """Print the connected cameras, and for each kind that could not be looked for what is missing."""
    console = console or Terminal()
    found, unable = find_cameras()
    table = Table()
    for column in ("camera", "model", "serial", "problem"):
        table.add_column(column)
    for camera in found:
        table.add_row(camera.spec, camera.model, camera.serial, camera.problem)
    console.print(table if found else "no depth camera was found")
    for back_end, reason in unable.items():
        console.print(f"• {back_end}: {reason}")
    return found


def open_camera(spec: str, pace: Pace | None = None) -> DepthSource:
    """The one source that a spec names (see ``make_sources``), for a with statement.

    Raises:
        InputError: when it names none, or several.
    """
    sources = make_sources([spec], pace)
    if len(sources) != 1:
        names = ", ".join(source.name for source in sources)
        raise CameraError(f"{spec} has the cameras {names}: choose one as {spec}#{sources[0].name}")
    return sources[0]
