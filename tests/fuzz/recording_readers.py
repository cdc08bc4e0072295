"""Recordings of every kind, and the names of cameras."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from reader import PERIOD, START, Reader, depth_of, either, make_rig

from depthmocap.geometry import DepthCamera


def _recording(folder: Path) -> None:
    from depthmocap.recordings.recording_writer import RecordingWriter

    rig = make_rig()
    with RecordingWriter(folder / "rec", rig, {"left": depth_of(rig["left"], 99)}) as writer:
        for i in range(3):
            frames = {camera.name: depth_of(camera, 10 * i + k) for k, camera in enumerate(rig.cameras)}
            writer.write(START + i * PERIOD, frames, np.random.default_rng(i).normal(size=(18, 3)))


def _read_through(path: Path) -> None:
    """Everything that ``info``, ``run`` and ``convert`` ask of a recording."""
    from depthmocap.recordings.convert import recording_info
    from depthmocap.recordings.open_recording import open_recording

    recording = open_recording(path)
    recording_info(recording)
    for frames in recording:
        assert all(view.depth_m.shape == (view.camera.height, view.camera.width) for view in frames.views)
    for name in recording.rig.names:
        recording.background(name)


def _read_recording(folder: Path) -> None:
    _read_through(folder / "rec")


def _mcap(coding: Any, compression: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        from mcap_mutations import repacked

        from depthmocap.recordings.mcap_writer import McapWriter

        rig, path = make_rig(), folder / "rec.mcap"
        with McapWriter(path, rig, {"left": depth_of(rig["left"], 99)}, coding, start_ns=START) as writer:
            for i in range(3):
                for k, camera in enumerate(rig.cameras):
                    writer.write(camera.name, START + i * PERIOD + k, depth_of(camera, 10 * i + k))
                writer.write_truth(START + i * PERIOD, np.random.default_rng(i).normal(size=(18, 3)))
        path.write_bytes(repacked(path.read_bytes(), compression))

    return make


def _read_mcap(folder: Path) -> None:
    _read_through(folder / "rec.mcap")


def _recover(folder: Path) -> None:
    from depthmocap.core.console import Terminal
    from depthmocap.recordings.convert import RecoverSettings, recover

    out = folder.parent / "recovered.mcap"
    out.unlink(missing_ok=True)
    recover(RecoverSettings(folder / "rec.mcap", out), Terminal(quiet=True))


def _mkv(folder: Path) -> None:
    from mkv_file import write_mkv

    depth = depth_of(DepthCamera("a", 320, 288, 1.0, 1.0, 0.0, 0.0), 1)
    write_mkv(folder / "rec.mkv", [(1_000_000 + i * 33_333, depth + i) for i in range(2)])


def _read_mkv(folder: Path) -> None:
    _read_through(folder / "rec.mkv")


def _tum(folder: Path) -> None:
    import cv2

    (folder / "rec" / "depth").mkdir(parents=True)
    for i in range(2):
        picture = depth_of(DepthCamera("a", 640, 480, 1.0, 1.0, 0.0, 0.0), i)
        cv2.imwrite(str(folder / "rec" / "depth" / f"{i}.5.png"), picture)
    (folder / "rec" / "depth.txt").write_text("# depth maps\n0.5 depth/0.5.png\n1.5 depth/1.5.png\n")


def _livescan(folder: Path) -> None:
    import cv2
    from mkv_file import calibration

    client = folder / "rec" / "client_0"
    client.mkdir(parents=True)
    (client / "Intrinsics_Calib_0.json").write_bytes(calibration())
    (client / "Timestamps_Client0.txt").write_text("0\t1000000\n1\t1033333\n")
    for i in range(2):
        picture = depth_of(DepthCamera("a", 320, 288, 1.0, 1.0, 0.0, 0.0), i)
        cv2.imwrite(str(client / f"Depth_{i}.tiff"), picture)


def _specs(folder: Path) -> None:
    lines = ("left=azure:000123?mode=nfov&fps=15", "realsense:923", "openni:a.oni?size=640x480", "rec#a")
    (folder / "cameras.spec").write_text("\n".join(lines))


def _read_specs(folder: Path) -> None:
    from depthmocap.cameras.registry import make_sources

    for line in (folder / "cameras.spec").read_text("utf-8", "surrogateescape").split("\n")[:8]:
        either(lambda line=line: make_sources([line]))


_MCAP_PLAIN, _MCAP_ZSTD = _mcap("raw", ""), _mcap("delta-zstd", "zstd")
_RECORD = ("foxglove", "zstandard")
RECORDINGS: dict[str, Reader] = {
    "recording": Reader(_recording, _read_recording),
    "mcap": Reader(_MCAP_PLAIN, _read_mcap, needs=_RECORD),
    "mcap zstd": Reader(_MCAP_ZSTD, _read_mcap, needs=_RECORD),
    "mcap lz4": Reader(_mcap("png", "lz4"), _read_mcap, needs=(*_RECORD, "lz4")),
    "recover": Reader(_MCAP_PLAIN, _recover, needs=_RECORD),
    "recover zstd": Reader(_MCAP_ZSTD, _recover, needs=_RECORD),
    "mkv": Reader(_mkv, _read_mkv),
    "tum": Reader(_tum, _read_recording),
    "livescan3d": Reader(_livescan, _read_recording),
    "camera specs": Reader(_specs, _read_specs),
}
