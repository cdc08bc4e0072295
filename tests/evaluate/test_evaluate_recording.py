"""A recording with true joints at a known distance from what the pipeline finds."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
from rich.console import Console

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.cli import main
from depthmocap.evaluate.recording_protocol import RecordingEvaluation, evaluate_recording
from depthmocap.exporting.pose_csv import write_csv
from depthmocap.frames import Pose
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.synth.body.mesh import REST_POSTURE
from depthmocap.synth.render import render_body

SETS = 5


@pytest.fixture(scope="module")
def recording(default_body, tmp_path_factory):
    """Two cameras, a person whose right shoulder rises; the truth is 3 cm beside what is found, 30 cm at the foot."""
    path = tmp_path_factory.mktemp("recordings") / "wave"
    eyes = ((0.0, -2.6, 1.2), (2.2, -1.4, 1.0))
    poses = [look_at(np.array(eye), np.array([0.0, 0.0, 0.9])) for eye in eyes]
    rig = Rig(tuple(DepthCamera(f"cam{i}", 256, 212, 184.0, 184.0, 127.5, 105.5, pose) for i, pose in enumerate(poses)))
    with RecordingWriter(path, rig) as writer:
        for i in range(SETS):
            posture = REST_POSTURE.copy()
            posture[:, 0] += 0.01 * i
            body = default_body.pose(posture)
            body = dataclasses.replace(body, vertices=body.vertices + np.array([0, 0, 0.9], np.float32))
            frames = {camera.name: render_body(body, camera)[0] for camera in rig.cameras}
            raw = {name: np.rint(depth_m * 1000).astype(np.uint16) for name, depth_m in frames.items()}
            writer.write(i * 100_000_000, raw)
    source = Recording(path)
    pipeline = load_pipeline(source, segment="none", smooth="none")
    found = [pipeline(frames).pose for frames in source]
    truths = [pose.joints + np.array([0.0, 0.03, 0.0]) for pose in found]
    for truth in truths:
        truth[JOINT_INDEX["LFoot"], 1] += 0.27
    truths[2][JOINT_INDEX["Head"]] = np.nan
    confidence = np.ones(18)
    write_csv(path / "truth.csv", [Pose(p.timestamp_ns, t, confidence) for p, t in zip(found, truths, strict=True)])
    return path


def test_known_distances_are_the_errors(recording, tmp_path):
    out = tmp_path / "n.json"
    command = ["evaluate", "recording", str(recording), "--segment=none", "--smooth=none", f"--json={out}"]
    assert main([*command, f"--report={tmp_path / 'r.html'}", f"--csv={tmp_path / 'n.csv'}"]) == 0
    numbers = json.loads(out.read_text())["wave"]
    assert numbers["frames"] == SETS and numbers["joints_observed"] == SETS * 18 - 1
    assert numbers["per_joint_error_cm"]["Head"] == pytest.approx(3, abs=0.01)
    assert numbers["per_joint_error_cm"]["LFoot"] == pytest.approx(30, abs=0.01)
    assert numbers["within_10cm"] == pytest.approx(1 - SETS / (SETS * 18 - 1))
    assert numbers["about"]["smooth"] == "none"
    assert main(["compare", str(out), str(out)]) == 0


def test_a_filter_that_waits_is_measured_against_its_own_frame(recording):
    """The still parts of the body stay where they are, however long the filter waits."""
    settings = RecordingEvaluation(recording, segment="none", smooth="fixed-lag", lag_frames=2)
    numbers = evaluate_recording(settings, Console(quiet=True))["wave"]
    assert numbers["frames"] == SETS and numbers["joints_missing"] == 0
    assert numbers["per_joint_error_cm"]["Hip"] == pytest.approx(3, abs=1.5)


def test_without_truth(recording, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(recording, copy)
    (copy / "truth.csv").unlink()
    assert main(["evaluate", "recording", str(copy), "--segment=none"]) == 2
    assert "no frame has a true joint: truth.csv must hold" in capsys.readouterr().err
