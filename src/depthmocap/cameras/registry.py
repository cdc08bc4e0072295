"""Opens cameras by the text that a user types, and lists the connected ones (``depthmocap cameras``)."""

from __future__ import annotations

import dataclasses
import importlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from depthmocap.cameras.modes import ModeRequest
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.source import OPEN_S, CameraError, ConnectedCamera, DepthSource
from depthmocap.cameras.time_limit import CallTimeoutError, call_with_timeout
from depthmocap.core.camera_names import safe_name
from depthmocap.core.console import Terminal
from depthmocap.errors import InputError

#: The module of each back end. It has ``find_cameras()``, which lists the connected devices, and
#: ``make_source(name, address, request)``, which gives a source.
BACK_ENDS = {
    "realsense": "depthmocap.cameras.realsense",
    "azure": "depthmocap.cameras.azure_kinect",
    "orbbec": "depthmocap.cameras.orbbec",
    "kinect2": "depthmocap.cameras.kinect2",
    "openni": "depthmocap.cameras.openni",
}
#: Name of the source of recordings that are played like cameras.
RECORDED = "recording"
#: Name of the source of generated people.
SYNTHETIC = "synthetic"
#: Their modules. Each has ``make_sources(address, request, playback_clock)``, which gives the cameras of one recording
#: or scene. They belong to higher packages, so they are imported by name.
_PLAYED = {RECORDED: "depthmocap.recordings.recorded_camera", SYNTHETIC: "depthmocap.synth.synthetic_camera"}
#: Name endings of SDK recordings that stand as the address of a camera.
_FILES = (".oni", ".bag", ".db3", ".mcap")


@dataclasses.dataclass(frozen=True)
class _Spec:
    """The text for a camera: ``[NAME=]KIND[:ADDRESS][?MODE]``, or ``synthetic[#NAME][?MODE]``."""

    name: str
    kind: str
    address: str
    request: ModeRequest

    @classmethod
    def parse(cls, spec: str) -> _Spec | None:
        """Split the text into its parts; None if it names no kind of camera.

        Raises:
            InputError: when the text after the ``?`` is not a mode.
        """
        device = rf"(?:(?P<name>.*?)=)??(?P<kind>{'|'.join(BACK_ENDS)})(?::(?P<address>.*?))?"
        # No slash in it: URIs of OpenNI on Windows have a question mark too.
        mode = r"(?:\?(?P<asked>[^?/\\]*))?"
        match = re.fullmatch(rf"(?:{device}|{SYNTHETIC}(?:#(?P<one>.*?))?){mode}", spec, re.DOTALL)
        if match is None:
            return None
        if match["kind"] is None:
            address = match["one"] or ""
        else:
            address = match["address"] or ""
            if match["asked"] is not None and Path(whole := f"{address}?{match['asked']}").exists():
                return cls(match["name"] or "", match["kind"], whole, ModeRequest())
        request = ModeRequest() if match["asked"] is None else ModeRequest.parse(spec, match["asked"])
        return cls(match["name"] or "", match["kind"] or SYNTHETIC, address, request)


def make_sources(
    specs: Sequence[str], playback_clock: PlaybackClock | None = None, tell: Callable[[str], None] = lambda line: None
) -> list[DepthSource]:
    """Make unopened sources from the texts that a user types.

    ``[NAME=]realsense[:SERIAL]`` and the like are devices, the first one without a serial number. Each may have
    ``?mode=NAME&size=WIDTHxHEIGHT&fps=NUMBER`` or part of that. A path is a recording with all its cameras, and
    ``PATH#NAME`` is one of them. ``synthetic`` is the generator, and ``synthetic#NAME`` is one of its cameras.

    Args:
        tell: is called with a line of text before a step that takes long.

    Raises:
        InputError: when a spec is none of these, or two cameras have one name or are one device.
    """
    playback_clock = playback_clock or PlaybackClock()
    sources: list[DepthSource] = []
    devices: dict[tuple[str, str], str] = {}
    for text in specs:
        if "\0" in text:
            raise InputError(f"{text} has a zero byte in it, which no path or address has")
        spec = _Spec.parse(text)
        if spec is None:
            sources += importlib.import_module(_PLAYED[RECORDED]).make_sources(text, ModeRequest(), playback_clock)
        elif spec.kind == SYNTHETIC:
            tell(
                "making the synthetic scene: the first time on a machine takes a minute or two, because it is compiled"
            )
            sources += importlib.import_module(_PLAYED[SYNTHETIC]).make_sources(
                spec.address, spec.request, playback_clock
            )
        else:
            for (kind, address), earlier in devices.items():
                # Without a serial number the first camera is used, which may be any.
                if kind == spec.kind and (address == spec.address or "" in (address, spec.address)):
                    raise InputError(f"{earlier} and {text} may be one device: give each its own serial number")
            devices[spec.kind, spec.address] = text
            module = importlib.import_module(BACK_ENDS[spec.kind])
            name = spec.name or _default_name(spec.kind, spec.address)
            sources.append(module.make_source(name, spec.address, spec.request))
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"two cameras are called {name!r}: put another name before one, as in left=realsense:SERIAL"
            )
    return sources


@dataclasses.dataclass(frozen=True)
class DeviceText:
    """The parts of the text for one device: the name that its camera gets, what opens it, and its mode."""

    name: str
    device: str
    mode: str

    def renamed(self, name: str, mode: str) -> str:
        """The text for the device under another name and in another mode."""
        return f"{name}={self.device}{'?' if mode else ''}{mode}"


def device_text(spec: str) -> DeviceText | None:
    """The parts of a text; None if it is not of a device, whose name and mode can be chosen.

    Raises:
        InputError: when the text after the ``?`` is not a mode.
    """
    parsed = _Spec.parse(spec)
    if parsed is None or parsed.kind == SYNTHETIC:
        return None
    device = f"{parsed.kind}:{parsed.address}" if parsed.address else parsed.kind
    mode = "" if parsed.request == ModeRequest() else spec.rpartition("?")[2]
    return DeviceText(parsed.name or _default_name(parsed.kind, parsed.address), device, mode)


def _default_name(back_end: str, address: str) -> str:
    """A camera's name if the user gives none."""
    stem = Path(address).stem if Path(address).suffix.lower() in _FILES else address
    return safe_name(re.sub(r"[^\w.-]+", "-", f"{back_end}-{stem}" if stem else back_end))


@dataclasses.dataclass(frozen=True)
class CamerasSettings:
    """List the depth cameras that are connected."""


def find_cameras() -> tuple[list[ConnectedCamera], dict[str, str]]:
    """The connected devices of all back ends, and the reason for each back end that could not list its devices."""
    connected: list[ConnectedCamera] = []
    failures: dict[str, str] = {}
    for back_end, module in BACK_ENDS.items():
        try:
            connected += call_with_timeout(OPEN_S, importlib.import_module(module).find_cameras)
        except CallTimeoutError:
            failures[back_end] = f"its SDK did not answer for {OPEN_S:.0f} s: unplug its cameras and plug them in again"
        except InputError as error:
            failures[back_end] = str(error)
        except Exception as error:  # whatever an SDK raises, the others are listed
            failures[back_end] = f"its SDK failed: {error or type(error).__name__}"
    return connected, failures


def list_cameras(settings: CamerasSettings, console: Console | None = None) -> list[ConnectedCamera]:
    """Print the connected cameras, and the reason for each kind of camera that could not be listed."""
    console = console or Terminal()
    connected, failures = find_cameras()
    table = Table()
    for column in ("camera", "model", "serial", "problem"):
        table.add_column(column)
    for camera in connected:
        table.add_row(camera.spec, camera.model, camera.serial, camera.problem)
    console.print(table if connected else "no depth camera was found")
    for back_end, reason in failures.items():
        console.print(f"• {back_end}: {reason}")
    return connected


def open_camera(spec: str, playback_clock: PlaybackClock | None = None) -> DepthSource:
    """The source of one camera, for a with statement. ``make_sources`` describes the form of ``spec``.

    Raises:
        InputError: when ``spec`` names no camera, or several.
    """
    sources = make_sources([spec], playback_clock)
    if len(sources) != 1:
        names = ", ".join(source.name for source in sources)
        raise CameraError(f"{spec} has the cameras {names}: choose one as {spec}#{sources[0].name}")
    return sources[0]
