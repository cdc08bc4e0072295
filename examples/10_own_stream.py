"""A stream of your own beside one by its address: how fast the right hand is, as it happens.

python examples/10_own_stream.py RECORDING ws://127.0.0.1:8770
"""

import sys

import numpy as np

import depthmocap


class HandSpeed(depthmocap.Stream):
    """Prints how fast the right hand of everybody is. It may take its time: the capture does not wait for it."""

    def __init__(self) -> None:
        self._before: dict[int, depthmocap.Pose] = {}

    def send(self, sample: depthmocap.Sample) -> None:
        for number, pose in sample.people.items():
            before, hand = self._before.get(number, pose), depthmocap.JOINTS.index("RHand")
            way_m = np.linalg.norm(pose.joints[hand] - before.joints[hand])
            seconds = (pose.timestamp_ns - before.timestamp_ns) * 1e-9
            if seconds > 0:
                print(f"person {number}: {way_m / seconds:.2f} m/s", flush=True)
        self._before = sample.people


def main(source: str, addresses: list[str]) -> None:
    """Motion capture until the source ends; Ctrl-C ends it, too."""
    for _ in depthmocap.live(source, streams=[HandSpeed(), *addresses]):
        pass  # each result is here as well


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
