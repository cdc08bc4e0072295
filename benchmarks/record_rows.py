"""Rows of recording, and a comparison of codings of depth.

    python benchmarks/record_rows.py [--samples 8] [--json FILE]

prints, of every coding, how many times smaller than raw it is and how many 512×424 frames a second of CPU time it codes
and decodes, on generated Kinect 2 depth of furnished rooms with the sensor's noise (three views a sample).
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numba
import numpy as np
import tyro
from numpy import ndarray
from rich.console import Console
from rich.table import Table
from timing import Bench, Reference

from depthmocap.core.output import write_json
from depthmocap.errors import missing_extra
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.recordings.depth_codec import decode_depth, encode_depth
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mcap_writer import McapWriter
from depthmocap.synth.sample import Recipe, Sampler

#: Goal of coding a frame, milliseconds: 200 frames per second.
CODE_GOAL_MS = 5.0


def kinect_frames(samples: int) -> list[ndarray]:
    """Raw depth (millimetres, uint16, 424×512) of three views per sample."""
    draw = Sampler(Recipe("open", sensors=("kinect2",), noise="sensor", scene="full"), seed=6)
    views = [view for i in range(samples) for view in draw(i).views]
    return [np.round(view.depth_m / view.camera.depth_unit_m).astype(np.uint16) for view in views]


def rows(bench: Bench) -> None:
    """Coding, decoding, and whole frames into a file, each flushed to the system."""
    frames = kinect_frames(2)
    coded = [encode_depth(raw) for raw in frames]
    ratio = sum(raw.nbytes for raw in frames) / sum(map(len, coded))
    same = all(np.array_equal(decode_depth(data, "delta-zstd"), raw) for data, raw in zip(coded, frames, strict=True))
    png = [encode_depth(raw, "png") for raw in frames]
    bench.measure(
        "Code a 512×424 depth frame", lambda: [encode_depth(raw) for raw in frames],
        Reference("PNG", lambda: [encode_depth(raw, "png") for raw in frames], len(frames)),
        items=len(frames), goal_ms=CODE_GOAL_MS, agrees=same,
        note=f"{ratio:.2f}:1, PNG {sum(raw.nbytes for raw in frames) / sum(map(len, png)):.2f}:1",
    )  # fmt: skip
    bench.measure(
        "Decode it", lambda: [decode_depth(data, "delta-zstd") for data in coded],
        Reference("PNG", lambda: [decode_depth(data, "png") for data in png], len(png)), items=len(coded),
    )  # fmt: skip
    height, width = frames[0].shape
    rig = Rig((DepthCamera("cam0", width, height, 366.0, 366.0, 256.0, 206.0),))
    counter = itertools.count()

    def write() -> None:
        path = bench.folder / f"{next(counter)}.mcap"
        with McapWriter(path, rig, start_ns=0) as writer:
            for i, raw in enumerate(frames):
                writer.write("cam0", i * 33_333_333, raw)
        path.unlink()

    bench.measure(
        "Record it to a file", write, items=len(frames), goal_ms=CODE_GOAL_MS, note="MCAP, flushed after every frame"
    )
    path = bench.folder / "read.mcap"
    with McapWriter(path, rig, start_ns=0) as writer:
        for i, raw in enumerate(frames):
            writer.write("cam0", i * 33_333_333, raw)
    recording = McapRecording(path)
    bench.measure("Read it from a file", lambda: list(recording), items=len(frames))


@numba.njit(nogil=True)
def _rvl_encode(raw: ndarray, out: ndarray) -> int:
    """Runs of zeros and folded differences in 4-bit pieces, 3 bits of number in each (Wilson, ISS 2017)."""
    flat, previous, at, nibbles = raw.ravel(), 0, 0, 0
    i, size = 0, raw.size
    while i < size:
        zeros = 0
        while i < size and flat[i] == 0:
            zeros += 1
            i += 1
        run = 0
        while i + run < size and flat[i + run] != 0:
            run += 1
        for k in range(run + 2):
            if k < 2:
                value = zeros if k == 0 else run
            else:
                current = np.int64(flat[i + k - 2])
                delta = current - previous
                value = (delta << 1) ^ (delta >> 63)
                previous = current
            while True:
                nibble = value & 7
                value >>= 3
                if value:
                    nibble |= 8
                if nibbles & 1:
                    out[at] |= nibble
                    at += 1
                else:
                    out[at] = nibble << 4
                nibbles += 1
                if not value:
                    break
        i += run
    return at + (nibbles & 1)


def _codings() -> dict[str, tuple[Callable[[ndarray], bytes], Callable[[bytes], ndarray] | None]]:
    """Coding, and decoding where it is worth a measurement, by name."""
    try:
        import lz4.block
        import zstandard
    except ModuleNotFoundError as error:
        raise missing_extra(error.name or "lz4", "dev") from None
    room = np.empty(512 * 424 * 4, np.uint8)

    def planes(raw: ndarray) -> bytes:
        delta = raw.copy()
        delta[:, 1:] -= raw[:, :-1]
        signed = delta.view(np.int16)
        folded = (signed << 1) ^ (signed >> 15)
        return np.stack([folded.astype(np.uint8), (folded >> 8).astype(np.uint8)]).tobytes()

    def png(strategy: int, kind: int) -> Callable[[ndarray], bytes]:
        options = [
            cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, strategy, cv2.IMWRITE_PNG_FILTER, kind
        ]  # fmt: skip
        return lambda raw: cv2.imencode(".png", raw, options)[1].tobytes()

    fast, usual, strong = (zstandard.ZstdCompressor(level=level) for level in (-1, 1, 3))
    return {
        "delta-zstd (ours)": (encode_depth, lambda data: decode_depth(data, "delta-zstd")),
        "delta, planes, zstd -1": (lambda raw: fast.compress(planes(raw)), None),
        "delta, planes, zstd 3": (lambda raw: strong.compress(planes(raw)), None),
        "zstd 1": (lambda raw: usual.compress(raw.tobytes()), None),
        "zstd 3": (lambda raw: strong.compress(raw.tobytes()), None),
        "delta, planes, lz4": (lambda raw: lz4.block.compress(planes(raw)), None),
        "lz4": (lambda raw: lz4.block.compress(raw.tobytes()), None),
        "RVL": (lambda raw: room[: _rvl_encode(raw, room)].tobytes(), None),
        "png (Huffman, up; ours)": (lambda raw: encode_depth(raw, "png"), lambda data: decode_depth(data, "png")),
        "png (OpenCV's default)": (
            png(cv2.IMWRITE_PNG_STRATEGY_DEFAULT, cv2.IMWRITE_PNG_FILTER_SUB), lambda data: decode_depth(data, "png"),
        ),
        "png (Huffman, Paeth)": (png(cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY, cv2.IMWRITE_PNG_FILTER_PAETH), None),
    }  # fmt: skip


def _entropy_bits(frames: Sequence[ndarray]) -> float:
    """Entropy in bits per pixel of the differences to the left neighbour: the limit of a coding of them alone."""
    deltas = np.concatenate([np.diff(raw.astype(np.int32), axis=1, prepend=0).ravel() for raw in frames])
    share = np.unique(deltas, return_counts=True)[1] / deltas.size
    return float(-(share * np.log2(share)).sum())


@dataclasses.dataclass(frozen=True)
class Settings:
    """Compare codings of depth.

    Attributes:
        samples: generated people in rooms, of three views each.
        rounds: number of measurements of each coding, in turns with the others.
        json: file for all numbers.
    """

    samples: int = 8
    rounds: int = 3
    json: Path | None = None


def main(settings: Settings) -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    frames = kinect_frames(settings.samples)
    codings = _codings()
    size = dict.fromkeys(codings, 0)
    seconds = {name: [0.0, 0.0] for name in codings}
    for turn in range(settings.rounds + 1):  # the first warms up
        for name, (code, decode) in codings.items():
            start = time.process_time()
            coded = [code(raw) for raw in frames]
            middle = time.process_time()
            if decode is not None:
                for data in coded:
                    decode(data)
            end = time.process_time()
            size[name] = sum(map(len, coded))
            if turn:
                seconds[name][0] += middle - start
                seconds[name][1] += end - middle
    count = settings.rounds * len(frames)
    rows = {
        name: {
            "ratio": sum(raw.nbytes for raw in frames) / size[name],
            "coded_a_second": count / seconds[name][0],
            "decoded_a_second": None if decode is None else count / seconds[name][1],
        }
        for name, (_, decode) in codings.items()
    }
    bits = _entropy_bits(frames)
    table = Table(title=f"{len(frames)} frames; differences to the left have {bits:.2f} bits a pixel")
    for column in ("coding", "ratio", "coded a second", "decoded a second"):
        table.add_column(column, justify="left" if column == "coding" else "right")
    for name, row in rows.items():
        decoded = "" if row["decoded_a_second"] is None else f"{row['decoded_a_second']:.0f}"
        table.add_row(name, f"{row['ratio']:.2f}", f"{row['coded_a_second']:.0f}", decoded)
    Console(width=110).print(table)
    if settings.json is not None:
        write_json(settings.json, {"frames": len(frames), "bits_a_pixel": bits, "codings": rows})


if __name__ == "__main__":
    main(tyro.cli(Settings))
