"""Live motion capture that shows itself in the browser, while the program goes on with the results.

python examples/11_viewer.py RECORDING 8080
"""

import sys

import depthmocap


def main(source: str, port: int) -> None:
    """Motion capture until the source ends; Ctrl-C ends it, too."""
    seen = 0
    print(f"open http://localhost:{port}", flush=True)
    for result in depthmocap.live(source, viewer=port):
        seen += result.pose.confidence.max() > 0
    print(f"somebody was in view in {seen} sets")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
