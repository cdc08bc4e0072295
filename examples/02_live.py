"""Live motion capture: which hand is the higher one, as it happens. A recording stands in for cameras.

python examples/02_live.py RECORDING
python examples/02_live.py realsense:SERIAL azure:SERIAL rig.json
"""

import sys
from pathlib import Path

import depthmocap


def main(sources: list[str], rig: Path | None = None) -> None:
    """Print a line whenever the higher hand changes; Ctrl-C ends it."""
    right, left = (depthmocap.JOINTS.index(name) for name in ("RHand", "LHand"))
    shown = ""
    for result in depthmocap.live(*sources, rig=rig):  # opens the cameras, and closes them at the end
        pose = result.pose
        if min(pose.confidence[right], pose.confidence[left]) < 0.5:
            continue  # a hand that nobody sees is a guess
        higher = "right" if pose.joints[right, 2] > pose.joints[left, 2] else "left"
        if higher != shown:
            print(f"{pose.timestamp_ns}: the {higher} hand is higher", flush=True)
            shown = higher


if __name__ == "__main__":
    arguments = sys.argv[1:]
    rigs = [Path(name) for name in arguments if name.endswith(".json")]
    main([name for name in arguments if not name.endswith(".json")], rigs[0] if rigs else None)
