"""Every reader of files that users give: a small whole input of it, and the call that reads it."""

from __future__ import annotations

import dataclasses
import json
import sys
import unittest.mock
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

_SUPPORT = str(Path(__file__).parents[1] / "support")
if _SUPPORT not in sys.path:
    sys.path.append(_SUPPORT)

from depthmocap.body.skeleton import JOINTS  # noqa: E402
from depthmocap.geometry import DepthCamera, Rig, look_at, save_rig  # noqa: E402

START, PERIOD = 1_700_000_000_000_000_000, 33_000_000


@dataclasses.dataclass(frozen=True)
class Reader:
    """How to read, and what.

    Attributes:
        make: writes a whole input into an empty folder.
        read: reads what is in the folder; raises InputError for what it cannot.
        only: files that are spoilt: those with any of these in their name.
        needs: packages of extras.
    """

    make: Callable[[Path], None]
    read: Callable[[Path], object]
    only: tuple[str, ...] = ("",)
    needs: tuple[str, ...] = ()


def _rig() -> Rig:
    pose = look_at(np.array([0.1, -3.0, 1.3]), np.array([0.0, 0.0, 1.0]))
    lens = (0.1, -0.2, 1e-3, 2e-3, 0.05)
    left = DepthCamera("left", 40, 24, 30.1, 31.2, 19.3, 12.1, pose, lens, 0.00025)
    return Rig((left, DepthCamera("right", 32, 16, 33.3, 30.0, 16.0, 8.0, pose)), "y")


def _depth(camera: DepthCamera, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.integers(2000, 9000, (camera.height, camera.width)).astype(np.uint16)


def _rig_file(folder: Path) -> None:
    save_rig(_rig(), folder / "rig.json")


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


def _pool(folder: Path) -> None:
    from depthmocap.synth.motion.pool import PosturePool

    rng, n = np.random.default_rng(0), 6
    kinds = np.zeros(n, np.uint8)
    postures, clips = rng.normal(0, 0.3, (n, 20, 3)).astype(np.float32), np.arange(n) % 2
    PosturePool(postures, clips, kinds, kinds > 0, kinds, ("a", "b"), {"read": 2}).save(folder / "pool.npz")


def _read_pool(folder: Path) -> None:
    from depthmocap.synth.motion.pool import PosturePool

    pool = PosturePool.load(folder / "pool.npz")
    assert pool.select("train", False).shape == (len(pool),) or len(pool)


def _prior(folder: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {
        "weights": np.full(3, 1 / 3), "simple_weights": np.full(3, 1 / 3), "means": rng.normal(0, 0.1, (3, 60)),
        "factors": rng.normal(0, 0.1, (3, 60, 2)),
    }  # fmt: skip
    np.savez_compressed(folder / "prior.npz", **{name: array.astype(np.float16) for name, array in arrays.items()})


def _read_prior(folder: Path) -> None:
    from depthmocap.synth.motion.postures import PosturePrior

    PosturePrior.load(folder / "prior.npz").sample(np.random.default_rng(0))


def _ridge(folder: Path) -> None:
    import importlib.resources

    packaged = importlib.resources.files("depthmocap.pose") / "weights" / "ridge_true.npz"
    (folder / "ridge.npz").write_bytes(packaged.read_bytes())


def _read_ridge(folder: Path) -> None:
    from depthmocap.pose.estimators import load_estimator

    load_estimator(folder / "ridge.npz")


def _tracks(folder: Path) -> None:
    from depthmocap.evaluate.estimated_sequences import EstimateStore, SequenceEstimates

    stamps = START + PERIOD * np.arange(3)
    track = SequenceEstimates("a", stamps, np.zeros((3, 18, 3)), np.zeros((2, 3, 18, 3)), np.ones((2, 3, 18)))
    EstimateStore(folder, {"seed": 1}).save(0, track)


def _read_tracks(folder: Path) -> None:
    from depthmocap.evaluate.estimated_sequences import EstimateStore

    track = EstimateStore(folder, {"seed": 1}).load(0)
    assert track is None or len(track.poses(2)) == len(track.timestamps_ns)


def _pose_samples(folder: Path) -> None:
    from depthmocap.pose.labelled_view import LABELS

    arrays: dict[str, np.ndarray] = {"joints": np.zeros((4, 18, 3)), "groups": np.arange(4)}
    for labels in LABELS:
        arrays[f"parts {labels}"] = np.zeros((4, 2, 61, 16), np.float32)
        for kind, shape in (("features", (4, 1032)), ("targets", (4, 18, 3)), ("members", (4,))):
            arrays[f"{kind} {labels} 1"] = np.zeros(shape, np.float32 if kind != "members" else np.int64)
    for first in ("000000", "000100"):
        np.savez(folder / f"{first}.npz", **arrays)  # pyright: ignore[reportArgumentType] - none is called allow_pickle


def _read_pose_samples(folder: Path) -> None:
    from depthmocap.train.pose_samples import PoseSampleSettings, read_samples

    read_samples(folder, PoseSampleSettings(views=(1,)))


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
            _either(lambda settings=settings: label.label_image(settings))


class _Everywhere:
    """Finds one part of a body wherever a person is."""

    def label_views(self, views: Any, masks: Any, *more: Any) -> Any:
        return [(mask.astype(np.uint8), mask.astype(np.float32), None) for mask in masks]


def _recording(folder: Path) -> None:
    from depthmocap.recordings.recording_writer import RecordingWriter

    rig = _rig()
    with RecordingWriter(folder / "rec", rig, {"left": _depth(rig["left"], 99)}) as writer:
        for i in range(3):
            frames = {camera.name: _depth(camera, 10 * i + k) for k, camera in enumerate(rig.cameras)}
            writer.write(START + i * PERIOD, frames, np.random.default_rng(i).normal(size=(18, 3)))


def _read_through(path: Path) -> None:
    """Everything that ``info``, ``run`` and ``convert`` ask of a recording."""
    from depthmocap.recordings.convert import recording_info
    from depthmocap.recordings.open_recording import open_recording

    recording = open_recording(path)
    recording_info(recording)
    for frames in recording:
        assert all(view.depth_m.shape == (view.camera.height, view.camera.width) for view in frames.views)
    for name in recording.rig.names:
        recording.background(name)


def _read_recording(folder: Path) -> None:
    _read_through(folder / "rec")


def _mcap(coding: Any, compression: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        from mutations import repacked

        from depthmocap.recordings.mcap_writer import McapWriter

        rig, path = _rig(), folder / "rec.mcap"
        with McapWriter(path, rig, {"left": _depth(rig["left"], 99)}, coding, start_ns=START) as writer:
            for i in range(3):
                for k, camera in enumerate(rig.cameras):
                    writer.write(camera.name, START + i * PERIOD + k, _depth(camera, 10 * i + k))
                writer.write_truth(START + i * PERIOD, np.random.default_rng(i).normal(size=(18, 3)))
        path.write_bytes(repacked(path.read_bytes(), compression))

    return make


def _read_mcap(folder: Path) -> None:
    _read_through(folder / "rec.mcap")


def _recover(folder: Path) -> None:
    from depthmocap.core.console import Terminal
    from depthmocap.recordings.convert import RecoverSettings, recover

    out = folder.parent / "recovered.mcap"
    out.unlink(missing_ok=True)
    recover(RecoverSettings(folder / "rec.mcap", out), Terminal(quiet=True))


def _mkv(folder: Path) -> None:
    from mkv_file import write_mkv

    depth = _depth(DepthCamera("a", 320, 288, 1.0, 1.0, 0.0, 0.0), 1)
    write_mkv(folder / "rec.mkv", [(1_000_000 + i * 33_333, depth + i) for i in range(2)])


def _read_mkv(folder: Path) -> None:
    _read_through(folder / "rec.mkv")


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

    camera = _rig()["right"]
    with ShardWriter(shard_path(folder, 0)) as writer:
        for i in range(2):
            depth_m = _depth(camera, i).astype(np.float32) / 1000
            labels = (depth_m > 5).astype(np.uint8) * np.uint8(3)
            writer.write(i, [View(camera, depth_m, labels > 0, labels)], np.ones((18, 3)), 7, {"seed": 1})


def _read_shards(folder: Path) -> None:
    from depthmocap.datasets.shards import ShardReader, count_samples

    _either(lambda: count_samples(folder / "shard-000000.tar"))
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
        _either(lambda mask=mask: _through(Itop(folder, "side", "test", mask)))


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

    _through(Eval(folder, joint_table(folder / "names.json"), "box"))


def _mhad(folder: Path) -> None:
    from mhad_files import make_clips, write_mhad

    write_mhad(folder, make_clips((1,), (1,), 2))
    (folder / "tables.json").write_text(json.dumps({"reliable": ["Hips", "Neck"], "michel": ["Head"]}))


def _read_mhad(folder: Path) -> None:
    from depthmocap.datasets.mhad import MhadSet
    from depthmocap.evaluate.mhad_protocol import read_joint_tables

    _either(lambda: read_joint_tables(folder / "tables.json"))
    _through(MhadSet(folder))


def _panoptic(folder: Path) -> None:
    from mhad_files import make_clips, true_joints
    from panoptic_files import write_panoptic

    write_panoptic(folder / "171204_pose1", true_joints(make_clips((1,), (1,), 1)[0]))


def _read_panoptic(folder: Path) -> None:
    from depthmocap.datasets.panoptic import PanopticSet

    _through(PanopticSet(folder, kinects=(2,)))


def _through(frames: Any) -> None:
    for _ in frames:
        pass
    assert all(isinstance(problem, str) for problem in frames.problems)


def _clips(*names: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        from clip_files import POSE, amc_text, asf_text, skeleton, write_bvh

        frames = [{}, POSE, {}]
        texts = {
            "07.asf": asf_text(), "07_01.amc": amc_text(frames),
            "manifest.csv": "file,description,fps\nwalk.bvh,walk,\n07_01.amc,\"run, jump\",60\n",
            "mapping.json": json.dumps({"pelvis": "mixamorig:Hips", "head": "mixamorig:Head"}),
        }  # fmt: skip
        for name in names:
            if name in texts:
                (folder / name).write_text(texts[name])
        write_bvh(folder / "walk.bvh", skeleton("mixamo"), frames)

    return make


class _Rest(dict[str, np.ndarray]):
    """Bones of a body at rest, without making the body: every one is somewhere."""

    def __missing__(self, bone: str) -> np.ndarray:
        return np.array([0.1 * (len(bone) % 7), 0.02 * len(bone), 0.1 * (sum(bone.encode()) % 11)])


def _read_clips(folder: Path) -> None:
    from depthmocap.synth.motion.clips.skeletons import read_mapping
    from depthmocap.synth.motion.mocap import ClipFolder, ClipReading

    mapping = read_mapping(folder / "mapping.json") if (folder / "mapping.json").exists() else {}
    list(ClipFolder.open(folder, ClipReading(mapping)).read(_Rest()))


def _read_bvh_joints(folder: Path) -> None:
    from depthmocap.datasets.bvh_joints import read_bvh_joints

    read_bvh_joints(folder / "walk.bvh").positions()


def _network(end: str, shape: tuple[int, ...], results: tuple[str, ...]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        import onnx
        from onnx import TensorProto, helper

        given, *told = (helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in (end, *results))
        graph = helper.make_graph([helper.make_node("Relu", [end], [name]) for name in results], "x", [given], told)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        model.metadata_props.add(key="network", value="fast")
        onnx.save(model, folder / "network.onnx")

    return make


def _read_classifier(folder: Path) -> None:
    from depthmocap.classify.classifier import Classifier

    Classifier(folder / "network.onnx", threads=1)


def _read_votes(folder: Path) -> None:
    from depthmocap.pose.estimators import load_estimator

    load_estimator(folder / "network.onnx")


def _weights(folder: Path) -> None:
    import torch
    from safetensors.torch import save_file

    save_file(torch.nn.Linear(3, 2).state_dict(), folder / "weights.safetensors")


def _read_weights(folder: Path) -> None:
    import torch

    from depthmocap.train.checkpoints import load_weights

    load_weights(torch.nn.Linear(3, 2), folder / "weights.safetensors")


def _checkpoint(folder: Path) -> None:
    import torch

    layer = torch.nn.Linear(3, 2)
    state = {"network": layer.state_dict(), "done": 16, "spent": 1.5, "history": json.dumps([{"step": 16}])}
    torch.save(state, folder / "checkpoint.pt")


def _read_run(folder: Path) -> None:
    from depthmocap.train.checkpoints import read_checkpoint

    read_checkpoint(folder / "checkpoint.pt", "cpu")


def _specs(folder: Path) -> None:
    lines = ("left=azure:000123?mode=nfov&fps=15", "realsense:923", "openni:a.oni?size=640x480", "rec#a")
    (folder / "cameras.spec").write_text("\n".join(lines))


def _read_specs(folder: Path) -> None:
    from depthmocap.cameras.registry import make_sources

    for line in (folder / "cameras.spec").read_text("utf-8", "surrogateescape").split("\n")[:8]:
        _either(lambda line=line: make_sources([line]))


def _either(call: Callable[[], object]) -> None:
    """An input that is refused must not keep the next from being read."""
    from depthmocap.errors import InputError

    try:
        call()
    except InputError as error:
        check_message(str(error))


def check_message(text: str) -> None:
    """An error is one line of bounded length that a terminal shows as it is."""
    assert 0 < len(text) <= 300 and text.isprintable(), f"an error of another form than one line: {text[:300]!r}"


_MCAP_PLAIN, _MCAP_ZSTD = _mcap("raw", ""), _mcap("delta-zstd", "zstd")
_AMC = ("07.asf", "07_01.amc")
_SQUARE, _PARTS = (1, 2, 8, 8), (1, 1, 61, 16)
_RECORD = ("foxglove", "zstandard")
READERS: dict[str, Reader] = {
    "rig": Reader(_rig_file, _read_rig),
    "poses": Reader(_poses, _read_poses),
    "animations": Reader(_animations, _read_animations),
    "compare": Reader(_results, _compare),
    "settings": Reader(_settings, _settings),
    "pool": Reader(_pool, _read_pool),
    "prior": Reader(_prior, _read_prior),
    "ridge": Reader(_ridge, _read_ridge),
    "tracks": Reader(_tracks, _read_tracks),
    "pose samples": Reader(_pose_samples, _read_pose_samples),
    "label": Reader(_picture, _label),
    "recording": Reader(_recording, _read_recording),
    "mcap": Reader(_MCAP_PLAIN, _read_mcap, needs=_RECORD),
    "mcap zstd": Reader(_MCAP_ZSTD, _read_mcap, needs=_RECORD),
    "mcap lz4": Reader(_mcap("png", "lz4"), _read_mcap, needs=(*_RECORD, "lz4")),
    "recover": Reader(_MCAP_PLAIN, _recover, needs=_RECORD),
    "recover zstd": Reader(_MCAP_ZSTD, _recover, needs=_RECORD),
    "mkv": Reader(_mkv, _read_mkv),
    "ubc3v": Reader(_section, _read_section, needs=("isal",)),
    "ray table": Reader(_ray_table, _read_ray_table),
    "shards": Reader(_shards, _read_shards, needs=("isal",)),
    "itop": Reader(_itop, _read_itop, needs=("h5py",)),
    "eval": Reader(_eval, _read_eval),
    "mhad": Reader(_mhad, _read_mhad),
    "panoptic": Reader(_panoptic, _read_panoptic),
    "bvh": Reader(_clips(), _read_clips, needs=("bvhio",)),
    "bvh joints": Reader(_clips(), _read_bvh_joints),
    "amc": Reader(_clips(*_AMC), _read_clips, _AMC, ("bvhio",)),
    "manifest": Reader(_clips(*_AMC, "manifest.csv", "mapping.json"), _read_clips, ("manifest", "mapping"), ("bvhio",)),
    "classifier": Reader(_network("windows", _SQUARE, ("probabilities", "joints")), _read_classifier, needs=("onnx",)),
    "votes": Reader(_network("parts", _PARTS, ("joints", "sure")), _read_votes, needs=("onnx",)),
    "weights": Reader(_weights, _read_weights, needs=("torch", "safetensors")),
    "checkpoint": Reader(_checkpoint, _read_run, needs=("torch",)),
    "camera specs": Reader(_specs, _read_specs),
}
