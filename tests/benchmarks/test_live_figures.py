"""Figures of live with a page and streams: frames from another process, and packets against exposures."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fakes import Board

if not sys.platform.startswith("linux"):
    pytest.skip("its cameras hand frames over as Linux can", allow_module_level=True)

import live_figures
import shared_cameras
from rich.console import Console
from shared_cameras import CameraHost, SharedCamera
from stream_receivers import Arrival

from depthmocap.cameras.modes import ModeRequest
from depthmocap.cameras.source import CameraError, FrameTimeoutError
from depthmocap.geometry import save_rig


def test_frames_come_from_the_ring_and_those_overwritten_are_counted(tmp_path: Path) -> None:
    scene = Board(1)
    (camera,) = scene.rig.cameras
    save_rig(scene.rig, tmp_path / "rig.json")
    source = shared_cameras.make_source("left", str(tmp_path / camera.name), ModeRequest())
    with pytest.raises(CameraError, match="camera 'left' is not connected"), source:
        pass
    ring = shared_cameras._Ring(camera, tmp_path)
    with source:
        assert source.camera.name == "left" and source.camera.fx == camera.fx
        while ring._reader is None:
            time.sleep(0.001)
        before = SharedCamera.lost_frames["left"]
        for number in range(shared_cameras.RING + 2):
            ring.put(number, 1000 * number, scene.depth(camera.name, 0.1 * number))
        frames = [source.read(1.0) for _ in range(shared_cameras.RING)]
        assert [frame.number for frame in frames if frame] == list(range(2, shared_cameras.RING + 2))
        first = frames[0]
        assert first is not None and (first.timestamp_ns, first.clock) == (2000, "clock of left")
        np.testing.assert_array_equal(first.raw, scene.depth(camera.name, 0.2))
        assert SharedCamera.lost_frames["left"] == before + 2
        with pytest.raises(FrameTimeoutError):
            source.read(0.0)
    ring.put(99, 0, scene.depth(camera.name, 0.0))  # to nobody, who is no longer there
    ring.put(100, 0, scene.depth(camera.name, 0.0))
    assert ring.sent == shared_cameras.RING + 2 + (ring._reader is not None)


@pytest.mark.parametrize("phases", [(0.0, 0.0), (0.0, 0.5)])
def test_packets_are_compared_with_the_last_exposure_of_their_set(tmp_path: Path, phases: tuple[float, ...]) -> None:
    host = CameraHost(tmp_path, rate_hz=20.0, delay_ms=5.0, jitter_ms=1.0, phases=phases)
    zero_ns, day_ns = 7_000_000_000, time.time_ns() - time.monotonic_ns()
    last_ns = round(max(phases) * 50e6)
    arrivals = {}
    for i in range(200):
        instant_ns = zero_ns + i * 50_000_000 + last_ns // 2 + 5_000_000
        late_ns = 30_000_000 if i % 10 else 60_000_000
        arrivals[round((instant_ns + day_ns) * 1e-6)] = Arrival(zero_ns + i * 50_000_000 + last_ns + late_ns, i > 4)
    numbers = live_figures._stream_numbers(arrivals, host, zero_ns, zero_ns - 1_000_000_000, 1)
    assert numbers["start_s"] == pytest.approx(1.0 + 0.25 + (last_ns + 30_000_000) * 1e-9)
    assert numbers["packets"] == 95 and numbers["packets_per_second"] == pytest.approx(20, rel=0.02)
    assert numbers["p50_ms"] == pytest.approx(24, abs=1) and numbers["p95_ms"] == pytest.approx(54, abs=1)


def test_the_table_has_the_goals() -> None:
    looks = [(5.0 * i, 400.0 + 0.5 * i, 3.0 * i, 0.2 * i) for i in range(20)]
    looked = live_figures._looked(looks)
    assert looked["memory"]["mb_a_minute"] == pytest.approx(6.0) and looked["cores"]["live"] == pytest.approx(0.6)
    counts = {"lost": {"a": 2}, "offered": {"a": 50, "b": 60}, "written": {"a": 50, "b": 57}}
    stream = {"p50_ms": 20.0, "p95_ms": 46.0, "packets_per_second": 29.7, "everybody_share": 1.0}
    numbers = {
        "settings": {"live_cores": [], "people": 1}, "sets_per_second": 29.6, "sets_dropped": 3,
        "sets_labelled_in_part": 40, "sets_before_ready": 9, "frames": counts,
        "frames_unrecorded": live_figures._unrecorded(counts),
        "streams": {"osc": stream}, "start_s": 2.5, "page": None, **looked,
    }  # fmt: skip
    console = Console(record=True, width=200)
    console.print(live_figures.table(numbers))
    told = console.export_text()
    assert "5 of 110" in told and "≤ 45 missed" in told and "≥ 29.5 met" in told and "≤ 3 met" in told
