"""Places of joints in BVH files: a hand-made arm whose places are known."""

import numpy as np
import pytest

from depthmocap.datasets.bvh_joints import read_bvh_joints
from depthmocap.errors import InputError

ARM = """HIERARCHY
ROOT shoulder
{
  OFFSET 0 100 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT upper arm
  {
    OFFSET 30 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 20 0 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.01
0 0 0 0 0 0 0 0 0
1 2 3 90 0 0 0 0 0
0 0 0 0 0 90 90 0 0
"""


def read(tmp_path, text):
    path = tmp_path / "arm.bvh"
    path.write_text(text)
    return read_bvh_joints(path)


def test_places_are_the_offsets_turned_one_after_the_other(tmp_path):
    arm = read(tmp_path, ARM)
    assert arm.skeleton.names == ("shoulder", "upper arm", "upper armEnd")
    assert arm.skeleton.is_end == (False, False, True)
    assert arm.frame_time_s == 0.01
    expected = [
        [(0, 100, 0), (30, 100, 0), (50, 100, 0)],
        [(1, 102, 3), (1, 132, 3), (1, 152, 3)],  # a quarter turn about z: x becomes y
        [(0, 100, 0), (0, 100, -30), (0, 120, -30)],  # about y: x becomes -z; then the hand about its own z: up
    ]
    assert np.allclose(arm.positions(), expected, atol=1e-9)
    assert np.allclose(arm.positions(np.array([2, 0])), [expected[2], expected[0]], atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("MOTION", "MOTOIN", "no MOTION"),
        ("Frames: 3", "Frames: 4", "3 of its 4 frames"),
        ("1 2 3 90 0 0 0 0 0", "1 2 3 90 0 0 0 0", "columns"),
        ("1 2 3 90", "1 2 nan 90", "not finite"),
        ("3 Zrotation Xrotation Yrotation\n    End", "3 Zrotation Xrotation Xposition\n    End", "'Xposition'"),
        ("3 Zrotation Xrotation Yrotation\n    End", "2 Zrotation Xrotation\n    End", "9 numbers, its joints 8"),
        ("3 Zrotation Xrotation Yrotation\n    End", "3 Xrotation Xrotation Yrotation\n    End", "a channel twice"),
        ("    OFFSET 30 0 0\n", "", "OFFSET"),
        ("      OFFSET 20 0 0\n    }\n  }\n}\n", "", "tree"),
        ("Frames: 3", "Frames: three", "not a whole BVH file"),
    ],
)
def test_what_is_wrong_is_told(tmp_path, old, new, told):
    assert old in ARM
    with pytest.raises(InputError, match=f"arm.bvh.*{told}"):
        read(tmp_path, ARM.replace(old, new))


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(InputError, match="not found"):
        read_bvh_joints(tmp_path / "none.bvh")
    (tmp_path / "b.bvh").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="not text"):
        read_bvh_joints(tmp_path / "b.bvh")
