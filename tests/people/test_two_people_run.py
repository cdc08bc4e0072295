"""``depthmocap run --people 2`` on two blocks that walk: a folder for each."""

import json

import numpy as np
from test_segmenter import RATE, Scene, body

from depthmocap import RunSettings, run
from depthmocap.capture.recording import RecordingWriter
from depthmocap.export import read_csv
from depthmocap.geometry import Rig

SETS = 8


def test_each_person_has_a_folder(tmp_path):
    scene = Scene()
    backgrounds = {name: np.round(depth_m * 1000).astype(np.uint16) for name, depth_m in scene.backgrounds.items()}
    with RecordingWriter(tmp_path / "two", Rig(tuple(scene.cameras)), backgrounds) as writer:
        for i in range(SETS):
            frames, _ = scene.look(i, body(-0.8, 0.02 * i), body(0.9, 0.05 * i, 1.6))
            raw = {view.camera.name: np.round(view.depth_m * 1000).astype(np.uint16) for view in frames.views}
            writer.write(10**9 + i * 10**9 // RATE, raw)
    out = tmp_path / "out"
    settings = RunSettings(tmp_path / "two", out, people=2, smooth="fixed-lag", lag_frames=2, report=False)
    assert run(settings)["frames_by_person"] == {"1": SETS, "2": SETS}
    middles = []
    for number in (1, 2):
        folder = out / f"person-{number}"
        times_s, joints, _ = read_csv(folder / "pose.csv")
        np.testing.assert_allclose(times_s, np.arange(SETS) / RATE, atol=1e-6)  # every pose once, though it waits
        assert (folder / "pose.bvh").stat().st_size > 0
        assert not json.loads((folder / "summary.json").read_text())["interrupted"]
        middles.append(np.nanmedian(joints[:, :, 0]))
    np.testing.assert_allclose(sorted(middles), [-0.8, 0.9], atol=0.15)
    assert len(read_csv(out / "pose.csv")[0]) == SETS
