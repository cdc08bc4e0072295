"""Data sets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from reader import Reader, depth_of, either, make_rig, read_all

from depthmocap.geometry import DepthCamera


def _section(folder: Path) -> None:
    from ubc3v_files import write_section

    write_section(folder, 1)


def _read_section(folder: Path) -> None:
    from depthmocap.datasets.ubc3v import Section

    (path,) = [each.parent for each in folder.rglob("groundtruth.mat")]
    list(Section(path))


def _ray_table(folder: Path) -> None:
    from scipy.io import savemat

    from depthmocap.datasets.ubc3v_camera import KINECT2

    table = KINECT2.rays.astype(np.float64)
    savemat(folder / "mapper.mat", {"mapper": {"xmap": -table[..., 0], "ymap": -table[..., 1]}}, do_compression=True)


def _read_ray_table(folder: Path) -> None:
    from depthmocap.datasets.ubc3v_camera import load_ray_table

    load_ray_table(folder / "mapper.mat")


def _shards(folder: Path) -> None:
    from depthmocap.datasets.shards import ShardWriter, shard_path
    from depthmocap.frames import View

    camera = make_rig()["right"]
    with ShardWriter(shard_path(folder, 0)) as writer:
        for i in range(2):
            depth_m = depth_of(camera, i).astype(np.float32) / 1000
            labels = (depth_m > 5).astype(np.uint8) * np.uint8(3)
            writer.write(i, [View(camera, depth_m, labels > 0, labels)], np.ones((18, 3)), 7, {"seed": 1})


def _read_shards(folder: Path) -> None:
    from depthmocap.datasets.shards import ShardReader, count_samples

    either(lambda: count_samples(folder / "shard-000000.tar"))
    list(ShardReader(folder))


def _itop(folder: Path) -> None:
    import h5py

    ids, people = np.array([b"00_00000", b"01_00001"]), 2
    with h5py.File(folder / "ITOP_side_test_depth_map.h5", "w") as file:
        file["id"] = ids
        file["data"] = np.full((people, 240, 320), 2.5, np.float16)
    with h5py.File(folder / "ITOP_side_test_labels.h5", "w") as file:
        file["id"], file["is_valid"] = ids, np.ones(people, np.uint8)
        file["visible_joints"] = np.ones((people, 15), np.int16)
        file["real_world_coordinates"] = np.full((people, 15, 3), 0.5, np.float32)
        file["segmentation"] = np.zeros((people, 240, 320), np.int8)


def _read_itop(folder: Path) -> None:
    from depthmocap.datasets.itop import Itop

    for mask in ("segmentation", "box"):
        either(lambda mask=mask: read_all(Itop(folder, "side", "test", mask)))


def _eval(folder: Path) -> None:
    from depthmocap.datasets.eval3d import HEIGHT, RECORD, WIDTH

    camera = DepthCamera("eval", WIDTH, HEIGHT, 257.6, 257.6, 159.5, 119.5)
    records = np.zeros(2, RECORD)
    records["magic"], records["frame"], records["joint_count"] = 1234, (100, 101), 2
    rays = np.concatenate([camera.rays, np.ones((HEIGHT, WIDTH, 1), np.float32)], -1)
    records["points"] = rays * 2.5 * (1, -1, -1)
    records["joints"]["id"][:, :2] = (4, 0)
    records["joints"]["at"][:, :2] = 0.5
    (folder / "seq_a_0.bin").write_bytes(records.tobytes())
    (folder / "names.json").write_text(json.dumps({"4": "Head", "0": "Neck"}))


def _read_eval(folder: Path) -> None:
    from depthmocap.datasets.eval3d import Eval, joint_table

    read_all(Eval(folder, joint_table(folder / "names.json"), "box"))


def _mhad(folder: Path) -> None:
    from mhad_files import make_clips, write_mhad

    write_mhad(folder, make_clips((1,), (1,), 2))
    (folder / "tables.json").write_text(json.dumps({"reliable": ["Hips", "Neck"], "michel": ["Head"]}))


def _read_mhad(folder: Path) -> None:
    from depthmocap.datasets.mhad import MhadSet
    from depthmocap.evaluate.mhad_protocol import read_joint_tables

    either(lambda: read_joint_tables(folder / "tables.json"))
    read_all(MhadSet(folder))


def _panoptic(folder: Path) -> None:
    from mhad_files import make_clips, true_joints
    from panoptic_files import write_panoptic

    write_panoptic(folder / "171204_pose1", true_joints(make_clips((1,), (1,), 1)[0]))


def _read_panoptic(folder: Path) -> None:
    from depthmocap.datasets.panoptic import PanopticSet

    read_all(PanopticSet(folder, kinects=(2,)))


DATA_SETS: dict[str, Reader] = {
    "ubc3v": Reader(_section, _read_section, needs=("isal",)),
    "ray table": Reader(_ray_table, _read_ray_table),
    "shards": Reader(_shards, _read_shards, needs=("isal",)),
    "itop": Reader(_itop, _read_itop, needs=("h5py",)),
    "eval": Reader(_eval, _read_eval),
    "mhad": Reader(_mhad, _read_mhad),
    "panoptic": Reader(_panoptic, _read_panoptic),
}
