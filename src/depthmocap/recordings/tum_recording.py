"""Reads folders in the layout of the RGB-D sets of TUM and ICL-NUIM like a recording folder of one camera.

::

    depth.txt                    a line for each picture: its time in seconds, and its file
    associations.txt             in its place: times and files of depth and of colour pictures, in pairs
    depth/<time or number>.png   16-bit grey, 5000 units a metre, 0 = invalid
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.core.camera_names import safe_name
from depthmocap.core.reading.image_files import LARGEST_PICTURE, png_header
from depthmocap.core.reading.input_files import read_bytes, read_text
from depthmocap.core.reading.json_text import number_from_text
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_layout import read_depth_png
from depthmocap.recordings.true_joints import TrueJoints

#: Files that list the pictures, by preference.
_LISTS = ("depth.txt", "associations.txt", "associate.txt", "association.txt")
_UNIT_M = 1 / 5000
_SIZE = (640, 480)
#: Intrinsics that the sets' pages give for all their depth pictures: fx, fy, cx, cy. Those of ICL, which are numbered,
#: are of a generated camera.
_TUM, _ICL = (525.0, 525.0, 319.5, 239.5), (481.2, 480.0, 319.5, 239.5)
#: Pictures that are numbered come at this rate.
_ICL_HZ = 30


class TumRecording(Recording):
    """The depth of such a folder. The camera stands at the origin and is named after the folder."""

    @staticmethod
    def is_one(path: Path) -> bool:
        """Whether a folder is in this layout."""
        return (path / "depth").is_dir() and any((path / name).is_file() for name in _LISTS)

    def _load(self) -> tuple[Rig, dict[str, list[int]]]:
        listing = next(self.path / name for name in _LISTS if (self.path / name).is_file())
        pictures = _pictures(listing)
        if not pictures:
            raise InputError(f"{listing} lists no depth picture")
        numbered = all(time.isdecimal() and int(time) < 10**6 for time, _ in pictures)
        step = 10**9 // _ICL_HZ
        self._frames: dict[int, Path] = {}
        for time, file in pictures:
            stamp = int(time) * step if numbered else round(number_from_text(time, f"{listing}: time") * 1e9)
            if not 0 <= stamp < 2**63:
                raise InputError(f"{listing}: {time!r} is no time in seconds")
            self._frames[stamp] = self.path / file
        first = self._frames[min(self._frames)]
        width, height, _, _ = png_header(read_bytes(first, LARGEST_PICTURE), str(first))
        if (width, height) != _SIZE:
            raise InputError(
                f"{first} is {width}×{height}: a folder of this layout does not tell its intrinsics, which are known "
                "for 640×480; make a recording folder of it, with a rig.json that has them"
            )
        lens = _ICL if numbered else _TUM
        self._note(
            f"{self.path} does not tell its intrinsics: taken are those of the sets of {'ICL' if numbered else 'TUM'} "
            f"(fx {lens[0]:g}, fy {lens[1]:g}, cx {lens[2]:g}, cy {lens[3]:g}; 5000 units a metre)"
        )
        if (self.path / "groundtruth.txt").is_file() or list(self.path.glob("*.gt.freiburg")):
            self._note(f"{self.path} tells of a camera that moves: its poses are not read, it is taken to stand still")
        name = safe_name(self.path.resolve().name)
        camera = DepthCamera(name, *_SIZE, *lens, depth_unit_m=_UNIT_M)
        return Rig((camera,), "-y"), {name: sorted(self._frames)}

    def raw(self, name: str, stamp: int) -> UInt16[ndarray, "h w"]:
        return read_depth_png(self._frames[stamp], self.rig[name])

    def raw_background(self, name: str) -> UInt16[ndarray, "h w"] | None:
        return None

    def _where(self, name: str, what: str) -> str:
        return str(self._frames.get(int(what), what)) if what.isdecimal() else f"{self.path}: {what}"

    def _load_truth(self) -> TrueJoints | None:
        return None


def _pictures(listing: Path) -> list[tuple[str, PurePosixPath]]:
    """Time and file of each depth picture that a file lists."""
    pictures = []
    for number, line in enumerate(read_text(listing).splitlines(), 1):
        words = line.partition("#")[0].split()
        pairs = list(zip(words[::2], map(PurePosixPath, words[1::2]), strict=False))
        pair = next((pair for pair in pairs if pair[1].parts[:1] == ("depth",) and ".." not in pair[1].parts), None)
        if pair is not None:
            pictures.append(pair)
        elif words:
            raise InputError(f"{listing}: line {number} must be a time and a file in depth/, got {line[:80]!r}")
    return pictures
