"""What a running motion capture records."""

import dataclasses
import itertools

import numpy as np
import pytest
from fakes import Board, fake_pipeline

pytest.importorskip("foxglove")

from camera_simulator import SimulatedCamera, Simulation

from depthmocap.errors import InputError
from depthmocap.geometry import Rig
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.realtime.mcap_recorder import McapRecorder
from depthmocap.realtime.sync import SyncSettings
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mcap_writer import McapWriter


def test_a_camera_that_comes_later_is_in_the_recording(tmp_path, virtual):
    scene = Board(2)
    simulation = Simulation(scene, 20.0, 3.0)
    with LiveCapture(
        [SimulatedCamera(simulation, "cam0", virtual.monotonic_ns())],
        scene.rig,
        fake_pipeline(),
        SyncSettings(20.0),
        False,
    ) as capture:
        reader = capture.reader
        with McapWriter(tmp_path / "take.mcap", Rig(tuple(reader.cameras.values()))) as writer:
            reader.recorder = McapRecorder(writer, reader.camera)
            for _ in itertools.islice(capture, 20):
                pass
            capture.reader.add(SimulatedCamera(simulation, "cam1", virtual.monotonic_ns()))
            for _ in itertools.islice(capture, 20):
                pass
            capture.stop()
            written = dict(writer.frames)
    recording = McapRecording(tmp_path / "take.mcap")
    assert recording.complete
    assert recording.rig.names == ("cam0", "cam1")
    np.testing.assert_array_equal(recording.rig["cam1"].world_from_camera, scene.rig["cam1"].world_from_camera)
    assert {name: len(recording.stamps(name)) for name in written} == written
    assert written["cam0"] >= written["cam1"] + 19
    assert written["cam1"] >= 20
    stamp = recording.stamps("cam1")[-1]
    time_s = recording.device_time("cam1", stamp)[0] * 1e-9
    np.testing.assert_array_equal(recording.raw("cam1", stamp), scene.depth("cam1", time_s))


def test_frames_that_cannot_be_recorded_do_not_end_the_recording(tmp_path, virtual):
    class Odd(SimulatedCamera):
        """Its first frames are of a time before its clock began, the next ones too small."""

        def _read(self, timeout_s):
            frame = super()._read(timeout_s)
            if frame is None or frame.timestamp_ns >= 500_000_000:
                return frame
            if frame.timestamp_ns < 250_000_000:
                return dataclasses.replace(frame, timestamp_ns=frame.timestamp_ns - 10**9)
            return dataclasses.replace(frame, raw=frame.raw[:-2])

    scene = Board(1)
    source = Odd(Simulation(scene, 20.0, 1.0), "cam0", virtual.monotonic_ns())
    capture = LiveCapture([source], None, fake_pipeline(), SyncSettings(20.0), False)
    with McapWriter(tmp_path / "take.mcap", scene.rig) as writer:
        capture.reader.recorder = McapRecorder(writer, capture.reader.camera)
        with capture:
            assert len(list(capture)) > 5
        with pytest.raises(InputError, match="has a camera 'cam0' already"):
            writer.add_camera(scene.rig["cam0"])
    assert writer.frames == {"cam0": 10}
    assert capture.problems["camera 'cam0': a frame of another size, or of an impossible time, is not recorded"] == 10
