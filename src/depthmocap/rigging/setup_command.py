"""``depthmocap setup``: from cameras that were just plugged in to a rig and a skeleton, while a person walks about."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table

from depthmocap.calibration.calibrate import Calibration, calibration_lines, print_calibration
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import find_cameras, make_sources
from depthmocap.cameras.source import DepthSource
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.errors import InputError, missing_extra
from depthmocap.geometry import Rig, save_rig
from depthmocap.realtime.live_capture import announce_if_slow
from depthmocap.realtime.live_command import LiveSettings, run_live
from depthmocap.recordings.open_recording import open_recording, packaged_recording
from depthmocap.rigging.rig_faults import connection_faults
from depthmocap.rigging.rig_session import RigSession, RigState
from depthmocap.rigging.walk_observer import WalkObserver
from depthmocap.text import joined

if TYPE_CHECKING:
    from depthmocap.rigging.setup_page import SetupPage
    from depthmocap.viewing.viewer_page import Page

#: Seconds from one look at the state to the next.
_LOOK_S = 0.25


@dataclasses.dataclass(frozen=True)
class SetupSettings(NetworkSettings):
    """Set up cameras: one person walks about, and where the cameras stand is found meanwhile. Then the skeleton is
    shown live.

    Ctrl-C ends the walk, and writes the rig as it is then.

    Attributes:
        cameras: such as realsense:SERIAL or left=azure:SERIAL?mode=nfov, synthetic, or a recording with --realtime; by
            default all that are connected.
        out: the rig.json to write.
        realtime: play a recording at its own speed, as if it were cameras.
        seconds: end the walk after so long; by default it ends when all pairs of cameras are good.
        view: show it in the browser.
        live: go on with live motion capture.
        host: address to serve the page on; 0.0.0.0 lets other machines watch and change.
        port: of the page; 0 takes any that is free.
        open: open the page in the browser.
    """

    cameras: tuple[str, ...] = ()
    out: Path = Path("rig.json")
    realtime: bool = False
    seconds: float | None = None
    view: bool = True
    live: bool = True
    host: str = "127.0.0.1"
    port: int = 8080
    open: bool = True

    def __post_init__(self) -> None:
        if self.out.suffix.lower() != ".json":
            raise InputError(f"--out must end in .json, got {self.out}")
        if self.seconds is not None and not self.seconds > 0:
            raise InputError(f"--seconds must be positive, got {self.seconds}")


@locks_outputs(files=("out",))
def setup(settings: SetupSettings, console: Console | None = None) -> Rig:
    """Walk, write the rig, and go on with live motion capture; returns the rig.

    Raises:
        InputError: when there are no cameras, none can be opened, or no rig could be made.
    """
    console = console or Terminal(stderr=True)
    specs = _cameras(settings, console)
    sources = _make_sources(specs, console)
    with contextlib.ExitStack() as stack:
        page = _open_page(settings, console, stack) if settings.view else None
        classifier = _ready_classifier(settings, console)
        calibration, specs, cameras, interrupted = _walk(settings, specs, sources, classifier, page, console)
        save_rig(calibration.rig, settings.out)
        print_calibration(calibration, calibration_lines(calibration, cameras), console)
        console.print(f"{settings.out} has the cameras; run, live and record take it by --rig")
        if settings.live and not interrupted:
            live = LiveSettings(
                specs, rig=settings.out, realtime=settings.realtime, device=settings.device, view=settings.view,
                host=settings.host, port=settings.port, open=False,
            )  # fmt: skip
            run_live(live, console, page)
    return calibration.rig


def _cameras(settings: SetupSettings, console: Console) -> tuple[str, ...]:
    """The cameras that are asked for, or those that are connected; what is wrong with these is told."""
    if settings.cameras:
        recordings = [spec for spec in settings.cameras if Path(spec).exists()]
        if recordings and not settings.realtime:
            raise InputError(
                f"{recordings[0]} is a recording: depthmocap calibrate places its cameras, and --realtime plays it as "
                "if it were cameras"
            )
        return settings.cameras
    with console.status("looking for cameras"):
        connected, failures = find_cameras()
    faults = connection_faults(connected, failures)
    for camera in connected:
        console.print(f"• found {camera.spec}: {camera.model} {camera.serial}".rstrip())
    for fault in faults:
        console.print(f"• {fault}")
    if usable := tuple(camera.spec for camera in connected if not camera.problem):
        return usable
    raise InputError(f"no depth camera was found: {joined(faults, 2) or 'is one plugged in?'}")


def _make_sources(specs: tuple[str, ...], console: Console) -> list[DepthSource]:
    """The cameras, unopened.

    Raises:
        InputError: when a text names none, or there are fewer than two.
    """
    sources = make_sources(specs, PlaybackClock(1.0), lambda line: console.print(f"• {line}"))
    if len(sources) < 2:
        one = f"this is one ({sources[0].name})" if sources else "this is none"
        raise InputError(f"a rig has two cameras or more, and {one}: depthmocap live takes one without a rig")
    return sources


def _ready_classifier(settings: SetupSettings, console: Console) -> Classifier:
    """The classifier, and everything compiled that looks at a frame, before a camera is opened."""

    def tell(line: str) -> None:
        console.print(f"• {line}")

    slow = "making ready to look; on a machine that is new to it this takes minutes, because it is compiled"
    with announce_if_slow(slow, tell), networks_on(settings.device) as devices:
        classifier = Classifier()
        recording = open_recording(packaged_recording())
        camera = recording.rig.cameras[0]
        empty = {camera.name: empty_m} if (empty_m := recording.background(camera.name)) is not None else {}
        WalkObserver(classifier, empty).add(camera, recording.raw(camera.name, recording.stamps(camera.name)[0]), 0.0)
    for line in devices.lines():
        tell(line)
    return classifier


def _open_page(settings: SetupSettings, console: Console, stack: contextlib.ExitStack) -> Page:
    """The page, served until the stack ends.

    Raises:
        InputError: when it cannot be served, or viser is not installed.
    """
    try:
        from depthmocap.viewing.viewer_page import Page
    except ModuleNotFoundError:
        raise InputError(f"{missing_extra('viser', 'view')}, or pass --no-view") from None
    page = stack.enter_context(Page(settings.host, settings.port, "depthmocap setup"))
    console.print(f"• open {page.url} in a browser")
    if settings.open:
        page.open_browser()
    return page


def _walk(
    settings: SetupSettings,
    specs: tuple[str, ...],
    sources: list[DepthSource],
    classifier: Classifier,
    page: Page | None,
    console: Console,
) -> tuple[Calibration, tuple[str, ...], int, bool]:
    """The calibration, the cameras as they were opened last and their number, and whether Ctrl-C ended the walk."""
    others: tuple[str, ...] = ()
    while True:
        shown = _make_page(page, specs, others)
        with RigSession(sources, classifier) as session:
            walk = _Walk(settings, session, shown, console)
            try:
                wanted = walk.until_end()
            except KeyboardInterrupt:
                wanted, walk.interrupted = None, True
            session.stop()
            if wanted is None and not session.state().good:
                with console.status("placing the cameras"):
                    session.place_now()
            state = session.state()
        if shown is not None:
            shown.clear()
            others = shown.others
        if wanted is None:
            break
        specs, sources = wanted
    if state.calibration is None:
        raise InputError(f"no rig could be made: {state.advice}")
    return state.calibration, specs, len(state.cameras), walk.interrupted


def _make_page(page: Page | None, specs: tuple[str, ...], others: tuple[str, ...]) -> SetupPage | None:
    if page is None:
        return None
    from depthmocap.rigging.setup_page import SetupPage

    return SetupPage(page, specs, others)


class _Walk:
    """Shows a session until it ends.

    Attributes:
        interrupted: whether Ctrl-C ended it.
    """

    def __init__(self, settings: SetupSettings, session: RigSession, shown: SetupPage | None, console: Console) -> None:
        self._settings, self._session, self._shown, self._console = settings, session, shown, console
        self.interrupted = False
        self._told: set[str] = set()
        self._placings = 0

    def until_end(self) -> tuple[tuple[str, ...], list[DepthSource]] | None:
        """Show until the rig is good, the time is over, the sources end, or the user takes the rig; then None. Where
        the user wants other names and modes: these, and the sources."""
        start_s = time.monotonic()
        with Live(console=self._console, auto_refresh=False, transient=True) as screen:
            while True:
                state = self._session.state()
                passed_s = time.monotonic() - start_s
                self._tell(state)
                screen.update(_picture(state, passed_s), refresh=self._console.is_terminal)
                if self._shown is not None:
                    self._shown.show(state)
                    if (changed := self._changed(self._shown)) is not None:
                        return changed
                    if self._shown.taken.is_set():
                        return None
                if state.good or state.ended or (self._settings.seconds or passed_s + 1) <= passed_s:
                    return None
                time.sleep(min(_LOOK_S, self._settings.seconds or _LOOK_S))

    def _changed(self, shown: SetupPage) -> tuple[tuple[str, ...], list[DepthSource]] | None:
        if (wanted := shown.wanted) is None:
            return None
        shown.wanted = None
        with shown.page.errors_shown():
            return wanted, _make_sources(wanted, self._console)
        return None

    def _tell(self, state: RigState) -> None:
        """Tell what is new; where the terminal shows no table, also what has changed."""
        lines = [f"camera {name!r}: {fault}" for name, fault in state.faults.items()]
        lines += [line for line in self._session.reader.problems.counts() if "camera" in line]
        if not self._console.is_terminal:
            lines.append(state.advice)
        for line in lines:
            if line not in self._told:
                self._told.add(line)
                self._console.print(f"• {line}")
        if state.placings > self._placings and not self._console.is_terminal:
            self._placings = state.placings
            self._console.print("• " + "; ".join(f"{names} {how}" for names, how in state.pair_lines()))


def _picture(state: RigState, seconds: float) -> Group:
    cameras = Table(title=f"{seconds:.0f} s · {state.advice}", title_justify="left")
    for column in ("camera", "a second", "person in frames", "state"):
        cameras.add_column(column)
    for status in state.statuses:
        seen, frames = state.seen.get(status.name, (0, 0))
        does = state.faults.get(status.name, status.state)
        cameras.add_row(status.name, f"{status.rate_hz:.0f}", f"{seen} of {frames}", does)
    pairs = Table()
    pairs.add_column("cameras")
    pairs.add_column("known to")
    for names, how in state.pair_lines():
        pairs.add_row(names, how)
    return Group(cameras, pairs)
