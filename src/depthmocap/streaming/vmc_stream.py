"""``vmc://HOST:PORT``: people as humanoid bones by the VMC protocol, over OSC (UDP). The protocol has one performer for
each port: where several people are followed, the second is sent to PORT + 1, and so on.

    /VMC/Ext/Root/Pos   "root" and the identity
    /VMC/Ext/Bone/Pos   for each of ``BONES``: its name, local position (3), local rotation (quaternion x, y, z, w)
    /VMC/Ext/OK         loaded 1, calibrated 3, mode 0, and whether somebody is in view
    /VMC/Ext/T          seconds from the first exposure sent to this one

Positions are metres in Unity's axes: left-handed, Y up, the avatar facing +Z in its T pose, in which every rotation is
the identity, as in VRM 0. That is the Y-up world of BVH files, mirrored in x. The protocol is documented at
protocol.vmc.info.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.streaming.osc_stream import OscSender
from depthmocap.streaming.running_skeleton import LEARNT_S, PosedSkeleton, RunningSkeleton
from depthmocap.streaming.stream_protocol import Places, Sample, Stream, StreamSetup

#: Where along the way from the chest to the shoulder joint Unity's Shoulder, the collar bone, begins.
_COLLAR = 0.25
#: Of each bone the joints whose rotations it has, the joint whose offset it has, and the share of that. Avatars need
#: not have an UpperChest, so Chest turns in its place.
BONES: dict[str, tuple[tuple[str, ...], str, float]] = {
    "Hips": (("Hip",), "Hip", 1.0),
    "Spine": (("Spine",), "Spine", 1.0),
    "Chest": (("Spine1", "Spine2"), "Spine1", 1.0),
    "UpperChest": ((), "Spine2", 1.0),
    "Neck": (("Neck",), "Neck", 1.0),
    "Head": (("Head",), "Head", 1.0),
}
for _side in ("Left", "Right"):
    BONES |= {
        f"{_side}Shoulder": ((), f"{_side[0]}Shoulder", _COLLAR),
        f"{_side}UpperArm": ((f"{_side[0]}Shoulder",), f"{_side[0]}Shoulder", 1 - _COLLAR),
        f"{_side}LowerArm": ((f"{_side[0]}Elbow",), f"{_side[0]}Elbow", 1.0),
        f"{_side}Hand": ((f"{_side[0]}Hand",), f"{_side[0]}Hand", 1.0),
        f"{_side}UpperLeg": ((f"{_side[0]}Hip",), f"{_side[0]}Hip", 1.0),
        f"{_side}LowerLeg": ((f"{_side[0]}Knee",), f"{_side[0]}Knee", 1.0),
        f"{_side}Foot": ((f"{_side[0]}Foot",), f"{_side[0]}Foot", 1.0),
    }
_MIRROR = np.array([-1.0, 1.0, 1.0])
#: The same of a quaternion: the axis is mirrored, and the angle turns round.
_MIRROR_QUATERNION = np.array([1.0, -1.0, -1.0, 1.0])
_CALIBRATED, _NORMAL_MODE = 3, 0
#: A smaller change of a bone's length is not told (m).
_TOLD_M = 0.005


def unity_bones(posed: PosedSkeleton) -> Float[ndarray, "20 7"]:
    """Local position and rotation (quaternion x, y, z, w) of ``BONES``, in Unity's axes."""
    positions, rotations = np.empty((len(BONES), 3)), np.empty((len(BONES), 3, 3))
    for i, (turning, joint, share) in enumerate(BONES.values()):
        positions[i] = posed.root if joint == "Hip" else share * posed.offsets[JOINT_INDEX[joint]]
        rotation = np.eye(3)
        for name in turning:
            rotation = rotation @ posed.local[JOINT_INDEX[name]]
        rotations[i] = rotation
    quaternions = Rotation.from_matrix(rotations).as_quat(canonical=True)
    return np.hstack([positions * _MIRROR, quaternions * _MIRROR_QUATERNION])


class _Performer:
    """Whoever has one place, and the receiver of that."""

    def __init__(self, host: str, port: int, up: str, note: Callable[[str], None]) -> None:
        self._up, self._person, self._note = up, 0, note
        self._skeleton = RunningSkeleton(up)
        self._sender = OscSender(host, port)
        self._sender.connect()

    def send(self, number: int, sample: Sample, seconds: float) -> None:
        """Send the bones of a person, or for 0 that nobody is there."""
        if number not in (0, self._person):
            self._tell_of_lengths()
            self._person, self._skeleton = number, RunningSkeleton(self._up)
        messages: list[tuple[str, list[Any]]] = []
        posed = self._skeleton(sample.people[number]) if number else None
        if posed is not None:
            messages.append(("/VMC/Ext/Root/Pos", ["root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
            bones = zip(BONES, unity_bones(posed).tolist(), strict=True)
            messages += [("/VMC/Ext/Bone/Pos", [name, *numbers]) for name, numbers in bones]
        # The last of a set, by which receivers know that it is whole.
        messages.append(("/VMC/Ext/OK", [1, _CALIBRATED, _NORMAL_MODE, int(bool(messages))]))
        messages.append(("/VMC/Ext/T", [seconds]))
        self._sender.send(messages)

    def _tell_of_lengths(self) -> None:
        """Lengths that an avatar saw change belong into the summary."""
        change_m, self._skeleton.largest_change_m = self._skeleton.largest_change_m, 0.0
        if change_m >= _TOLD_M:
            self._note(
                f"vmc: bone lengths of person {self._person} changed by up to {100 * change_m:.0f} cm at once while "
                f"they were learnt (the first {LEARNT_S:g} s)"
            )

    def close(self) -> None:
        """Close the socket."""
        self._tell_of_lengths()
        self._sender.close()


class VmcStream(Stream):
    """Sends bones to avatars."""

    def __init__(self, host: str, port: int) -> None:
        """Raises InputError when python-osc is not installed, or the port cannot be one."""
        OscSender(host, port)
        self._host, self._port, self._first_ns = host, port, 0
        self._places = Places(0)
        self._performers: list[_Performer] = []

    def start(self, setup: StreamSetup) -> None:
        """See :class:`Stream`.

        Raises:
            InputError: when there is no such host, or there are fewer ports than people.
        """
        last = self._port + setup.people - 1
        if last > 65535:
            raise InputError(f"{setup.people} people take the ports from {self._port} to {last}: choose a lower one")
        self._first_ns, self._places, self._performers = 0, Places(setup.people), []
        try:
            for port in range(self._port, last + 1):
                self._performers.append(_Performer(self._host, port, setup.rig.up, setup.note))
        except InputError:
            self.close()
            raise
        if setup.people > 1:
            setup.tell(f"{setup.people} people go to the ports {self._port} to {last}, one to each")

    def send(self, sample: Sample) -> None:
        """See :class:`Stream`."""
        self._first_ns = self._first_ns or sample.unix_ns
        seconds = (sample.unix_ns - self._first_ns) * 1e-9
        for performer, number in zip(self._performers, self._places.take(sample.people), strict=True):
            performer.send(number, sample, seconds)

    def close(self) -> None:
        """See :class:`Stream`."""
        for performer in self._performers:
            performer.close()
