"""``depthmocap run --people 2`` on two blocks that walk: a folder for each, on one clock, the same on any cores."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest
from test_people_segmenter import RATE, Scene, body

from depthmocap import RunSettings, run
from depthmocap.exporting import read_csv
from depthmocap.exporting.summary import read_summary
from depthmocap.geometry import Rig, load_rig, save_rig
from depthmocap.recordings.recording_writer import RecordingWriter

SETS, START_NS = 8, 10**9
#: The second comes into view with the set of this number.
COMES = 3


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scene, path = Scene(), tmp_path_factory.mktemp("people") / "two"
    backgrounds = {name: np.round(depth_m * 1000).astype(np.uint16) for name, depth_m in scene.backgrounds.items()}
    with RecordingWriter(path, Rig(tuple(scene.cameras)), backgrounds) as writer:
        for i in range(SETS):
            bodies = [body(-0.8, 0.02 * i), body(0.9, 0.05 * i, 1.6)]
            frames, _ = scene.render(i, *bodies[: 1 if i < COMES else 2])
            raw = {view.camera.name: np.round(view.depth_m * 1000).astype(np.uint16) for view in frames.views}
            writer.write(START_NS + i * 10**9 // RATE, raw)
    return path


def test_the_rig_tells_the_area_in_which_people_are_followed(recording, tmp_path, capsys):
    right = ((0.2, -3.0), (3.0, -3.0), (3.0, 3.0), (0.2, 3.0))
    rig = dataclasses.replace(load_rig(recording / "rig.json"), area_m=right)
    save_rig(rig, tmp_path / "rig.json")

    def middle_x(name, area=()):
        out = tmp_path / name
        run(RunSettings(recording, out, tmp_path / "rig.json", segment="background", area=area, report=False))
        return float(np.nanmedian(read_csv(out / "pose.csv")[1][:, :, 0]))

    assert middle_x("of the rig") > 0.6
    assert "area_m in rig.json" in capsys.readouterr().err
    assert middle_x("of the command", (-3.0, -3.0, 0.2, -3.0, 0.2, 3.0)) < -0.5
    assert "area_m in rig.json" not in capsys.readouterr().err


@pytest.fixture(scope="module")
def out(recording, tmp_path_factory):
    out = tmp_path_factory.mktemp("people") / "out"
    summary = run(
        RunSettings(recording, out, segment="background", people=2, smooth="fixed-lag", lag_frames=2, report=False)
    ).summary
    assert summary["frames_by_person"] == {"1": SETS, "2": SETS - COMES}
    return out


def test_each_person_has_a_folder(out):
    middles = []
    for number, start in ((1, 0), (2, COMES)):
        folder = out / f"person-{number}"
        times_s, joints, _ = read_csv(folder / "pose.csv")
        # Every pose once, though the filter waits, and on the clock of the whole take.
        np.testing.assert_allclose(times_s, np.arange(start, SETS) / RATE, atol=1e-6)
        assert (folder / "pose.bvh").stat().st_size > 0
        summary = read_summary(folder)
        assert not summary["interrupted"] and summary["person"] == number
        assert summary["first_timestamp_ns"] == START_NS
        middles.append(np.nanmedian(joints[:, :, 0]))
    np.testing.assert_allclose(sorted(middles), [-0.8, 0.9], atol=0.15)
    assert len(read_csv(out / "pose.csv")[0]) == SETS


#: ``depthmocap`` on so many cores at most, where a process can choose.
_ON_CORES = """
import os, sys
if hasattr(os, "sched_setaffinity"):
    cores = range(os.cpu_count() or 1) if sys.argv[1] != "1" else [min(os.sched_getaffinity(0))]
    os.sched_setaffinity(0, cores)
from depthmocap.cli import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize("cores", ["1", "2"])
def test_poses_are_the_same_to_the_byte_on_any_number_of_cores(recording, out, tmp_path, cores):
    command = [sys.executable, "-c", _ON_CORES, cores, "run", str(recording), "--out", str(tmp_path / "out")]
    command += ["--segment", "background", "--people", "2", "--smooth", "fixed-lag", "--lag-frames", "2", "--no-report"]
    subprocess.run(command, env=os.environ | {"OMP_NUM_THREADS": cores}, check=True, capture_output=True)
    names = [str(path.relative_to(out)) for path in sorted(out.rglob("pose.*"))]
    assert len(names) == 9
    for name in names:
        assert (tmp_path / "out" / name).read_bytes() == (out / name).read_bytes(), name
