"""A pool: distinct postures picked from clips, in one file (see ``depthmocap postures build``)."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.output import replacing
from depthmocap.synth.motion.clips.motion import reason
from depthmocap.synth.motion.mocap import SPLITS

#: How a posture came to be, in the order of :attr:`PosturePool.kinds`.
KINDS = ("recorded", "mirrored", "recombined", "perturbed")
_FORMAT = "depthmocap posture pool 1"
#: Rotation vectors are stored as 16-bit integers of this (radians): wrong by 0.005 degrees at most.
_STEP_RAD = np.pi / 32767
#: What reading a foreign or damaged file raises.
NOT_NPZ = (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile)


def read_npz(handle: IO[bytes]) -> dict[str, ndarray]:
    """The arrays of an .npz file by name. Other files NumPy takes for pickles, and advises to trust them.

    Raises:
        ValueError: when it is another kind of file (or one of :data:`NOT_NPZ`).
    """
    if not zipfile.is_zipfile(handle):
        raise ValueError("it is no .npz file, or cut off")
    handle.seek(0)
    with np.load(handle, allow_pickle=False) as data:
        return dict(data)


@dataclasses.dataclass(frozen=True, eq=False)
class PosturePool:
    """Distinct postures, headings removed.

    Attributes:
        clips: index into ``clip_names`` of the clip that the legs are from.
        splits: index into :data:`SPLITS`; all of a posture is from clips of one split.
        simple: from clips of walking and running only.
        kinds: index into :data:`KINDS`.
        report: settings, counts, distances and skipped clips, as JSON can hold them.
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
        """Indices of the postures of a split; of walking and running ones only if ``simple``."""
        return np.flatnonzero((self.splits == SPLITS.index(split)) & (self.simple | (not simple)))

    def save(self, path: Path) -> None:
        """Write the pool, about 100 bytes a posture. The file appears whole or not at all.

        Raises:
            InputError: when it cannot be written, or does not end in .npz.
        """
        with replacing(path) as unfinished:
            np.savez_compressed(
                unfinished,
                format=np.array(_FORMAT),
                postures=np.rint(self.postures / _STEP_RAD).clip(-32767, 32767).astype(np.int16),
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
            with path.open("rb") as handle:
                data = read_npz(handle)
            if str(data["format"]) != _FORMAT:
                raise ValueError(f"it is of another version ({data['format']})")
            arrays = {name: data[name] for name in ("postures", "clips", "splits", "simple", "kinds")}
            names = tuple(str(name) for name in data["clip_names"])
            report = json.loads(str(data["report"]))
            _check(arrays, len(names))
        except NOT_NPZ as error:
            raise InputError(
                f"{path} is not a readable posture pool: {reason(error)}; make one with: depthmocap postures build"
            ) from None
        arrays["postures"] = arrays["postures"].astype(np.float32) * np.float32(_STEP_RAD)
        return cls(**arrays, clip_names=names, report=report)


def _check(arrays: dict[str, ndarray], clips: int) -> None:
    """Raise ValueError unless arrays of a file fit together."""
    n = len(arrays["postures"])
    if any(array.shape != ((n, 20, 3) if name == "postures" else (n,)) for name, array in arrays.items()):
        raise ValueError("its arrays do not fit together")
    most = {"clips": clips, "splits": len(SPLITS), "kinds": len(KINDS)}
    if n and any(arrays[name].min() < 0 or arrays[name].max() >= limit for name, limit in most.items()):
        raise ValueError("a clip, split or kind in it does not exist")
