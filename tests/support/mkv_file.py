"""Writes MKV files as the Azure Kinect's recorder lays them out."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

#: cx, cy, fx, fy, k1 … k6, two unused, p2, p1: shares of the sensor's square, as the factory writes them.
LENS = [0.50, 0.51, 0.4925, 0.493, 0.52, -0.02, 0.006, 0.86, 0.105, 0.001, 0, 0, -2e-5, 1e-4]


def element(number: int, content: bytes, unknown: bool = False) -> bytes:
    """One element; with ``unknown`` its size is left open, as in a file that is still being written."""
    size = (0x01FF_FFFF_FFFF_FFFF if unknown else len(content) | 1 << 56).to_bytes(8, "big")
    return number.to_bytes((number.bit_length() + 7) // 8, "big") + size + content


def whole(number: int, value: int) -> bytes:
    return element(number, value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big"))


def text(number: int, value: str) -> bytes:
    return element(number, value.encode())


def track(number: int, name: str, size: tuple[int, int], fourcc: bytes = b"b16g") -> bytes:
    video = element(0xE0, whole(0xB0, size[0]) + whole(0xBA, size[1]))
    private = element(0x63A2, bytes(16) + fourcc + bytes(20))
    return element(0xAE, whole(0xD7, number) + text(0x86, "V_MS/VFW/FOURCC") + text(0x536E, name) + private + video)


def calibration(location: str = "CALIBRATION_CameraLocationD0") -> bytes:
    colour = {"Location": "CALIBRATION_CameraLocationPV0", "Intrinsics": {"ModelParameters": [0.1] * 14}}
    depth = {"Location": location, "Intrinsics": {"ModelParameters": LENS}}
    return json.dumps({"CalibrationInformation": {"Cameras": [colour, depth]}}).encode() + b"\0"


def write_mkv(
    path: Path, frames: Sequence[tuple[int, np.ndarray]], *, tags: dict[str, str] | None = None,
    fourcc: bytes = b"b16g", attached: bytes | None = None, name: str = "DEPTH", unknown: bool = False,
) -> None:  # fmt: skip
    """``frames``: time (microseconds) and depth; each is in a cluster with a picture of another track, as a block."""
    height, width = frames[0][1].shape if frames else (288, 320)
    start_us = frames[0][0] if frames else 0
    every = {"K4A_START_OFFSET_NS": str(start_us * 1000), "K4A_DEVICE_SERIAL_NUMBER": "000123"} | (tags or {})
    tagged = b"".join(
        element(0x7373, element(0x67C8, text(0x45A3, key) + text(0x4487, value))) for key, value in every.items()
    )
    file = element(0x61A7, text(0x466E, "calibration.json") + element(0x465C, attached or calibration()))
    clusters = b""
    for number, (stamp, depth) in enumerate(frames):
        infrared = element(0xA3, b"\x82\x00\x00\x80" + bytes(2 * depth.size))
        block = b"\x81\x00\x07\x80" + depth.astype(">u2").tobytes()  # 7 after the cluster's time
        held = element(0xA0, element(0xA1, block)) if number % 2 else element(0xA3, block)
        clusters += element(0x1F43B675, whole(0xE7, max(stamp - start_us - 7, 0)) + infrared + held, unknown)
    segment = (
        element(0x1549A966, whole(0x2AD7B1, 1000))
        + element(0xEC, bytes(100))
        + element(0x1654AE6B, track(1, name, (width, height), fourcc) + track(2, "IR", (width, height)))
        + element(0x1941A469, file)
        + element(0x1254C367, tagged)
        + clusters
    )
    path.write_bytes(element(0x1A45DFA3, text(0x4282, "matroska")) + element(0x18538067, segment, unknown))
