"""What is written into a folder of results goes nowhere else, whatever links lie in it."""

import os
from pathlib import Path

import numpy as np
import pytest

from depthmocap.core.output import open_new, write_file
from depthmocap.errors import InputError
from depthmocap.exporting import read_csv
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import PeopleFiles, PoseFiles
from depthmocap.exporting.summary import Take
from depthmocap.frames import Pose

TAKE = Take("run", ["somewhere"], "z", FileSettings())
NAMES = ("pose.csv", "pose.trc", "pose.bvh", "summary.json")


def poses() -> list[Pose]:
    joints = np.random.default_rng(0).normal(size=(18, 3))
    return [Pose(i * 33_333_333, joints, np.ones(18)) for i in range(3)]


def test_results_take_the_place_of_links_and_not_of_what_they_lead_to(tmp_path: Path) -> None:
    out, others = tmp_path / "out", tmp_path / "others"
    out.mkdir()
    others.mkdir()
    for name in NAMES[:3]:
        (others / name).write_text("precious")
        (out / name).symlink_to(others / name)
    (out / NAMES[3]).symlink_to(others / "nothing yet")
    with PoseFiles(out, TAKE) as files:
        for pose in poses():
            files.write(pose)
    assert {path.name: path.read_text() for path in others.iterdir()} == dict.fromkeys(NAMES[:3], "precious")
    assert not any((out / name).is_symlink() for name in NAMES)
    assert len(read_csv(out / "pose.csv")[0]) == 3


def test_another_name_of_the_same_file_keeps_what_it_has(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("precious")
    os.link(tmp_path / "precious", tmp_path / "a")
    os.link(tmp_path / "precious", tmp_path / "b")
    with open_new(tmp_path / "a") as file:
        file.write(b"new")
    write_file(tmp_path / "b", "new")
    assert [(tmp_path / name).read_text() for name in ("precious", "a", "b")] == ["precious", "new", "new"]


def test_a_person_s_folder_that_leads_elsewhere_is_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "person-1").symlink_to(tmp_path / "elsewhere")
    with PeopleFiles(tmp_path / "out", TAKE) as people, pytest.raises(InputError, match="person-1 is a link"):
        people.write({1: poses()[:1]})
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_nothing_but_a_file_is_replaced(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it is no file"):
        open_new(Path(os.devnull))
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="it is no file"):
        open_new(tmp_path / "folder")
    assert Path(os.devnull).exists()
