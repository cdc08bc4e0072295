"""ASF/AMC files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clip_files import POSE, amc_text, asf_text, check_pose, heads, skeleton, write_bvh

from depthmocap.errors import InputError
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.clips.amc_clips import read_amc_motion, read_asf
from depthmocap.synth.motion.mocap import Clip, ClipFolder, ClipReading, read_amc, read_bvh

pytest.importorskip("bvhio")


def test_amc_gives_the_postures_of_the_same_bvh(tmp_path: Path, default_body: Body) -> None:
    rng = np.random.default_rng(3)
    frames = [{}, POSE, *({row[0]: rng.uniform(-60, 60, 3) for row in skeleton("mixamo")} for _ in range(6))]
    (tmp_path / "07.asf").write_text(asf_text())
    (tmp_path / "07_01.amc").write_text(amc_text(frames))
    write_bvh(tmp_path / "07_01.bvh", skeleton("mixamo"), frames)
    from_amc, frame_time = read_amc(tmp_path / "07_01.amc", tmp_path / "07.asf", heads(default_body))
    from_bvh, _ = read_bvh(tmp_path / "07_01.bvh", heads(default_body))
    assert frame_time == pytest.approx(1 / 120)
    check_pose(default_body, from_amc)
    for amc, bvh in zip(from_amc, from_bvh, strict=True):
        np.testing.assert_allclose(
            default_body.pose(amc.astype(float)).joints, default_body.pose(bvh.astype(float)).joints, atol=2e-3
        )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (":hierarchy", ":nothing", "no :hierarchy"),
        ("name lfoot", "name lefthoof", "lefthoof|lfoot"),
        ("direction", "directory", "direction"),
        ("length 28.0", "length long", "long"),
        ("dof rx", "dof rq", "channel RQ"),
        ("dof rx ry", "dof rx rx", "twice"),
        ("\nend\n:hier", "\naxis 0 0\nend\n:hier", "cut off"),
        ("lowerback upperback", "lowerback upperback root", "root hangs"),
    ],
)
def test_bad_asf_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "07.asf"
    assert old in asf_text()
    path.write_text(asf_text().replace(old, new, 1))
    with pytest.raises(InputError, match=f"not a readable ASF file.*({message})"):
        read_asf(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n3\n", "\n3\nrtail 1\n", "damaged or cut off"),
        ("lfoot", "lhoof", "hoof|lfoot"),
        ("0.000000", "nan", "not finite"),
        ("0.000000", "zero", "zero"),
        ("\n1\n", "\none\n", "no frames|not all of"),
    ],
)
def test_bad_amc_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "07.asf").write_text(asf_text())
    path = tmp_path / "07_01.amc"
    path.write_text(amc_text([{}] * 4).replace(old, new))
    with pytest.raises(InputError, match=f"not a readable AMC file.*({message})"):
        read_amc_motion(path, read_asf(tmp_path / "07.asf"))
    path.write_text(amc_text([{}] * 4)[:-60])
    with pytest.raises(InputError, match="damaged or cut off"):
        read_amc_motion(path, read_asf(tmp_path / "07.asf"))


def test_amc_rates_and_skeletons_of_others(tmp_path: Path, default_body: Body) -> None:
    (tmp_path / "07.asf").write_text(asf_text())
    (tmp_path / "08_01.amc").write_text(amc_text([{}] * 9))
    reading = ClipReading(skeletons={"08": "07.asf"})
    lengths = []
    for manifest in ("file,description\n", "file,description,fps\n08_01.amc,run,30\n"):
        (tmp_path / "manifest.csv").write_text(manifest)
        (clip,) = ClipFolder.open(tmp_path, reading).read(heads(default_body))
        assert isinstance(clip, Clip)
        lengths.append(len(clip.postures))
    assert lengths == [3, 9]
    assert clip.simple
    (tmp_path / "manifest.csv").write_text("file,description,fps\n08_01.amc,run,fast\n")
    with pytest.raises(InputError, match=r"manifest\.csv: fps must be a number above 0, got 'fast'"):
        ClipFolder.open(tmp_path)
