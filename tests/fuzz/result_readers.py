"""Results of ``run``, ``calibrate`` and evaluations that other commands read, and the pictures of ``label``."""

from __future__ import annotations

import dataclasses
import json
import unittest.mock
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from reader import PERIOD, START, Reader, either, make_rig

from depthmocap.body.skeleton import JOINTS
from depthmocap.geometry import save_rig


def _rig_file(folder: Path) -> None:
    save_rig(make_rig(), folder / "rig.json")


def _read_rig(folder: Path) -> None:
    from depthmocap.geometry import load_rig

    for camera in load_rig(folder / "rig.json").cameras:
        if camera.width * camera.height < 1e6:
            assert camera.rays.shape == (camera.height, camera.width, 2)


def _poses(folder: Path) -> None:
    from depthmocap.exporting import write_csv
    from depthmocap.frames import Pose

    rng = np.random.default_rng(0)
    poses = [Pose(START + i * PERIOD, rng.normal(size=(18, 3)), np.ones(18)) for i in range(4)]
    write_csv(folder / "pose.csv", poses)


def _read_poses(folder: Path) -> None:
    from depthmocap.exporting import read_csv

    read_csv(folder / "pose.csv")


def _animations(folder: Path) -> None:
    from depthmocap.exporting import write_bvh, write_trc
    from depthmocap.frames import Pose

    rng = np.random.default_rng(0)
    poses = [Pose(START + i * PERIOD, rng.normal(size=(18, 3)), np.ones(18)) for i in range(4)]
    write_trc(folder / "pose.trc", poses, "z")
    write_bvh(folder / "pose.bvh", poses, "z")


def _read_animations(folder: Path) -> None:
    from depthmocap.exporting import read_bvh, read_trc

    read_trc(folder / "pose.trc")
    read_bvh(folder / "pose.bvh")


def _stored(folder: Path) -> None:
    from depthmocap.exporting.edits import Edit, Edits, TakeMarker, write_edits
    from depthmocap.exporting.stored_result import read_result

    _poses(folder)
    digest = read_result(folder).edits.digest
    exchange = Edit("exchange", 1, first_ns=START + PERIOD, last_ns=START + 2 * PERIOD)
    edits = (exchange, Edit("split", 1, 2, START + PERIOD), Edit("join", 1, 2), Edit("name", 1, name="a"))
    write_edits(folder, Edits(digest, edits, (TakeMarker(START, "b"),)))


def _read_stored(folder: Path) -> None:
    from depthmocap.exporting.stored_result import read_result

    read_result(folder)


def _take(folder: Path) -> None:
    """What ``run`` writes of two people, with corrections."""
    from two_people_take import write_take

    write_take(folder)
    for path in folder.rglob("pose.*"):
        if path.suffix != ".csv":
            path.unlink()


def _export(folder: Path) -> None:
    """The files of all formats that need no other package."""
    from depthmocap.core.console import Terminal
    from depthmocap.exporting.export_command import ExportSettings, export

    formats = ("csv", "trc", "bvh", "npz", "osim", "glb")
    export(ExportSettings(folder, folder.parent / "out", formats=formats, landmarks=True), Terminal(quiet=True))


def _results(folder: Path) -> None:
    numbers: dict[str, Any] = {
        "subset": "hard", "split": "test", "seed": 1, "frames": 20, "joints": list(JOINTS), "views": 3,
        "labels": "network", "about": {"weights": None, "estimator": "votes"}, "true_joints": "9f",
        "mean_joint_error_cm": 1.5, "within_10cm": 0.99, "per_joint_error_cm": dict.fromkeys(JOINTS, 1.5),
        "recipe": {"sensors": "any", "noise": 0.5}, "mean_ap_10cm": 0.9, "deviation_cm": None, "found": 0.97,
    }  # fmt: skip
    for name in ("a", "b"):
        (folder / f"{name}.json").write_text(json.dumps({"bench": numbers}))


def _compare(folder: Path) -> None:
    from depthmocap.core.console import Terminal
    from depthmocap.evaluate.compare import Comparison, compare

    compare(Comparison(folder / "a.json", folder / "b.json"), Terminal(quiet=True))


@dataclasses.dataclass(frozen=True)
class _Settings:
    out: Path = Path("x")
    seed: int = 3
    views: tuple[int, ...] = (1, 2)
    about: Mapping[str, Any] = dataclasses.field(default_factory=lambda: {"share": 0.5, "name": "hard"})


def _settings(folder: Path) -> None:
    from depthmocap.core.settings import claim_folder

    claim_folder(folder, _Settings(), "a run", ())


def _picture(folder: Path) -> None:
    from PIL import Image

    depth = np.zeros((40, 48), np.uint16)
    depth[5:35, 10:30] = 2000
    for name in ("depth.png", "depth.tif"):
        Image.fromarray(depth).save(folder / name)
    Image.fromarray((depth > 0).astype(np.uint8)).save(folder / "mask.png")
    rgba = np.zeros((40, 48, 4), np.uint8)
    rgba[5:35, 10:30] = (90, 90, 90, 255)
    Image.fromarray(rgba).save(folder / "rgba.png")


def _label(folder: Path) -> None:
    """All of ``depthmocap label`` but the network."""
    from depthmocap.offline import label

    with unittest.mock.patch.object(label, "Classifier", lambda weights: _Everywhere()):
        for name, ubc3v in (("depth.png", False), ("depth.tif", False), ("rgba.png", True)):
            out = folder.parent / "labels.png"
            settings = label.LabelSettings(folder / name, out, mask=folder / "mask.png", ubc3v=ubc3v, preview=())
            either(lambda settings=settings: label.label_image(settings))


class _Everywhere:
    """Finds one part of a body wherever a person is."""

    def label_views(self, views: Any, masks: Any, *more: Any) -> Any:
        return [(mask.astype(np.uint8), mask.astype(np.float32), None) for mask in masks]


RESULTS: dict[str, Reader] = {
    "rig": Reader(_rig_file, _read_rig),
    "poses": Reader(_poses, _read_poses),
    "stored": Reader(_stored, _read_stored),
    "export": Reader(_take, _export, ("pose.csv", "summary.json")),
    "animations": Reader(_animations, _read_animations),
    "compare": Reader(_results, _compare),
    "settings": Reader(_settings, _settings),
    "label": Reader(_picture, _label),
}
