"""Posture pools: distinct postures selected from clips, in one file (``depthmocap postures build``)."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from depthmocap.core.output import atomic_write
from depthmocap.core.reading.array_files import ArrayType, error_reason, read_npz
from depthmocap.core.reading.json_text import parse_json
from depthmocap.errors import InputError
from depthmocap.synth.motion.mocap import SPLITS

#: Origins of postures, in the order of :attr:`PosturePool.kinds`.
KINDS = ("recorded", "mirrored", "recombined", "perturbed")
_FORMAT = "depthmocap posture pool 1"
#: Quantum of rotation vectors, which are stored as 16-bit integers (radians): the error is at most 0.005 degrees.
_QUANTUM_RAD = np.pi / 32767
_TEXT = ArrayType("", "U")
_ARRAYS = {
    "postures": ArrayType("n 20 3", "i"), "clips": ArrayType("n", "iu"), "splits": ArrayType("n", "u"),
    "simple": ArrayType("n", "b"), "kinds": ArrayType("n", "u"),
}  # fmt: skip
_NAMES = {"clip_names": ArrayType("m", "U"), "report": _TEXT}
#: Largest size of a pool's arrays: about two million postures, which take twice as much in memory.
_LARGEST_BYTES = 1 << 28


@dataclasses.dataclass(frozen=True, eq=False)
class PosturePool:
    """Distinct postures, headings removed.

    Attributes:
        clips: index into ``clip_names`` of the clip of the legs.
        splits: index into :data:`SPLITS`; all parts of a posture come from clips of one split.
        simple: all parts come from clips of walking and running.
        kinds: index into :data:`KINDS`.
        report: settings, counts, distances and skipped clips, in JSON's types.
    """

    postures: Float[ndarray, "n 20 3"]
    clips: Int[ndarray, "n"]
    splits: UInt8[ndarray, "n"]
    simple: Bool[ndarray, "n"]
    kinds: UInt8[ndarray, "n"]
    clip_names: tuple[str, ...]
    report: dict[str, Any]

    def __len__(self) -> int:
        return len(self.postures)

    def select(self, split: str, simple: bool) -> Int[ndarray, "m"]:
        """Indices of the postures of a split; with ``simple`` only of walking and running ones."""
        return np.flatnonzero((self.splits == SPLITS.index(split)) & (self.simple | (not simple)))

    def save(self, path: Path) -> None:
        """Write the pool, about 100 bytes a posture. The write is atomic.

        Raises:
            InputError: when it cannot be written, or does not end in .npz.
        """
        with atomic_write(path) as unfinished:
            np.savez_compressed(
                unfinished,
                format=np.array(_FORMAT),
                postures=np.rint(self.postures / _QUANTUM_RAD).clip(-32767, 32767).astype(np.int16),
                clips=self.clips.astype(np.int32),
                splits=self.splits,
                simple=self.simple,
                kinds=self.kinds,
                clip_names=np.array(self.clip_names, dtype=np.str_),
                report=np.array(json.dumps(self.report)),
            )

    @classmethod
    def load(cls, path: Path) -> PosturePool:
        """Read a pool.

        Raises:
            InputError: when the file is missing, damaged, or something else.
        """
        try:
            version = str(read_npz(path, {"format": _TEXT}, _LARGEST_BYTES)["format"])
            if version != _FORMAT:
                raise InputError(f"it is of another version ({version})")
            data = read_npz(path, _ARRAYS | _NAMES, _LARGEST_BYTES)
            names = tuple(str(name) for name in data["clip_names"])
            report = parse_json(str(data["report"]), "its report")
            if not isinstance(report, dict):
                raise InputError("its report is no object")
            arrays = {name: data[name] for name in _ARRAYS}
            _check(arrays, len(names))
        except InputError as error:
            raise InputError(
                f"{path} is not a readable posture pool: {error_reason(error, path)}; "
                "make one with: depthmocap postures build"
            ) from None
        arrays["postures"] = arrays["postures"].astype(np.float32)
        arrays["postures"] *= np.float32(_QUANTUM_RAD)
        return cls(**arrays, clip_names=names, report=report)


def _check(arrays: dict[str, ndarray], clips: int) -> None:
    """Raise InputError unless the arrays of a file are consistent."""
    n = len(arrays["postures"])
    limits = {"clips": clips, "splits": len(SPLITS), "kinds": len(KINDS)}
    if n and any(arrays[name].min() < 0 or arrays[name].max() >= limit for name, limit in limits.items()):
        raise InputError("a clip, split or kind in it does not exist")
