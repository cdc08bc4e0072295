"""Motion capture of a recording folder, frame by frame: where the right hand is and what each stage costs.

python examples/01_recording.py RECORDING
"""

import sys

import depthmocap


def main(recording: str) -> None:
    """Print the right wrist of every frame."""
    pipeline = depthmocap.load_pipeline(recording)
    hand = depthmocap.JOINTS.index("RHand")
    for frames in depthmocap.open_source(recording):
        result = pipeline(frames)
        if result.pose.confidence.max() == 0:
            print(f"{frames.timestamp_ns}: nobody in view")
            continue
        x, y, z = result.pose.joints[hand]
        spent = sum(result.milliseconds.values())
        print(f"{frames.timestamp_ns}: right hand at {x:.2f} {y:.2f} {z:.2f} m, {spent:.0f} ms")


if __name__ == "__main__":
    main(sys.argv[1])
