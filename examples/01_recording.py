"""Motion capture of a recording, set by set: where the right wrist is, and how long that took.

python examples/01_recording.py RECORDING
"""

import sys

import depthmocap


def main(path: str) -> None:
    """Print the right wrist of every set of frames."""
    recording = depthmocap.open_source(path)  # or open_recording, which takes no section of UBC3V
    pipeline = depthmocap.load_pipeline(recording)
    wrist = depthmocap.JOINTS.index("RHand")
    for frames in recording:
        result = pipeline(frames)
        if result.pose.confidence.max() == 0:
            print(f"{frames.timestamp_ns}: nobody in view")
            continue
        x, y, z = result.pose.joints[wrist]
        spent_ms = sum(result.milliseconds.values())
        print(f"{frames.timestamp_ns}: right wrist at {x:.2f} {y:.2f} {z:.2f} m, {spent_ms:.0f} ms")


if __name__ == "__main__":
    main(sys.argv[1])
