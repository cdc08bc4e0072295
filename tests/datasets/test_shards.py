"""Tar shards: what was written is read back, by the webdataset package too, and damage is named."""

import dataclasses
import errno
import io
import json
import tarfile

import numpy as np
import pytest
from file_contents import contents
from ubc3v_files import SHAPE, make_views

from depthmocap.datasets.shards import ShardReader, ShardWriter, count_samples, shard_path, shards
from depthmocap.errors import InputError
from depthmocap.frames import View

pytest.importorskip("isal")


def samples(count=3, seed=0):
    rng = np.random.default_rng(seed)
    return [(i, make_views(rng), rng.uniform(-1, 2, (18, 3)), 5 + i) for i in range(count)]


def write(path, written):
    with ShardWriter(path) as writer:
        for index, views, joints, group in written:
            writer.write(index, views, joints, group, {"seed": 4})
    return path


def test_round_trip(tmp_path):
    written = samples()
    path = write(shard_path(tmp_path, 0), written)
    assert count_samples(path) == 3
    read = list(ShardReader(tmp_path))
    assert len(read) == 3
    for sample, (index, views, joints, group) in zip(read, written, strict=True):
        assert (sample.index, sample.group, sample.about["seed"]) == (index, group, 4)
        assert (sample.joints == joints).all()
        for view, original in zip(sample.views, views, strict=True):
            assert view.labels is not None
            assert (view.labels == original.labels).all()
            assert (view.mask == original.mask).all()
            assert np.abs(view.depth_m - original.depth_m).max() <= 0.000501
            assert (view.camera.world_from_camera == original.camera.world_from_camera).all()
            assert view.camera.name == original.camera.name
    assert list(tmp_path.iterdir()) == [path]


def test_masks_and_what_depth_cannot_hold(tmp_path):
    ((_, (view, *_), joints, _),) = samples(1)
    mask = view.mask.copy()
    mask[:20] = True
    depth = view.depth_m.copy()
    depth[0, :4] = 65.534, 65.535, 70.0, np.nan
    views = [dataclasses.replace(view, mask=mask, depth_m=depth), View(view.camera, view.depth_m)]
    path = write(tmp_path / "shard-000000.tar", [(7, views, joints, 0)])
    with tarfile.open(path) as tar:
        assert tar.getnames() == [
            "000000007.cam1.depth.png",
            "000000007.cam1.labels.png",
            "000000007.cam1.mask.png",
            "000000007.cam2.depth.png",
            "000000007.json",
        ]
    (sample,) = ShardReader(path)
    assert (sample.views[0].mask == mask).all()
    np.testing.assert_allclose(sample.views[0].depth_m[0, :4], [65.534, 0, 0, 0])
    assert sample.views[1].labels is None
    assert sample.views[1].mask is None


def test_equal_samples_give_equal_shards(tmp_path):
    a, b = write(tmp_path / "a.tar", samples()), write(tmp_path / "b.tar", samples())
    assert contents(a) == contents(b)
    assert contents(a) != contents(write(tmp_path / "c.tar", samples(seed=1)))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it leaves its files open
def test_webdataset_reads_them(tmp_path):
    webdataset = pytest.importorskip("webdataset")
    written = samples(2)
    path = write(shard_path(tmp_path, 0), written)
    data = webdataset.WebDataset(str(path), shardshuffle=False).decode("rgb8")
    read = list(data)
    assert [sample["__key__"] for sample in read] == ["000000000", "000000001"]
    assert read[1]["json"]["group"] == 6
    assert read[0]["cam2.labels.png"].shape[:2] == SHAPE
    assert (read[0]["cam2.labels.png"][..., 0] == written[0][1][1].labels).all()


def test_an_error_leaves_nothing(tmp_path):
    path = tmp_path / "shard-000000.tar"
    with pytest.raises(KeyboardInterrupt), ShardWriter(path) as writer:
        writer.write(0, samples(1)[0][1], np.zeros((18, 3)), 0)
        raise KeyboardInterrupt
    with pytest.raises(ValueError, match="18 finite joints"), ShardWriter(path) as writer:
        writer.write(0, samples(1)[0][1], np.full((18, 3), np.nan), 0)
    assert not list(tmp_path.iterdir())


class FullDisk(io.BytesIO):
    """The first writes pass."""

    def write(self, data):
        if self.tell() > 50_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


def test_a_full_disk_leaves_nothing(tmp_path):
    path = tmp_path / "shard-000000.tar"
    writer = ShardWriter(path)
    with pytest.raises(OSError, match="No space"), writer:
        writer._tar.fileobj = FullDisk()
        for i in range(10):
            writer.write(i, samples(1)[0][1], np.zeros((18, 3)), 0)
    assert not list(tmp_path.iterdir())


def test_damage_is_named(tmp_path):
    path = write(shard_path(tmp_path, 0), samples(2))
    whole = path.read_bytes()
    for damaged in (
        whole[: len(whole) // 2],
        whole[:700],
        whole[:-10_240],
        b"",
        b"not a tar file at all",
        b"\xff" * 10_240,
    ):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"shard-000000\.tar.* damaged"):
            list(ShardReader(tmp_path))
    with pytest.raises(InputError, match="holds no shards"):
        shards(tmp_path / "nothing")
    with pytest.raises(InputError, match="not found"):
        count_samples(tmp_path / "nothing.tar")


def test_damaged_samples_are_named(tmp_path):
    path = write(shard_path(tmp_path, 0), samples(1))
    with tarfile.open(path) as tar:
        files = {name: tar.extractfile(name) for name in tar.getnames()}
        members = {name: file.read() for name, file in files.items() if file is not None}
    document = json.loads(members["000000000.json"])

    def changed(**values):
        return json.dumps(document | values).encode()

    for name, data, message in [
        ("000000000.cam1.depth.png", b"", "not a complete PNG"),
        ("000000000.cam1.depth.png", members["000000000.cam1.labels.png"], "uint8"),
        ("000000000.json", b"{", "sample 000000000 is damaged"),
        ("000000000.json", b"[]", "sample 000000000 is damaged"),
        ("000000000.json", 9999 * b"[", "brackets within one another"),
        ("000000000.json", changed(joints={}), "has no 'Head'"),
        ("000000000.json", changed(joints={key: ["1", 2, 3] for key in document["joints"]}), "joints must be"),
        ("000000000.json", changed(index=10**30), "index must be a whole number"),
        ("000000000.json", changed(cameras=[document["cameras"][0] | {"fx": True}]), "fx must be a finite number"),
        ("000000000.json", changed(cameras=[document["cameras"][0] | {"width": 10**6}]), "at most 64 million"),
        ("000000000.json", changed(cameras=[{}]), "has no 'distortion'"),
        ("000000000.cam3.depth.png", None, "has no 'cam3.depth.png'"),
    ]:
        with tarfile.open(path, "w") as tar:
            for each, old in members.items():
                new = data if each == name else old
                if new is not None:
                    info = tarfile.TarInfo(each)
                    info.size = len(new)
                    tar.addfile(info, io.BytesIO(new))
        with pytest.raises(InputError, match=message) as caught:
            list(ShardReader(path))
        assert path.name in str(caught.value)
