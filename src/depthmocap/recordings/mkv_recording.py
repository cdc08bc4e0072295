"""Reads MKV files of the Azure Kinect's recorder (``k4arecorder``, also for Femto cameras) like a recording folder.

This needs no SDK, because depth is not compressed in these files and the factory calibration is attached. The format is
Matroska (RFC 8794 and 9559) with the tags and tracks that the SDK's documentation lists.
"""

from __future__ import annotations

import dataclasses
import mmap
from collections.abc import Iterator

import numpy as np
from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.core.camera_names import safe_name
from depthmocap.core.reading.input_files import open_file
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.recordings.azure_calibration import depth_camera, is_depth_size
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.true_joints import TrueJoints

#: Matroska elements that contain others. The reader ignores their sizes, which a killed recorder did not write, and
#: reads their contents as one sequence.
_SEGMENT, _CLUSTER, _GROUP, _TRACKS, _TRACK, _VIDEO = 0x18538067, 0x1F43B675, 0xA0, 0x1654AE6B, 0xAE, 0xE0
_INFO, _ATTACHMENTS, _ATTACHED, _TAGS, _TAG, _SIMPLE_TAG = 0x1549A966, 0x1941A469, 0x61A7, 0x1254C367, 0x7373, 0x67C8
_CONTAINERS = {
    _SEGMENT, _CLUSTER, _GROUP, _TRACKS, _TRACK, _VIDEO, _INFO, _ATTACHMENTS, _ATTACHED, _TAGS, _TAG, _SIMPLE_TAG
}  # fmt: skip
#: Matroska elements with values.
_HEADER, _SCALE, _CLUSTER_TIME, _SIMPLE_BLOCK, _BLOCK = 0x1A45DFA3, 0x2AD7B1, 0xE7, 0xA3, 0xA1
_NUMBER, _NAME, _PRIVATE, _WIDTH, _HEIGHT = 0xD7, 0x536E, 0x63A2, 0xB0, 0xBA
_FILE_NAME, _FILE_DATA, _TAG_NAME, _TAG_TEXT = 0x466E, 0x465C, 0x45A3, 0x4487
#: Codec of depth pictures: 16 bits a pixel, the high byte first.
_FOURCC = b"b16g"


def _elements(data: mmap.mmap) -> Iterator[tuple[int, int, int]]:
    """Number, start and end of each element. Stops at damaged bytes and at an element that was cut off."""
    offset, end = 0, len(data)
    while offset < end:
        first = data[offset]
        length = 9 - first.bit_length()
        if length > 4 or offset + length >= end:
            return
        number = int.from_bytes(data[offset : offset + length], "big")
        offset += length
        width = 9 - data[offset].bit_length()
        if width > 8 or offset + width > end:
            return
        size = int.from_bytes(data[offset : offset + width], "big") & ((1 << 7 * width) - 1)
        offset += width
        if number in _CONTAINERS:
            yield number, offset, offset
            continue
        if offset + size > end:
            return
        yield number, offset, offset + size
        offset += size


@dataclasses.dataclass
class _Track:
    number: int = 0
    name: str = ""
    fourcc: bytes = b""
    width: int = 0
    height: int = 0


@dataclasses.dataclass
class _Contents:
    """The contents of a file, in its order."""

    tracks: list[_Track] = dataclasses.field(default_factory=list)
    tags: dict[str, str] = dataclasses.field(default_factory=dict)
    files: dict[str, bytes] = dataclasses.field(default_factory=dict)
    #: Track, time (in ``scale_ns``), start and end of each frame.
    blocks: list[tuple[int, int, int, int]] = dataclasses.field(default_factory=list)
    scale_ns: int = 1_000_000
    end: int = 0


def _scan(data: mmap.mmap) -> _Contents:
    contents = _Contents()
    cluster_time, name = 0, ""
    for kind, start, end in _elements(data):
        contents.end = end
        value = data[start : min(end, start + 12)] if kind in (_SIMPLE_BLOCK, _BLOCK) else data[start:end]
        whole = int.from_bytes(value, "big") if len(value) <= 8 else 0
        if kind == _TRACK:
            contents.tracks.append(_Track())
        elif kind == _NUMBER and contents.tracks:
            contents.tracks[-1].number = whole
        elif kind == _NAME and contents.tracks:
            contents.tracks[-1].name = value.decode(errors="replace")
        elif kind == _PRIVATE and contents.tracks:
            contents.tracks[-1].fourcc = value[16:20]
        elif kind == _WIDTH and contents.tracks:
            contents.tracks[-1].width = whole
        elif kind == _HEIGHT and contents.tracks:
            contents.tracks[-1].height = whole
        elif kind in (_FILE_NAME, _TAG_NAME):
            name = value.decode(errors="replace")
        elif kind == _FILE_DATA:
            contents.files[name] = value
        elif kind == _TAG_TEXT:
            contents.tags[name] = value.decode(errors="replace")
        elif kind == _SCALE:
            contents.scale_ns = whole
        elif kind == _CLUSTER_TIME:
            cluster_time = whole
        elif kind in (_SIMPLE_BLOCK, _BLOCK) and end - start > 4 and value[0] & 0x80:
            time = cluster_time + int.from_bytes(value[1:3], "big", signed=True)
            contents.blocks.append((value[0] & 0x7F, time, start + 4, end))
    return contents


class MkvRecording(Recording):
    """The depth of an Azure Kinect's MKV file. The camera stands at the origin and is named after the file."""

    def _load(self) -> tuple[Rig, dict[str, list[int]]]:
        path = self.path
        with open_file(path) as file:
            try:
                self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            except (OSError, ValueError) as error:  # ValueError: an empty file
                reason = error.strerror if isinstance(error, OSError) else "it is empty"
                raise InputError(f"{path} cannot be read: {reason}") from None
        if int.from_bytes(self._data[:4], "big") != _HEADER:
            raise InputError(f"{path} is not a Matroska file (MKV)")
        contents = _scan(self._data)
        depth = next((track for track in contents.tracks if track.name == "DEPTH"), None)
        if depth is None:
            names = ", ".join(track.name or "one without name" for track in contents.tracks) or "none"
            raise InputError(f"{path} has no track DEPTH of an Azure Kinect; its tracks: {names}")
        if depth.fourcc != _FOURCC or not is_depth_size(depth.width, depth.height):
            raise InputError(f"{path} has depth of an unknown form ({depth.fourcc!r}, {depth.width}×{depth.height})")
        name = safe_name(path.stem)
        camera = self._camera(name, depth, contents)
        size = 2 * depth.width * depth.height
        start_ns = self._start_ns(contents)
        self._frames: dict[int, tuple[int, int]] = {}
        for track, time, start, end in contents.blocks:
            if track == depth.number and end - start == size:
                self._frames.setdefault(start_ns + time * contents.scale_ns, (start, end))
        if contents.end < len(self._data):
            self._note(f"{path} was cut off or is damaged after {contents.end} bytes; what is before is read")
        if not self._frames:
            raise InputError(f"{path} has no depth frame")
        # The clocks of cameras on one trigger wire start at its first pulse.
        wired = contents.tags.get("K4A_WIRED_SYNC_MODE") in ("MASTER", "SUBORDINATE")
        serial = contents.tags.get("K4A_DEVICE_SERIAL_NUMBER", name)
        self._clock = "azure wired" if wired else f"azure {serial} device"
        return Rig((camera,), "-y"), {name: sorted(self._frames)}

    def _start_ns(self, contents: _Contents) -> int:
        """The device time (ns) at which the file's time begins."""
        offset_ns = contents.tags.get("K4A_START_OFFSET_NS", "0")
        if not (offset_ns.isascii() and offset_ns.isdecimal() and len(offset_ns) < 19):
            raise InputError(f"{self.path}: the tag K4A_START_OFFSET_NS must be nanoseconds, not {offset_ns!r}")
        return int(offset_ns)

    def _camera(self, name: str, track: _Track, contents: _Contents) -> DepthCamera:
        attached = contents.files.get(contents.tags.get("K4A_CALIBRATION_FILE", "calibration.json"))
        if attached is None:
            raise InputError(f"{self.path} has no calibration attached: was it written by k4arecorder?")
        return depth_camera(name, (track.width, track.height), attached, f"{self.path}: the attached calibration")

    def device_time(self, name: str, stamp: int) -> tuple[int, str]:
        return stamp, self._clock

    def raw(self, name: str, stamp: int) -> UInt16[ndarray, "h w"]:
        start, end = self._frames[stamp]
        camera = self.rig[name]
        return np.frombuffer(self._data[start:end], ">u2").reshape(camera.height, camera.width).astype(np.uint16)

    def raw_background(self, name: str) -> UInt16[ndarray, "h w"] | None:
        return None

    def _where(self, name: str, what: str) -> str:
        return f"{self.path}: frame {what}"

    def _load_truth(self) -> TrueJoints | None:
        return None
