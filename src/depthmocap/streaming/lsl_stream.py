"""``lsl://NAME``: joints for Lab Streaming Layer, by pylsl, and a second stream NAME-markers.

The channels of NAME, of type MoCap, are the columns of pose.csv: ``Head_x``, ``Head_y``, ``Head_z`` (metres, the rig's
world), ``Head_confidence``, and so on; NaN where unobserved. Where several people are followed, each has a place with
such channels, ``P1_Head_x``, and ``P1_number`` tells who has it; somebody keeps a place while in view. A sample's time
is that of the exposure on LSL's clock; the rate is irregular, for a set may be left out.

Lab Streaming Layer opens ports on all interfaces of this machine and is found by broadcasts, as its configuration file
says; this module has no say in that.
"""

from __future__ import annotations

import platform
import time
from typing import Any

import numpy as np

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.version import __version__
from depthmocap.errors import InputError, missing_extra
from depthmocap.streaming.stream_protocol import Marker, Places, Sample, Stream, StreamSetup

#: Channels of a joint: their names in pose.csv, and type and unit as Lab Streaming Layer's users name them.
_FIELDS = (
    ("x", "PositionX", "meters"), ("y", "PositionY", "meters"), ("z", "PositionZ", "meters"),
    ("confidence", "Confidence", "normalized"),
)  # fmt: skip
#: Samples that wait for a slow receiver, in hundreds.
_BUFFERED = 20


class LslStream(Stream):
    """An outlet of joints, and one of markers."""

    def __init__(self, name: str) -> None:
        """Raises InputError when pylsl is not installed, or finds no library of Lab Streaming Layer."""
        try:
            import pylsl
        except ModuleNotFoundError:
            raise missing_extra("pylsl", "stream") from None
        except (OSError, RuntimeError):
            raise InputError("pylsl finds no liblsl: its documentation tells how to install that") from None
        self._lsl: Any = pylsl
        self._name = name
        self._joints: Any = None
        self._markers: Any = None
        self._lsl_minus_monotonic_s = 0.0
        self._places = Places(0)

    def start(self, setup: StreamSetup) -> None:
        """See :class:`Stream`."""
        self._places = Places(setup.people)
        self._lsl_minus_monotonic_s = self._lsl.local_clock() - time.monotonic()
        channels = [
            channel
            for place in range(setup.people)
            for channel in _channels(f"P{place + 1}" if setup.people > 1 else "")
        ]
        info = self._info(self._name, "MoCap", len(channels), self._lsl.cf_float32)
        described = info.desc().append_child("channels")
        for channel in channels:
            node = described.append_child("channel")
            for key, value in channel.items():
                node.append_child_value(key, value)
        made_by = info.desc().append_child("acquisition")
        made_by.append_child_value("manufacturer", "depthmocap").append_child_value("model", __version__)
        info.desc().append_child("setup").append_child_value("up", setup.rig.up)
        self._joints = self._lsl.StreamOutlet(info, max_buffered=_BUFFERED)
        markers = self._info(f"{self._name}-markers", "Markers", 1, self._lsl.cf_string)
        self._markers = self._lsl.StreamOutlet(markers, max_buffered=_BUFFERED)
        setup.tell(f"Lab Streaming Layer has the streams {self._name} and {self._name}-markers, on all interfaces")

    def _info(self, name: str, kind: str, channels: int, form: int) -> Any:
        identity = f"depthmocap {platform.node()} {name}"  # by which a receiver finds it again after a restart
        return self._lsl.StreamInfo(name, kind, channels, self._lsl.IRREGULAR_RATE, form, identity)

    def send(self, sample: Sample) -> None:
        """See :class:`Stream`."""
        places = self._places.take(sample.people)
        values = np.full((len(places), len(JOINTS), len(_FIELDS)), np.nan, np.float32)
        for row, number in zip(values, places, strict=True):
            if number:
                row[:, :3], row[:, 3] = sample.people[number].joints, sample.people[number].confidence
        rows = values.reshape(len(places), -1)
        if len(places) > 1:
            rows = np.hstack([np.array(places, np.float32)[:, None], rows])
        self._joints.push_sample(rows.ravel().tolist(), self._time_s(sample.monotonic_ns))

    def mark(self, marker: Marker) -> None:
        """See :class:`Stream`."""
        self._markers.push_sample([marker.text], self._time_s(marker.monotonic_ns))

    def _time_s(self, monotonic_ns: int) -> float:
        return monotonic_ns * 1e-9 + self._lsl_minus_monotonic_s

    def close(self) -> None:
        """See :class:`Stream`."""
        self._joints = self._markers = None


def _channels(place: str) -> list[dict[str, str]]:
    """What Lab Streaming Layer is told of the channels of a place, or of the only one (``""``)."""
    prefix = f"{place}_" if place else ""
    number = [{"label": f"{prefix}number", "type": "Number", "unit": "none", "object": place}] if place else []
    return number + [
        {
            "label": f"{prefix}{joint}_{field}", "marker": joint, "type": kind, "unit": unit,
            **({"object": place} if place else {}),
        }
        for joint in JOINTS
        for field, kind, unit in _FIELDS
    ]  # fmt: skip
