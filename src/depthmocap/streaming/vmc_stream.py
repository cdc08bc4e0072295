"""``vmc://HOST:PORT``: the person who is followed as humanoid bones by the VMC protocol, over OSC (UDP).

    /VMC/Ext/Root/Pos   "root" and the identity
    /VMC/Ext/Bone/Pos   for each of ``BONES``: its name, local position (3), local rotation (quaternion x, y, z, w)
    /VMC/Ext/OK         loaded 1, calibrated 3, mode 0, and whether somebody is in view
    /VMC/Ext/T          seconds from the first exposure sent to this one

Positions are metres in Unity's axes: left-handed, Y up, the avatar facing +Z in its T pose, in which every rotation is
the identity, as in VRM 0. That is the Y-up world of BVH files, mirrored in x. The protocol is documented at
protocol.vmc.info.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.streaming.osc_stream import OscSender
from depthmocap.streaming.running_skeleton import PosedSkeleton, RunningSkeleton
from depthmocap.streaming.stream_protocol import Sample, Stream, StreamSetup

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


class VmcStream(Stream):
    """Sends bones to an avatar."""

    def __init__(self, host: str, port: int) -> None:
        """Raises InputError when python-osc is not installed, or the port cannot be one."""
        self._sender = OscSender(host, port)
        self._up, self._first_ns = "z", 0
        self._person: tuple[int, RunningSkeleton] | None = None

    def start(self, setup: StreamSetup) -> None:
        """See :class:`Stream`."""
        self._sender.connect()
        self._up, self._first_ns, self._person = setup.rig.up, 0, None

    def send(self, sample: Sample) -> None:
        """See :class:`Stream`."""
        self._first_ns = self._first_ns or sample.unix_ns
        messages: list[tuple[str, list[Any]]] = []
        for number, pose in list(sample.people.items())[:1]:
            if self._person is None or self._person[0] != number:
                self._person = number, RunningSkeleton(self._up)
            posed = self._person[1](pose)
            if posed is not None:
                messages.append(("/VMC/Ext/Root/Pos", ["root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
                bones = zip(BONES, unity_bones(posed).tolist(), strict=True)
                messages += [("/VMC/Ext/Bone/Pos", [name, *numbers]) for name, numbers in bones]
        # The last of a set, by which receivers know that it is whole.
        messages.append(("/VMC/Ext/OK", [1, _CALIBRATED, _NORMAL_MODE, int(bool(messages))]))
        messages.append(("/VMC/Ext/T", [(sample.unix_ns - self._first_ns) * 1e-9]))
        self._sender.send(messages)

    def close(self) -> None:
        """See :class:`Stream`."""
        self._sender.close()
