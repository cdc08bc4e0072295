"""Check of the extrinsics while running: do all cameras see the person at the same position?

A camera that was bumped, or a rig file of other cameras, must not spoil poses silently.
"""

from __future__ import annotations

import collections
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import SIDED
from depthmocap.geometry import largest_group
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.text import camera_list

#: Only the joints in the middle are compared: a mirrored view does not change them.
_MIDDLE = ~SIDED
#: A view's joint counts if its expected error is below this (metres).
EXPECTED_ERROR_M = 0.15
#: A view counts with at least this many such joints.
FEWEST_JOINTS = 3
#: Median distance (metres) from which cameras are misplaced: correctly calibrated ones have less than 0.02.
MISPLACED_M = 0.1
#: Number of frame sets that are judged together.
SETS = 150
#: Fewest frame sets for a judgement.
FEWEST_SETS = 10
#: A camera that sees the person in a smaller share of its frame sets is reported.
LEAST_SHARE = 0.05


class ExtrinsicsCheck:
    """Compares the middle joints that the cameras estimate separately, over many frame sets."""

    def __init__(self) -> None:
        # Distances (metres) by camera, from sets where at least three see the person, and by pair, where only two do.
        self._distances: collections.defaultdict[tuple[str, ...], list[float]] = collections.defaultdict(list)
        self._sets = 0
        self._delivered: collections.Counter[str] = collections.Counter()
        self._observed: collections.Counter[str] = collections.Counter()
        self._medians: collections.defaultdict[str, list[float]] = collections.defaultdict(list)
        #: Distances (metres) of the sets by pair, of all cameras that see the person.
        self._pairs: collections.defaultdict[tuple[str, str], list[float]] = collections.defaultdict(list)

    def __call__(self, cloud: LabelledCloud) -> list[str]:
        """Add the cloud of a frame set; after every ``SETS`` of them, the problems found, one line each."""
        views = {
            camera.name: np.where(joints[_MIDDLE, 3:] < EXPECTED_ERROR_M, joints[_MIDDLE, :3], np.nan)
            for camera, joints in zip(cloud.cameras, cloud.joints, strict=False)
            if joints is not None
        }
        estimates = {
            name: positions for name, positions in views.items() if np.isfinite(positions[:, 0]).sum() >= FEWEST_JOINTS
        }
        if not estimates:
            return []
        self._sets += 1
        self._delivered.update(views.keys())
        self._observed.update(estimates.keys())
        if len(estimates) > 1:
            names = tuple(sorted(estimates))  # one key for a pair, in whatever order its frames came
            distances = _distances_to_median(np.stack([estimates[name] for name in names]))
            if len(names) == 2:
                self._distances[names].append(2 * distances[0])
            else:
                for name, distance in zip(names, distances, strict=True):
                    self._distances[(name,)].append(distance)
                for a, b in itertools.combinations(names, 2):
                    apart = np.linalg.norm(estimates[a] - estimates[b], axis=1)
                    if np.isfinite(apart).any():
                        self._pairs[a, b].append(float(_known_median(apart)))
        return self.finish() if self._sets >= SETS else []

    def finish(self) -> list[str]:
        """The problems of the frame sets since the last judgement, one line each."""
        if not self._sets:
            return []
        problems: list[str] = []
        misplaced: list[str] = []
        judged = {names: values for names, values in self._distances.items() if len(values) >= FEWEST_SETS}
        # Two cameras cannot show which of them is misplaced; three can.
        if any(len(names) == 1 for names in judged):
            judged = {names: values for names, values in judged.items() if len(names) == 1}
        for names, values in judged.items():
            median_m = float(np.median(values))
            for name in names:
                self._medians[name].append(median_m)
            if median_m > MISPLACED_M and len(names) == 2:
                problems.append(_pair_message(names))
            elif median_m > MISPLACED_M:
                misplaced += names
        if misplaced:
            misplaced = self._disagree(list(dict.fromkeys(name for names in judged for name in names))) or misplaced
        problems += [_misplaced_message(misplaced)] if misplaced else []
        blind = [
            name
            for name, count in self._delivered.items()
            if count >= FEWEST_SETS and self._observed[name] < LEAST_SHARE * count
        ]
        problems += [_blind_message(blind)] if blind else []
        self._distances.clear()
        self._pairs.clear()
        self._sets = 0
        # Old counts fade. Otherwise a camera that turns away after an hour would be reported an hour later.
        for counts in (self._delivered, self._observed):
            for name in counts:
                counts[name] //= 2
        return problems

    def _disagree(self, names: Sequence[str]) -> list[str]:
        """The cameras that disagree with those that agree with each other; none where none agree. The median over all
        cameras does not tell them: one that is far off moves it."""
        agree = {
            pair
            for pair, values in self._pairs.items()
            if len(values) >= FEWEST_SETS and float(np.median(values)) < MISPLACED_M
        }
        group = largest_group(names, agree)
        return [name for name in names if name not in group] if len(group) > 1 else []

    def distances_m(self) -> dict[str, float]:
        """Median distance (metres) of each camera's joints from the median of all cameras; of two cameras, between
        them.

        Cameras that cannot be compared are left out.
        """
        return {name: float(np.median(values)) for name, values in self._medians.items()}


def _distances_to_median(positions: Float[ndarray, "views joints 3"]) -> Float[ndarray, "views"]:
    """Median distance of each view's joints from the median over the views (metres)."""
    known = np.isfinite(positions[..., 0])
    observed = known.any(0)  # a joint without any view has no median
    positions, known = positions[:, observed], known[:, observed]
    distances = np.linalg.norm(positions - _known_median(positions), axis=-1)
    return _known_median(np.where(known, distances, np.nan).T)


def _known_median(values: Float[ndarray, "n *shape"]) -> Float[ndarray, "*shape"]:
    """Median along the first axis of the values that are not NaN, NaN where all are. ``np.nanmedian`` of so few takes
    many times as long, and this is done with every set."""
    ordered = np.sort(values, axis=0)  # NaN last
    count = np.count_nonzero(~np.isnan(ordered), axis=0)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(ordered) - 1)
    middle = [np.take_along_axis(ordered, place[None], 0)[0] for place in (low, high)]
    return np.asarray((middle[0] + middle[1]) / 2)


_CALIBRATE = "calibrate: depthmocap calibrate RECORDING --out rig.json"
_LIMIT = f"more than {100 * MISPLACED_M:.0f} cm"


def _pair_message(names: tuple[str, ...]) -> str:
    return (
        f"{camera_list(names)} see the person {_LIMIT} apart: they stand elsewhere than the rig says, or their times "
        f"do not fit; {_CALIBRATE}"
    )


def _misplaced_message(names: list[str]) -> str:
    what = f"the person {_LIMIT} from where the others do"
    if len(names) > 1:
        why = "they stand elsewhere than the rig says, or their times are off"
        return f"{camera_list(names)} each see {what}: {why}; {_CALIBRATE}"
    return f"{camera_list(names)} sees {what}: it stands elsewhere than the rig says, or its time is off; {_CALIBRATE}"


def _blind_message(names: list[str]) -> str:
    what = "next to nothing of the person whom others see"
    if len(names) > 1:
        why = "if they look at them, they stand elsewhere than the rig says"
        return f"{camera_list(names)} see {what}: {why}; {_CALIBRATE}"
    return f"{camera_list(names)} sees {what}: if it looks at them, it stands elsewhere than the rig says; {_CALIBRATE}"
