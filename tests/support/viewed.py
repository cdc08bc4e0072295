"""A small take of two people, for tests of viewers."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import PeopleFiles, PoseFiles
from depthmocap.exporting.summary import Take
from depthmocap.frames import Pose
from depthmocap.recordings.open_recording import open_recording, packaged_recording

#: Sets of the recording, and the first without the second person, and those in which the first is not seen.
SETS, COMES_AT, GAP = 8, 3, (5, 6)
#: Poses of both people are so far (m) from the truth, and the second so far from the first.
OFF_M, APART_M = 0.02, 0.8


def write_result(folder: Path, recording: Path, off_m: float = OFF_M) -> None:
    """A result of two people beside the truth; the third pose is the least sure."""
    opened = open_recording(recording)
    take = Take("run", [recording], opened.up, FileSettings())
    with PoseFiles(folder, take) as files, PeopleFiles(folder, take) as people:
        for i, (stamp, joints) in enumerate(opened.truth_rows()[:SETS]):
            take.begin(stamp)
            confidence = np.full(18, 0.5 if i == 2 else 0.9)
            moved = joints + np.array([off_m, 0, 0])
            first = Pose(stamp, np.full((18, 3), np.nan), np.zeros(18)) if i in GAP else Pose(stamp, moved, confidence)
            files.write(first)
            people.write({1: [first]})
            if i >= COMES_AT:
                people.write({2: [Pose(stamp, moved + np.array([APART_M, 0, 0]), np.full(18, 0.8))]})


def write_recording(path: Path) -> None:
    """The first sets of the packaged recording."""
    whole = packaged_recording()
    for camera in sorted(each for each in whole.iterdir() if each.is_dir()):
        (path / camera.name).mkdir(parents=True)
        names = sorted(each.name for each in camera.glob("*.png"))
        for name in [*names[:SETS], *(each for each in names[SETS:] if not each[0].isdigit())]:
            shutil.copy(camera / name, path / camera.name / name)
    for name in ("rig.json", "truth.csv"):
        shutil.copy(whole / name, path)
