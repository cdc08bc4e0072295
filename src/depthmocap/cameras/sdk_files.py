"""Which SDK recorded a file: told by what is in it, because two makers use one name ending."""

from __future__ import annotations

from pathlib import Path

from depthmocap.core.reading.input_files import open_file

#: Topics by which the makers' files are known: as the RealSense SDK writes them, and Orbbec's.
_TOPICS = {"realsense": (b"/device_0/sensor_", b"/device_0/info"), "orbbec": (b"/cam/sensor_", b"/cam/streamProfile")}
#: Name endings of files with topics: ROS 1 bags, ROS 2 bags, and Orbbec's newer form.
TOPIC_FILES = (".bag", ".db3", ".mcap")
#: Bags list their topics at the beginning, of which so much is looked at (bytes),
_HEAD = 1 << 20
#: or behind all frames, of which so much is looked at (bytes).
_TAIL = 1 << 23


def sdk_of(path: Path) -> str:
    """The kind of camera whose SDK recorded a file: "openni", "realsense" or "orbbec"; "" where it is another's.

    Raises:
        InputError: when it is no file, or cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".oni":
        return "openni"
    if suffix not in TOPIC_FILES:
        return ""
    with open_file(path) as file:
        head = file.read(_HEAD)
        file.seek(max(file.seek(0, 2) - _TAIL, 0))
        content = head + file.read(_TAIL)
    return next((kind for kind, topics in _TOPICS.items() if any(topic in content for topic in topics)), "")
