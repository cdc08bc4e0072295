"""Where cameras stand, from a recording of one person who walks about; then motion capture with what was found.

python examples/05_calibrate.py RECORDING OUT
"""

import sys
from pathlib import Path

import numpy as np

import depthmocap


def main(recording: Path, out: Path) -> None:
    """Write OUT/rig.json and OUT/rig.html, and print how sure every pair of cameras is."""
    found = depthmocap.calibrate(depthmocap.CalibrateSettings(recording, out / "rig.json"))
    for pair in found.pairs:
        print(f"{pair.cameras}: {pair.grade}, within {pair.uncertainty_mm:.0f} mm, {pair.uncertainty_deg:.1f}°")

    source = depthmocap.open_source(recording, rig=out / "rig.json")
    pipeline = depthmocap.load_pipeline(source)
    heads = [pipeline(frames).pose.joints[depthmocap.JOINTS.index("Head")] for frames in source]
    print(f"the base of the skull is {np.nanmedian(np.stack(heads)[:, 2]):.2f} m over the floor that was found")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
