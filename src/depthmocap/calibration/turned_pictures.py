"""Pictures that are turned by 180° while their intrinsics are not, told by how cameras disagree about the same person.

Of a picture that is turned after it was taken, the principal point is on the other side of the middle. With the wrong
one, all that a camera sees is sheared, which no pose undoes: it fits the other cameras less well than with the right
one. The same holds of a picture that is on its side, with the intrinsics of one on the other side. Where the principal
point is near the picture's middle, there is nothing to tell, and little harm.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.picture_faults import PictureFault, chain_m, fit_similarity, of_adult
from depthmocap.geometry import DepthCamera

#: A picture is told to be turned if joints then fit better by this factor, in the mean of a camera's pairs,
_BETTER = 1.015
#: and by none of them worse than by this. Of right cameras, no wrong principal point fits better by more than 1.004.
_NO_WORSE = 0.995


def turned_camera(camera: DepthCamera) -> DepthCamera:
    """The camera with the intrinsics of the picture turned by 180°, and the pose that it has."""
    return dataclasses.replace(camera.turned(2), world_from_camera=camera.world_from_camera)


def as_turned(camera: DepthCamera, track: JointTrack) -> JointTrack:
    """The track of a camera as it is with the intrinsics of :func:`turned_camera`."""
    joints = track.joints.copy()
    joints[..., 0] += joints[..., 2] * (2 * camera.cx - camera.width + 1) / camera.fx
    joints[..., 1] += joints[..., 2] * (2 * camera.cy - camera.height + 1) / camera.fy
    return JointTrack(track.times_s, joints, track.sigma_m)


def find_turned_pictures(
    cameras: Sequence[DepthCamera],
    tracks: Sequence[JointTrack],
    faults: Sequence[PictureFault],
    rng: np.random.Generator,
) -> list[PictureFault]:
    """Pictures that are turned by 180° against their intrinsics.

    Args:
        tracks: each camera's joints in its own frame.
        faults: of other kinds; these cameras are not looked at before they are mended.
    """
    wrong = {name for fault in faults for name in fault.cameras}
    tried = [
        i for i, (camera, track) in enumerate(zip(cameras, tracks, strict=True))
        if camera.name not in wrong and len(track.times_s) > 1 and chain_m(track) > 0
    ]  # fmt: skip
    adults = {i: of_adult(tracks[i]) for i in tried}
    turned = {i: as_turned(cameras[i], adults[i]) for i in tried}
    ratios: dict[int, list[float]] = {i: [] for i in tried}
    of_both: list[float] = []
    for a, b in itertools.combinations(tried, 2):
        pairs = (adults[a], adults[b]), (turned[a], adults[b]), (adults[a], turned[b]), (turned[a], turned[b])
        is_now, *others = (fit_similarity(*pair, rng) for pair in pairs)
        if not is_now.score > 0 or not any(fit.reliable for fit in (is_now, *others)):
            continue
        by_a, by_b, by_both = (fit.score / is_now.score if fit.reliable else 0.0 for fit in others)
        ratios[a].append(by_a)
        ratios[b].append(by_b)
        of_both.append(by_both)
    gains = {i: float(np.mean(ratios[i])) for i in tried if _is_better(ratios[i])}
    if gains and len(tried) == 2:
        best, least = max(gains, key=gains.__getitem__), min(gains.values())
        if len(gains) == 2 and np.log(least) > np.log(gains[best]) / 2:
            text = " or ".join(turned_words(cameras[i]) for i in tried)
            return [PictureFault("turned", tuple(cameras[i].name for i in tried), f"either {text}", certain=False)]
        return [_fault(cameras[best])]
    if not gains and _is_better(of_both):
        gains = dict.fromkeys(tried, 0.0)
    return [_fault(cameras[i]) for i in gains]


def _is_better(ratios: Sequence[float]) -> bool:
    return bool(ratios) and float(np.mean(ratios)) > _BETTER and min(ratios) > _NO_WORSE


def _fault(camera: DepthCamera) -> PictureFault:
    return PictureFault("turned", (camera.name,), turned_words(camera))


def turned_words(camera: DepthCamera, with_pose: bool = False) -> str:
    """What is wrong with a camera's picture against the intrinsics, and the pose as well, with what would mend it."""
    right = camera.turned(2)
    against, pose = (
        ("its intrinsics and pose", ", and a pose turned likewise,") if with_pose else ("its intrinsics", "")
    )
    return (
        f"the picture of camera {camera.name!r} is turned by 180° against {against}: turn it back, or cx {right.cx:g} "
        f"and cy {right.cy:g}{pose} in rig.json would be right"
    )
