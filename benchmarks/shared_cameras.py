"""Simulated cameras in a process of their own, which another process reads as it would an SDK's.

``CameraHost`` is that process: it lays frames into rings of shared memory, as a driver does, when they are due. Run as

    python benchmarks/shared_cameras.py COUNTS live cam0=simulated:FOLDER/cam0 ... --rig FOLDER/rig.json ...

this file is the command ``depthmocap`` with these cameras among those that it knows; how many frames were lost on the
way, and how many were recorded, is written to the file COUNTS at the end.
"""

from __future__ import annotations

import collections
import dataclasses
import json
import multiprocessing
import struct
import sys
import threading
import time
from multiprocessing.connection import Client, Connection, Listener
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from depthmocap.cameras import registry
from depthmocap.cameras.modes import ModeRequest
from depthmocap.cameras.source import CameraError, ConnectedCamera, DepthFrame, DepthSource
from depthmocap.geometry import DepthCamera, load_rig, save_rig
from depthmocap.realtime.mcap_recorder import McapRecorder
from depthmocap.recordings.mcap_writer import McapWriter

#: Frames of a camera that are kept for a reader.
RING = 16
#: What a reader is told of a frame: its number, and the camera's own time (ns).
_TOLD = struct.Struct("<qq")
#: Of each camera: its clock at the start (seconds), and its drift (parts in a million).
_CLOCKS = ((1000.0, 20.0), (2000.0, -20.0), (3000.0, 5.0), (4000.0, 0.0))


@dataclasses.dataclass(frozen=True)
class CameraHost:
    """Cameras around one or two people, in a process of their own.

    Attributes:
        folder: for the rings, in shared memory.
        delay_ms, jitter_ms: from the exposure to the host: the delay, and up to twice the jitter more.
        phases: of the cameras' exposures, as shares of a period.
    """

    folder: Path
    people: int = 1
    rate_hz: float = 30.0
    scene_seconds: float = 6.0
    delay_ms: float = 5.0
    jitter_ms: float = 1.0
    phases: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def start(self) -> tuple[BaseProcess, Connection]:
        """Start the process; it sends its exposure 0 (ns of ``time.monotonic_ns``) when it is ready, and its
        :class:`Sent` when it is told to end by any message."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(self, theirs), daemon=True)
        process.start()
        return process, ours


@dataclasses.dataclass(frozen=True)
class Sent:
    """What the cameras did: by camera the frames that were handed to a reader."""

    frames: dict[str, int]


def _serve(host: CameraHost, pipe: Connection) -> None:
    from camera_simulator import RecordedScene
    from studio import Studio

    studio = Studio(host.scene_seconds, host.rate_hz, people=host.people)
    scene = RecordedScene(studio, studio.rig, host.rate_hz)
    save_rig(studio.rig, host.folder / "rig.json")
    rings = [_Ring(camera, host.folder) for camera in studio.rig.cameras]
    rng, period_s = np.random.default_rng(0), 1 / host.rate_hz
    zero_ns, number = time.monotonic_ns() + 200_000_000, 0
    pipe.send(zero_ns)
    while not pipe.poll():
        exposed_s = (number + np.array(host.phases)) * period_s
        due_s = exposed_s + 1e-3 * (host.delay_ms + rng.uniform(0, 2, len(rings)) * host.jitter_ms)
        for i in np.argsort(due_s).tolist():
            offset_s, drift_ppm = _CLOCKS[i]
            at_s = float(exposed_s[i])
            stamp_ns = round((offset_s + at_s * (1 + 1e-6 * drift_ppm)) * 1e9)
            time.sleep(max(float(due_s[i]) - (time.monotonic_ns() - zero_ns) * 1e-9, 0))
            rings[i].put(number, stamp_ns, scene.depth(rings[i].name, at_s))
        number += 1
    pipe.send(Sent({ring.name: ring.sent for ring in rings}))


def _ring_file(place: Path, camera: DepthCamera, mode: Any) -> tuple[np.memmap, np.memmap]:
    """The numbers of the frames in the ring, and their depth."""
    numbers = np.memmap(place.with_suffix(".numbers"), np.int64, mode, shape=(RING,))
    return numbers, np.memmap(place.with_suffix(".depth"), np.uint16, mode, shape=(RING, camera.height, camera.width))


class _Ring:
    """The host's side of one camera."""

    def __init__(self, camera: DepthCamera, folder: Path) -> None:
        self.name, self.sent = camera.name, 0
        self._numbers, self._depth = _ring_file(folder / camera.name, camera, "w+")
        self._numbers[:] = -1
        self._listener = Listener(str(folder / f"{camera.name}.socket"), "AF_UNIX")
        self._reader: Connection | None = None
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            self._reader = self._listener.accept()

    def put(self, number: int, stamp_ns: int, raw: np.ndarray) -> None:
        """Give the frame to the reader, if there is one."""
        if (reader := self._reader) is None:
            return
        place = number % RING
        self._numbers[place] = -1
        self._depth[place] = raw
        self._numbers[place] = number
        try:
            reader.send_bytes(_TOLD.pack(number, stamp_ns))
            self.sent += 1
        except OSError:
            self._reader = None


class SharedCamera(DepthSource):
    """The reader's side of one camera; ``place`` is in the host's folder."""

    #: By camera, the frames that were read, and that were gone before they were.
    read_frames: ClassVar[collections.Counter[str]] = collections.Counter()
    lost_frames: ClassVar[collections.Counter[str]] = collections.Counter()

    def __init__(self, name: str, place: Path) -> None:
        super().__init__(name)
        self._place = place
        self._connection: Connection | None = None

    def _open(self) -> DepthCamera:
        camera = load_rig(self._place.parent / "rig.json")[self._place.name]
        try:
            self._connection = Client(str(self._place.with_suffix(".socket")), "AF_UNIX")
        except OSError as error:
            raise CameraError(f"camera {self.name!r} is not connected: {error}") from None
        self._numbers, self._depth = _ring_file(self._place, camera, "r")
        return dataclasses.replace(camera, name=self.name)

    def _read(self, timeout_s: float) -> DepthFrame | None:
        assert self._connection is not None
        end_s = time.monotonic() + timeout_s
        while self._connection.poll(max(end_s - time.monotonic(), 0)):
            try:
                number, stamp_ns = _TOLD.unpack(self._connection.recv_bytes())
            except (EOFError, OSError):
                raise CameraError(f"camera {self.name!r} was lost") from None
            arrival_ns = time.monotonic_ns()
            raw = np.array(self._depth[number % RING])
            if self._numbers[number % RING] == number:
                self.read_frames[self.name] += 1
                return DepthFrame(self.name, raw, stamp_ns, f"clock of {self.name}", arrival_ns, number)
            self.lost_frames[self.name] += 1  # it was overwritten meanwhile
        raise self._frame_timeout(timeout_s)

    def _close(self) -> None:
        if self._connection is not None:
            self._connection.close()


def find_cameras() -> list[ConnectedCamera]:
    """None are found: they are named."""
    return []


def make_source(name: str, address: str, request: ModeRequest) -> DepthSource:
    """See ``cameras.registry.BACK_ENDS``; the address is FOLDER/CAMERA."""
    return SharedCamera(name, Path(address))


def main(counts: Path, words: list[str]) -> None:
    """Run a command of ``depthmocap`` with these cameras."""
    from depthmocap.cli import main as run_command

    registry.BACK_ENDS["simulated"] = "shared_cameras"
    offered, written = collections.Counter[str](), dict[str, int]()
    write, close = McapRecorder.write, McapWriter.close

    def counted_write(self: McapRecorder, frame: DepthFrame) -> None:
        offered[frame.camera] += 1
        write(self, frame)

    def counted_close(self: McapWriter) -> None:
        close(self)
        written.update(self.frames)  # a file is closed more than once

    McapRecorder.write, McapWriter.close = counted_write, counted_close
    try:
        sys.exit(run_command(words))
    finally:
        told = {"read": SharedCamera.read_frames, "lost": SharedCamera.lost_frames}
        counts.write_text(json.dumps({**told, "offered": offered, "written": written}), encoding="utf-8")


if __name__ == "__main__":
    import shared_cameras  # as the module that the registry imports

    shared_cameras.main(Path(sys.argv[1]), sys.argv[2:])
