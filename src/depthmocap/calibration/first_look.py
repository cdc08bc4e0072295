"""A first look at a few frames of each camera: in which depth unit and which way up its pictures show people.

Nobody is found in pictures whose depth unit is wrong by several times, and people on their side are found badly. The
body-part network is sure of its joints only where a body has a body's size and stands upright in the picture.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.picture_faults import COMMON_FACTORS, STATURE_PER_CHAIN, STATURES_M, chain_m
from depthmocap.classify.classifier import Classifier
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.recordings.recording import Recording
from depthmocap.segment.static_scene import PersonSegmenter

#: Number of frames of a camera that are looked at, spread over the recording.
_FRAMES = 9
#: Fewest of them that must show somebody.
_LEAST_FRAMES = 3
#: Joints are sure if half of them have an expected error below this share of the body's chain.
_SURE = 0.15
#: Least length of the body's axis in the picture: of somebody seen from above it does not tell what is up.
_LEAST_AXIS = 0.35
#: An adult's size (metres): of several units in which people are found, the one nearest to it is taken.
_ADULT_M = 1.65


@dataclasses.dataclass(frozen=True)
class FirstLook:
    """What a camera's pictures probably need before people can be found in them.

    Attributes:
        factor: on its depth; 1 wherever people are found as it is.
        quarters: anticlockwise quarter turns of the picture that bring people upright.
        stature_m: about how tall the person is then (metres); NaN where nobody was found.
    """

    factor: float = 1.0
    quarters: int = 0
    stature_m: float = float("nan")


def look_first(recording: Recording, segmenter: PersonSegmenter, classifier: Classifier) -> dict[str, FirstLook]:
    """The first look at each camera."""
    return {camera.name: _look(recording, camera, segmenter, classifier) for camera in recording.rig.cameras}


def _look(recording: Recording, camera: DepthCamera, segmenter: PersonSegmenter, classifier: Classifier) -> FirstLook:
    stamps = recording.stamps(camera.name)
    chosen = sorted({int(i) for i in np.linspace(0, max(len(stamps) - 1, 0), _FRAMES)})[: len(stamps)]
    camera = dataclasses.replace(camera, world_from_camera=np.eye(4))
    depths = []
    for i in chosen:
        try:
            depths.append(camera.to_metres(recording.raw(camera.name, stamps[i])))
        except InputError:
            continue
    sights: dict[float, _Sight] = {}
    for factor in (1.0, *COMMON_FACTORS):
        people = segmenter if factor == 1 else segmenter.scaled(camera.name, factor)
        views = [View(camera, depth_m * np.float32(factor)) for depth_m in depths]
        sight = _Sight.of([(view, people(view)) for view in views], classifier)
        if sight.sure and STATURES_M[0] < sight.stature_m < STATURES_M[1]:
            sights[factor] = sight
            if factor == 1:
                break
    if not sights:
        return FirstLook()
    factor = min(sights, key=lambda factor: abs(np.log(sights[factor].stature_m / _ADULT_M)))
    return FirstLook(factor, sights[factor].quarters(), sights[factor].stature_m)


@dataclasses.dataclass(frozen=True, eq=False)
class _Sight:
    """People in some frames of a camera, by the network."""

    track: JointTrack

    @classmethod
    def of(cls, views: Sequence[tuple[View, Bool[ndarray, "h w"]]], classifier: Classifier) -> _Sight:
        seen = [(view, mask) for view, mask in views if mask.any()]
        return cls(_track(seen, classifier))

    @property
    def sure(self) -> bool:
        """Whether there is somebody, and the network is sure of their joints."""
        return len(self.track.times_s) >= _LEAST_FRAMES and self.error < _SURE

    @property
    def error(self) -> float:
        """Median expected error of the joints, as a share of the body's chain."""
        return float(np.nanmedian(self.track.sigma_m)) / chain_m(self.track)

    @property
    def stature_m(self) -> float:
        return STATURE_PER_CHAIN * chain_m(self.track)

    def quarters(self) -> int:
        """Quarter turns that bring people upright; the classifier tells how they lie in the picture as it is."""
        joints = self.track.joints
        axes = joints[:, JOINT_INDEX["Neck"]] - joints[:, [JOINT_INDEX["LFoot"], JOINT_INDEX["RFoot"]]].mean(1)
        right, down, _ = np.nanmedian(axes / np.linalg.norm(axes, axis=1, keepdims=True), axis=0)
        if np.hypot(right, down) < _LEAST_AXIS:
            return 0
        return round(float(np.arctan2(right, -down)) / (np.pi / 2)) % 4


def _track(seen: Sequence[tuple[View, Bool[ndarray, "h w"]]], classifier: Classifier) -> JointTrack:
    poses = [joints_in(view, mask, classifier) for view, mask in seen]
    poses = [joints for joints in poses if np.isfinite(joints).all()]
    joints = np.stack(poses) if poses else np.empty((0, 18, 4))
    return JointTrack(np.arange(float(len(joints))), joints[..., :3], joints[..., 3])


def joints_in(
    view: View, mask: Bool[ndarray, "h w"], classifier: Classifier, quarters: int = 0
) -> Float[ndarray, "18 4"]:
    """The joints in a view of a camera at the origin, in its frame, from its picture turned by so many quarters."""
    if quarters:
        view = dataclasses.replace(view, mask=mask).turned(quarters)
        assert view.mask is not None
        mask = view.mask
    return classifier.label_views([view], [mask])[0].joints
