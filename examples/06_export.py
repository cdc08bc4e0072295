"""Files for other programs: all that `depthmocap run` writes, and single files from poses of your own loop.

python examples/06_export.py RECORDING OUT
"""

import sys
from pathlib import Path

import depthmocap
from depthmocap.exporting.bvh import write_bvh
from depthmocap.exporting.pose_csv import write_csv
from depthmocap.exporting.trc import write_trc
from depthmocap.recordings.pose_table import read_table


def main(recording: Path, out: Path) -> None:
    """Write OUT/take/pose.csv, .trc and .bvh, then the first half of it again by hand."""
    result = depthmocap.run(depthmocap.RunSettings(recording, out / "take", report=False))
    print(f"{result.frames} frames, mean confidence {result.summary['mean_confidence']:.2f}")

    poses = read_table(out / "take" / "pose.csv").poses()
    half = poses[: len(poses) // 2]
    up = depthmocap.open_source(recording).up  # of the world that the joints are in; files are Y up
    write_csv(out / "half.csv", half)
    write_trc(out / "half.trc", half, up)
    write_bvh(out / "half.bvh", half, up)
    print(f"{len(half)} frames in {out / 'half.csv'}, .trc and .bvh")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
