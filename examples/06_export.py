"""Files for other programs: all that `depthmocap run` writes, and single files from poses of your own loop.

python examples/06_export.py RECORDING OUT
"""

import sys
from pathlib import Path

import depthmocap


def main(recording: Path, out: Path) -> None:
    """Write OUT/take/pose.csv, .trc and .bvh, OUT/files of other formats, then the first half of it again by hand."""
    result = depthmocap.run(depthmocap.RunSettings(recording, out / "take", report=False))
    print(f"{result.frames} frames, {result.gaps} without a person")

    # As `depthmocap export`: a body that moves, for a browser or Blender, and arrays with rotations.
    paths = depthmocap.export(depthmocap.ExportSettings(out / "take", out / "files", formats=("glb", "npz")))
    print(*paths)

    poses = result.poses()
    half = poses[: len(poses) // 2]
    up = depthmocap.open_source(recording).up  # of the world that the joints are in; TRC and BVH are Y up
    depthmocap.write_csv(out / "half.csv", half)
    depthmocap.write_trc(out / "half.trc", half, up)
    depthmocap.write_bvh(out / "half.bvh", half, up)
    print(f"{len(half)} frames in {out / 'half.csv'}, .trc and .bvh")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
