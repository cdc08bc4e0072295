"""``depthmocap replay`` plays the joints of a result to the streams that live has."""

from __future__ import annotations

import _thread
import dataclasses
import threading
from pathlib import Path

import numpy as np
import pytest
from fakes import Board, fake_pipeline
from receivers import FoxgloveClient, OscReceiver, free_port, osc, wait_until
from samples import EMPTY_RIG

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.console import Terminal
from depthmocap.errors import InputError
from depthmocap.exporting.edits import TakeMarker
from depthmocap.exporting.stored_result import read_result
from depthmocap.exporting.summary import read_summary, write_summary
from depthmocap.realtime import live_command
from depthmocap.realtime.live_command import LiveSettings, run_live
from depthmocap.realtime.replay import ReplaySettings, replay
from depthmocap.recordings.mcap_messages import read_fields, read_transform
from depthmocap.recordings.pose_table import read_table
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.streaming.stream_protocol import Sample, StreamSetup
from depthmocap.streaming.websocket_stream import WebSocketStream

__all__ = ["osc"]

QUIET = Terminal(quiet=True)
FIRST_NS = 1_700_000_000_000_000_000


@pytest.fixture
def take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A recording, and what was found in it."""
    monkeypatch.setattr(live_command, "load_pipeline", lambda *arguments, **others: fake_pipeline())
    scene, path = Board(2), tmp_path / "recording"
    with RecordingWriter(path, scene.rig) as writer:
        for i in range(12):
            frames = {name: scene.depth(name, i * 0.04) for name in scene.rig.names}
            writer.write(FIRST_NS + i * 40_000_000, frames)
    run_live(LiveSettings((str(path),), out=tmp_path / "out"))
    return path, tmp_path / "out"


def test_the_joints_of_a_result_at_their_times(take: tuple[Path, Path], osc: OscReceiver) -> None:
    recording, out = take
    settings = ReplaySettings(recording, out, (f"osc://127.0.0.1:{osc.port}",), speed=2.0)
    assert replay(settings, QUIET) == 24
    table = read_table(out / "pose.csv")
    wait_until(lambda: len(osc.of("/depthmocap/1/LHand")) == 12)
    for i, name in enumerate(JOINTS):
        np.testing.assert_allclose(np.array(osc.of(f"/depthmocap/1/{name}"))[:, :3], table.joints[:, i], atol=1e-6)
    seconds = [seconds * 10**9 + rest for seconds, rest in osc.of("/depthmocap/time")]
    assert seconds == table.stamps_ns.tolist()


@pytest.mark.usefixtures("usual_signals")
def test_the_recording_and_the_joints_in_foxglove(take: tuple[Path, Path]) -> None:
    recording, out = take
    port, told = free_port(), Terminal(record=True, width=200)

    def listen() -> None:
        try:
            client = FoxgloveClient(port)
            clients.append(client)
            wait_until(lambda: all(map(client.of, ("/cam0/depth", "/cam1/depth", "/joints"))))
        finally:
            _thread.interrupt_main()

    clients: list[FoxgloveClient] = []
    threading.Thread(target=listen).start()
    with pytest.raises(KeyboardInterrupt):  # round after round, until all was heard
        replay(ReplaySettings(recording, out, (f"foxglove://127.0.0.1:{port}",), speed=3.0, loop=True), told)
    (client,) = clients
    client.close()
    assert f"open ws://127.0.0.1:{port} in Foxglove" in told.export_text()
    assert client.of("/cam0/depth") and client.of("/cam1/depth")
    table = read_table(out / "pose.csv")
    rows = {int(stamp): joints for stamp, joints in zip(table.stamps_ns, table.joints, strict=True)}
    assert client.of("/joints")
    for stamp_ns, data in client.of("/joints"):
        transforms = [read_transform(each) for each in read_fields(data)[1] if isinstance(each, bytes)]
        assert [each.child for each in transforms] == [f"person 1/{name}" for name in JOINTS]
        np.testing.assert_allclose([each.translation for each in transforms], rows[stamp_ns], atol=1e-6)


def test_markers_and_corrections(take: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    recording, out = take
    samples, markers = list[Sample](), list[tuple[str, int]]()
    monkeypatch.setattr(WebSocketStream, "send", lambda self, sample: samples.append(sample))
    monkeypatch.setattr(
        WebSocketStream, "mark", lambda self, marker: markers.append((marker.text, marker.monotonic_ns))
    )
    result = read_result(out)
    edits = dataclasses.replace(result.edits, markers=(TakeMarker(FIRST_NS + 80_000_000, "trial 3"),))
    monkeypatch.setattr("depthmocap.realtime.replay.read_result", lambda folder: result.edited(edits))
    replay(ReplaySettings(recording, out, ("ws://:0",), speed=2.0), QUIET)
    assert [sample.unix_ns for sample in samples] == [FIRST_NS + i * 40_000_000 for i in range(12)]
    assert np.diff([sample.monotonic_ns for sample in samples]).tolist() == [20_000_000] * 11
    assert markers == [("trial 3", samples[2].monotonic_ns)]


def test_a_live_result_is_brought_to_the_times_of_its_recording(
    take: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, out = take
    samples = list[Sample]()
    monkeypatch.setattr(WebSocketStream, "send", lambda self, sample: samples.append(sample))
    (out / "pose.csv").write_text((out / "pose.csv").read_text().replace("1700000000", "1600000000"))
    summary = read_summary(out)
    write_summary(out, {**summary, "recorded_minus_timestamp_ns": 100_000_000 * 10**9})
    replay(ReplaySettings(recording, out, ("ws://:0",)), QUIET)
    assert [sample.unix_ns for sample in samples] == [FIRST_NS + i * 40_000_000 for i in range(12)]


def test_what_cannot_be_played_is_one_line(take: tuple[Path, Path], tmp_path: Path) -> None:
    recording, out = take
    with pytest.raises(InputError, match=r"^osc://127\.0\.0\.1:9000 takes joints: tell with --result which run's$"):
        replay(ReplaySettings(recording, stream=("foxglove://:0", "osc://127.0.0.1:9000")), QUIET)
    with pytest.raises(InputError, match=r"has no pose\.csv"):
        replay(ReplaySettings(recording, tmp_path), QUIET)
    (out / "pose.csv").write_text((out / "pose.csv").read_text().replace("1700000000", "1600000000"))
    with pytest.raises(InputError, match=r"none of the times in .* are within the recording"):
        replay(ReplaySettings(recording, out), QUIET)


def test_a_port_that_is_taken_ends_it_before_it_starts(take: tuple[Path, Path]) -> None:
    server = WebSocketStream("127.0.0.1", 0)
    server.start(StreamSetup(EMPTY_RIG))
    address, port = f"ws://127.0.0.1:{server.port}", server.port
    with pytest.raises(InputError, match=f"^cannot serve on 127.0.0.1:{port}: Address already in use$"):
        replay(ReplaySettings(*take, stream=("foxglove://:0", address)), QUIET)
    server.close()
