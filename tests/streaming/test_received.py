"""Every receiver gets, of a capture in real time, the joints that are in pose.csv."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import Board, fake_pipeline
from numpy import ndarray
from receivers import FoxgloveClient, OscReceiver, attempted, free_port, lsl, lsl_inlet, osc, wait_until

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.exporting import read_csv
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP
from depthmocap.realtime import live_capture, live_command
from depthmocap.realtime.live_command import LiveSettings, run_live
from depthmocap.recordings.mcap_messages import read_fields, read_transform
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.streaming import lsl_stream
from depthmocap.streaming.lsl_stream import LslStream
from depthmocap.streaming.stream_protocol import StreamSetup

__all__ = ["lsl", "osc"]


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    for module in (live_capture, live_command):
        monkeypatch.setattr(module, "load_pipeline", lambda *arguments, **others: fake_pipeline())
    scene, path = Board(2), tmp_path / "recording"
    with RecordingWriter(path, scene.rig) as writer:
        for i in range(30):
            frames = {name: scene.depth(name, i * 0.04) for name in scene.rig.names}
            writer.write(1_700_000_000_000_000_000 + i * 40_000_000, frames)
    return str(path)


def check(received: ndarray, folder: Path) -> None:
    """Every received set of joints is a row of pose.csv, in its order."""
    _, joints, _ = read_csv(folder / "pose.csv")
    far = np.abs(received[:, None] - joints[None]).max((2, 3))
    rows = far.argmin(1)
    assert far.min(1).max() < 2e-6
    assert (np.diff(rows) > 0).all()
    assert len(rows) > 3


def test_by_osc(recording: str, tmp_path: Path, osc: OscReceiver) -> None:
    address = f"osc://127.0.0.1:{osc.port}"
    summary = run_live(LiveSettings((recording,), out=tmp_path / "out", realtime=True, stream=(address,))).summary
    check(np.stack([np.array(osc.of(f"/depthmocap/1/{name}"))[:, :3] for name in JOINTS], 1), tmp_path / "out")
    assert not [problem for problem in summary["problems"] if "osc" in problem["text"]]


def test_bones_by_vmc(recording: str, tmp_path: Path, osc: OscReceiver) -> None:
    address = f"vmc://127.0.0.1:{osc.port}"
    run_live(LiveSettings((recording,), out=tmp_path / "out", realtime=True, stream=(address,)))
    hips = np.array([[-x, y, z] for name, x, y, z, *_ in osc.of("/VMC/Ext/Bone/Pos") if name == "Hips"])
    check(np.repeat((hips @ Y_UP_FROM_Z_UP)[:, None], len(JOINTS), 1), tmp_path / "out")  # all are at one place


def test_by_websocket(recording: str, tmp_path: Path) -> None:
    client = pytest.importorskip("websockets.sync.client")
    address, received = f"ws://127.0.0.1:{free_port()}", list[str]()

    def listen() -> None:
        with wait_until(lambda: attempted(lambda: client.connect(address))) as connection:
            received.extend(connection)

    listener = threading.Thread(target=listen)
    listener.start()
    run_live(LiveSettings((recording,), out=tmp_path / "out", realtime=True, stream=(address,)))
    listener.join()
    messages = [json.loads(each) for each in received]
    sets = [np.array(each["people"][0]["joints"]) for each in messages if each["type"] == "poses"]
    check(np.stack(sets), tmp_path / "out")


def test_by_lab_streaming_layer(recording: str, tmp_path: Path, lsl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    samples, name = list[list[float]](), f"received-{os.getpid()}"
    stamps, started = list[float](), threading.Event()

    class Told(LslStream):
        def start(self, setup: StreamSetup) -> None:
            super().start(setup)
            started.set()

    def listen() -> None:
        assert started.wait(20)
        inlet = lsl_inlet(lsl, name)
        with contextlib.suppress(lsl.util.LostError):  # at the end of the capture
            while True:
                values, stamp = inlet.pull_sample(5)
                if values is None:
                    break
                samples.append(values)
                stamps.append(stamp)

    monkeypatch.setattr(lsl_stream, "LslStream", Told)
    listener = threading.Thread(target=listen)
    listener.start()
    run_live(LiveSettings((recording,), out=tmp_path / "out", realtime=True, stream=(f"lsl://{name}",)))
    listener.join()
    check(np.array(samples).reshape(-1, len(JOINTS), 4)[..., :3], tmp_path / "out")
    times_s, joints, _ = read_csv(tmp_path / "out" / "pose.csv")
    rows = [int(np.abs(joints - np.reshape(sample, (18, 4))[:, :3]).max((1, 2)).argmin()) for sample in samples]
    np.testing.assert_allclose(np.diff(stamps), np.diff(times_s[rows]), atol=1e-6)
    assert 0 < lsl.local_clock() - stamps[-1] < 60


def test_by_foxglove(recording: str, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    port, clients = free_port(), list[FoxgloveClient]()
    listener = threading.Thread(target=lambda: clients.append(FoxgloveClient(port)))
    listener.start()
    address = f"foxglove://127.0.0.1:{port}"
    run_live(LiveSettings((recording,), out=tmp_path / "out", realtime=True, stream=(address,)))
    listener.join()
    clients[0].close()
    sets = [
        [read_transform(each).translation for each in read_fields(data)[1] if isinstance(each, bytes)]
        for _, data in clients[0].of("/joints")
    ]
    check(np.array(sets), tmp_path / "out")
    assert clients[0].of("/cam0/depth")


@pytest.mark.parametrize("scheme", ["ws", "foxglove"])
def test_a_port_that_is_taken_does_not_end_a_capture(recording: str, tmp_path: Path, scheme: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"{scheme}://127.0.0.1:{taken.getsockname()[1]}"
        settings = LiveSettings((recording,), out=tmp_path / "out", realtime=True, stream=(address,))
        summary = run_live(settings).summary
    (problem,) = [problem for problem in summary["problems"] if "serve" in problem["text"]]
    assert problem["text"].startswith(f"{address}: cannot serve on {address.split('//')[1]}: ")
    assert problem["text"].endswith("; the capture goes on") and problem["times"] == 1
    assert len(read_csv(tmp_path / "out" / "pose.csv")[0]) > 3


def test_what_only_a_live_capture_can_send(recording: str) -> None:
    with pytest.raises(InputError, match="--stream needs --realtime"):
        run_live(LiveSettings((recording,), stream=("osc://127.0.0.1:9000",)))


def test_a_wrong_address_ends_it_before_it_starts(recording: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no stream smoke://"):
        run_live(LiveSettings((recording,), out=tmp_path / "out", realtime=True, stream=("smoke://hill",)))
    assert not (tmp_path / "out").exists()
