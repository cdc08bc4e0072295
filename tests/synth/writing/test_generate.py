"""Data sets on disk: the same contents whatever happens on the way, and what is refused. Samples are made up, but
once."""

from __future__ import annotations

import dataclasses
import errno
import io
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from file_contents import tree
from rich.console import Console

from depthmocap import InputError
from depthmocap.cli import main
from depthmocap.core.locks import lock_folder
from depthmocap.datasets import ubc3v_write
from depthmocap.datasets.shards import ShardReader, ShardWriter
from depthmocap.datasets.ubc3v import Section, kinect2_camera, sections
from depthmocap.frames import View
from depthmocap.geometry import look_at
from depthmocap.synth.sample import CameraRange, Recipe, Sample
from depthmocap.synth.writing import generate as generate_module
from depthmocap.synth.writing import units
from depthmocap.synth.writing.generate import SynthSettings, generate
from depthmocap.synth.writing.units import Layout

QUIET = Console(file=io.StringIO())
RECIPE = Recipe(subset="easy", split="valid", views=2)
LAYOUTS: tuple[Layout, ...] = ("ubc3v", "shards")


def made_up(recipe: Recipe, seed: int, index: int, roll_rad: float = 0.0) -> Sample:
    """A box seen by every camera."""
    rng = np.random.default_rng([seed, index])
    views = []
    for k in range(recipe.views):
        labels = np.zeros((424, 512), np.uint8)
        labels[100:160, 200:230] = rng.integers(1, 44, (60, 30))
        depth = np.where(labels > 0, rng.uniform(1, 4, labels.shape), 0).astype(np.float32)
        camera = kinect2_camera(f"Cam{k + 1}", look_at(rng.uniform(2, 3, 3), np.zeros(3), roll_rad))
        views.append(View(camera, depth, labels > 0, labels))
    return Sample(tuple(views), rng.normal(size=(18, 3)), index % 3)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("depthmocap.synth.writing.card._charts", lambda rows: [])
    monkeypatch.setattr("depthmocap.synth.writing.card._thumbnails", lambda sample: np.full((4, 4, 3), 9, np.uint8))
    monkeypatch.setattr(units, "_FRAMES_PER_UNIT", 2)
    monkeypatch.setattr(units, "SAMPLES_PER_SHARD", 3)
    monkeypatch.setattr("depthmocap.datasets.ubc3v_write._SAVE_EVERY_S", 0.0)
    monkeypatch.setattr(units, "draw", made_up)


def run(out: Path, layout: Layout = "ubc3v", samples: int = 7, **options) -> Path:
    options = {"recipe": RECIPE, "workers": 0} | options
    return generate(SynthSettings(out, samples=samples, format=layout, **options), QUIET)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_was_written_is_read_back(tmp_path: Path, layout: Layout) -> None:
    folder = run(tmp_path, layout)
    if layout == "shards":
        read = list(ShardReader(folder))
        assert [sample.index for sample in read] == list(range(7))
        assert {sample.about["seed"] for sample in read} == {0}
        joints = [sample.joints for sample in read]
    else:
        (path,) = sections(tmp_path, "easy-pose", "valid")
        joints = [frame.true_joints for frame in Section(path, ["Cam1", "Cam2"]) if frame.true_joints is not None]
    np.testing.assert_allclose(np.stack(joints), [made_up(RECIPE, 0, i).joints for i in range(7)], atol=1e-9)
    assert not [name for name in tree(folder) if ".part" in name or ".lock" in name]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("stops", [(1,), (4, 1), (2, 3, 1), (5, 3)])
def test_a_set_that_was_interrupted_has_the_same_bytes(
    tmp_path: Path, layout: Layout, stops: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = tree(run(tmp_path / "whole", layout))
    for stop in stops:
        left = iter(range(stop))

        def interrupted(*arguments, left=left) -> Sample:
            if next(left, None) is None:
                raise KeyboardInterrupt
            return made_up(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(units, "draw", interrupted)
            with pytest.raises(KeyboardInterrupt):
                run(tmp_path / "parts", layout)
    assert tree(run(tmp_path / "parts", layout)) == whole


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_set_grows_and_never_shrinks(tmp_path: Path, layout: Layout) -> None:
    whole = tree(run(tmp_path / "whole", layout, 8))
    run(tmp_path / "grown", layout, 4)
    folder = run(tmp_path / "grown", layout, 8)
    assert tree(folder) == whole
    run(tmp_path / "grown", layout, 2)
    assert tree(folder) == whole


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_full_disk_is_told_and_the_set_goes_on(
    tmp_path: Path, layout: Layout, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = tree(run(tmp_path / "whole", layout))
    owner, name = (ShardWriter, "_add") if layout == "shards" else (ubc3v_write, "_write")
    write, left = getattr(owner, name), iter(range(9))

    def write_until_full(*arguments) -> None:
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, write_until_full)
        with pytest.raises(InputError, match="full: free some space, then run the same command"):
            run(tmp_path / "full", layout)
    assert tree(run(tmp_path / "full", layout)) == whole


def test_the_version_and_the_settings_must_be_the_first_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path, samples=1)
    for options, name in [
        ({"seed": 1}, "seed"),
        ({"recipe": dataclasses.replace(RECIPE, views=3)}, "views"),
        ({"layout": "shards"}, "format"),
    ]:
        with pytest.raises(InputError, match=rf"made with other settings \({name}\)"):
            run(tmp_path, samples=1, **options)
    with monkeypatch.context() as patch:
        patch.setattr(generate_module, "__version__", "0")
        with pytest.raises(InputError, match=r"other settings \(version\)"):
            run(tmp_path, samples=1)
    (tmp_path / "easy-pose/valid/settings.json").write_text("[")
    with pytest.raises(InputError, match=r"settings\.json is not valid JSON.*another --out"):
        run(tmp_path, samples=1)


def test_folders_that_cannot_be(tmp_path: Path) -> None:
    folder = tmp_path / "easy-pose/valid"
    folder.mkdir(parents=True)
    (folder / "thesis.doc").touch()
    with pytest.raises(InputError, match=r"something else \(thesis\.doc\)"):
        run(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write"):
        run(tmp_path / "file")


def test_one_run_at_a_time(tmp_path: Path) -> None:
    folder = tmp_path / "easy-pose/valid"
    folder.mkdir(parents=True)
    with lock_folder(folder), pytest.raises(InputError, match=r"is being written by process \d+ on"):
        run(tmp_path)
    (folder / ".lock").write_text("process 1 on a machine that lost its power")
    (folder / ".settings.part-1.json").write_text('{"recipe":')
    run(tmp_path)
    assert not (folder / ".lock").exists()


def test_damage_of_the_last_shard_is_named(tmp_path: Path) -> None:
    last = run(tmp_path, "shards") / "shard-000002.tar"
    last.write_bytes(last.read_bytes()[:5000])
    with pytest.raises(InputError, match=r"shard-000002\.tar is damaged.*remove it and run"):
        run(tmp_path, "shards", 9)
    last.replace(last.with_name(last.name + ".part-1"))  # as killed processes leave
    assert tree(run(tmp_path, "shards")) == tree(run(tmp_path / "whole", "shards"))


def test_what_the_layout_cannot_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(units, "draw", lambda *arguments: made_up(*arguments, roll_rad=0.3))
    with pytest.raises(InputError, match=r"roll.*use --format shards"):
        run(tmp_path)
    run(tmp_path / "shards", "shards")


def test_cameras_that_the_layout_cannot_hold_are_refused_beforehand(tmp_path: Path) -> None:
    rolled = dataclasses.replace(RECIPE, cameras=CameraRange(roll_rad=0.1))
    with pytest.raises(InputError, match="--roll-rad 0 or --format shards"):
        run(tmp_path / "none", recipe=rolled)
    with pytest.raises(InputError, match="--sensors ubc3v only, got ubc3v itop: use --format shards"):
        run(tmp_path / "none", recipe=dataclasses.replace(RECIPE, sensors=("ubc3v", "itop")))
    assert not (tmp_path / "none").exists()


def test_settings_that_made_nothing_do_not_bind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody(*arguments: object) -> Sample:
        raise InputError("no camera sees the person")

    for layout in LAYOUTS:
        with monkeypatch.context() as patch:
            patch.setattr(units, "draw", nobody)
            with pytest.raises(InputError, match="no camera"):
                run(tmp_path / layout, layout, seed=3)
        run(tmp_path / layout, layout, seed=4)
        with pytest.raises(InputError, match=r"other settings \(seed\)"):
            run(tmp_path / layout, layout, seed=3)


def test_presets_make_three_splits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert generate_module._PRESETS["paper-inter"] == ("inter", 1_300_000)
    monkeypatch.setitem(generate_module._PRESETS, "paper-inter", ("inter", 10))
    recipe = dataclasses.replace(RECIPE, subset="hard", split="train")
    folder = run(tmp_path, samples=1000, recipe=recipe, preset="paper-inter")
    assert folder == tmp_path / "inter-pose"
    found = {split: len(Section(folder / split / "1")) for split in ("train", "valid", "test")}
    assert found == {"train": 8, "valid": 1, "test": 1}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 10}, "--samples: leave out 10"),
        ({"recipe": dataclasses.replace(RECIPE, subset="hard")}, "--split: leave out valid"),
        ({"recipe": dataclasses.replace(RECIPE, split="train")}, "--subset: leave out easy"),
    ],
)
def test_what_a_preset_tells_is_not_told_otherwise(tmp_path: Path, options: dict, message: str) -> None:
    usual = {"samples": 1000, "recipe": dataclasses.replace(RECIPE, subset="hard", split="train")}
    with pytest.raises(InputError, match=f"--preset paper-easy tells {message}"):
        run(tmp_path, preset="paper-easy", **usual | options)
    assert not list(tmp_path.iterdir())


def test_numbers_that_cannot_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in ("--samples", "--workers", "--seed"):
        assert main(["synth", "--out", str(tmp_path / "none"), option, "-1"]) == 2
        assert option in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def make_up_unit(unit: units.Unit) -> units.Made:
    """In a process of its own, where nothing is patched."""
    pytest.MonkeyPatch().setattr(units, "draw", made_up)
    return units.make_unit(unit)


@pytest.mark.slow
def test_processes_make_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = run(tmp_path / "here")
    monkeypatch.setattr(generate_module, "make_unit", make_up_unit)
    there = run(tmp_path / "there", workers=2)
    unlike = {name for name, data in tree(here).items() if tree(there).get(name) != data}
    assert unlike == {"card.html"}  # the pictures, which are made up only here


SCRIPT = """
import sys, time
sys.path[:0] = {tests!r}
from depthmocap.cli import main
from depthmocap.synth.writing import units
from test_generate import made_up

def slow(*arguments):
    time.sleep(0.05)
    return made_up(*arguments)

units.draw, units._FRAMES_PER_UNIT, units.SAMPLES_PER_SHARD = slow, 2, 3
import depthmocap.datasets.ubc3v_write as write
write._SAVE_EVERY_S = 0.0
if __name__ == "__main__":
    main(sys.argv[1:])
"""


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_killed_run_goes_on(tmp_path: Path, layout: Layout) -> None:
    script = tmp_path / "main.py"
    script.write_text(SCRIPT.format(tests=[str(Path(__file__).parent), str(Path(__file__).parents[2] / "support")]))
    command = [sys.executable, str(script), "synth", "--out", str(tmp_path / "parts"), "--samples", "15"]
    command += ["--subset", "easy", "--split", "valid", "--views", "2", "--format", layout, "--workers", "0"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    folder = tmp_path / "parts/easy-pose/valid"
    sign = "1/images/depthRender/Cam1/*5.png" if layout == "ubc3v" else "*1.tar"
    deadline = time.monotonic() + 60
    while not list(folder.glob(sign)):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert not (folder / "card.json").exists()
    assert tree(run(tmp_path / "parts", layout, 15)) == tree(run(tmp_path / "whole", layout, 15))
