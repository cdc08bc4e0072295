"""Whether cameras see the person in one place: a camera that was bumped, or a rig that is not theirs, must not spoil
poses in silence."""

from __future__ import annotations

import collections

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import SIDED
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.text import cameras

#: Joints of the middle do not move where a view takes left for right.
_MIDDLE = ~SIDED
#: Views tell of joints only where they expect less error (metres), and only with so many of them.
SURE_M, FEWEST_JOINTS = 0.15, 3
#: Further apart (metres) than a view by itself is wrong: cameras that stand right have less than 2 cm in the median.
APART_M = 0.1
#: Sets that are judged together, and the fewest that are.
SETS, FEWEST_SETS = 150, 10
#: A camera that sees the person in a smaller share of the sets sees next to nothing of them.
SELDOM = 0.05


class Agreement:
    """Compares where the cameras, each by itself, take the middle of the body to be, set after set."""

    def __init__(self) -> None:
        # Distances by camera, where at least three see the person, and by pair, where only two do.
        self._apart: collections.defaultdict[tuple[str, ...], list[float]] = collections.defaultdict(list)
        self._sets = 0
        self._delivered: collections.Counter[str] = collections.Counter()
        self._saw: collections.Counter[str] = collections.Counter()
        self._medians: collections.defaultdict[str, list[float]] = collections.defaultdict(list)

    def __call__(self, cloud: LabelledCloud) -> list[str]:
        """Add the cloud of a set; whenever enough are together, what is wrong with the cameras, one line each."""
        views = {
            camera.name: np.where(own[_MIDDLE, 3:] < SURE_M, own[_MIDDLE, :3], np.nan)
            for camera, own in zip(cloud.cameras, cloud.joints, strict=False)
            if own is not None
        }
        seeing = {name: places for name, places in views.items() if np.isfinite(places[:, 0]).sum() >= FEWEST_JOINTS}
        if not seeing:
            return []
        self._sets += 1
        self._delivered.update(views.keys())
        self._saw.update(seeing.keys())
        if len(seeing) > 1:
            names = tuple(sorted(seeing))  # whichever frame came first, a pair is one pair
            distances = _from_the_middle(np.stack([seeing[name] for name in names]))
            if len(names) == 2:
                self._apart[names].append(2 * distances[0])
            else:
                for name, distance in zip(names, distances, strict=True):
                    self._apart[(name,)].append(distance)
        return self.finish() if self._sets >= SETS else []

    def finish(self) -> list[str]:
        """What is wrong with the cameras by the sets since it was last told."""
        if not self._sets:
            return []
        found: list[str] = []
        alone: list[str] = []
        enough = {names: values for names, values in self._apart.items() if len(values) >= FEWEST_SETS}
        # Of two cameras nobody can tell which one is wrong, and three that are together for long can.
        if any(len(names) == 1 for names in enough):
            enough = {names: values for names, values in enough.items() if len(names) == 1}
        for names, values in enough.items():
            median_m = float(np.median(values))
            for name in names:
                self._medians[name].append(median_m)
            if median_m > APART_M and len(names) == 2:
                found.append(_apart(names))
            elif median_m > APART_M:
                alone += names
        found += [_off(alone)] if alone else []
        seldom = [
            name for name, count in self._delivered.items() if count >= FEWEST_SETS and self._saw[name] < SELDOM * count
        ]
        found += [_seldom(seldom)] if seldom else []
        self._apart.clear()
        self._sets = 0
        # Of what was seen long ago ever less counts, or a camera that turns away would be told of after as long a time.
        for counts in (self._delivered, self._saw):
            for name in counts:
                counts[name] //= 2
        return found

    def apart_m(self) -> dict[str, float]:
        """How far from where the others see the person each camera does, in the median (metres); between two cameras
        their distance. Without those that cannot be compared."""
        return {name: float(np.median(values)) for name, values in self._medians.items()}


def _from_the_middle(places: Float[ndarray, "views joints 3"]) -> Float[ndarray, "views"]:
    known = np.isfinite(places[..., 0])
    both = known.any(0)  # a joint that no view tells has no middle
    places, known = places[:, both], known[:, both]
    distances = np.linalg.norm(places - np.nanmedian(places, 0), axis=-1)
    return np.array([np.median(own[told]) for own, told in zip(distances, known, strict=True)])


_CALIBRATE = "calibrate: depthmocap calibrate RECORDING --out rig.json"


_LIMIT = f"more than {100 * APART_M:.0f} cm"


def _apart(names: tuple[str, ...]) -> str:
    return (
        f"{cameras(names)} see the person {_LIMIT} apart: they stand elsewhere than the rig says, or their times do "
        f"not fit; {_CALIBRATE}"
    )


def _off(names: list[str]) -> str:
    what = f"the person {_LIMIT} from where the others do"
    if len(names) > 1:
        why = "they stand elsewhere than the rig says, or their times are off"
        return f"{cameras(names)} each see {what}: {why}; {_CALIBRATE}"
    return f"{cameras(names)} sees {what}: it stands elsewhere than the rig says, or its time is off; {_CALIBRATE}"


def _seldom(names: list[str]) -> str:
    what = "next to nothing of the person whom others see"
    if len(names) > 1:
        why = "if they look at them, they stand elsewhere than the rig says"
        return f"{cameras(names)} see {what}: {why}; {_CALIBRATE}"
    return f"{cameras(names)} sees {what}: if it looks at them, it stands elsewhere than the rig says; {_CALIBRATE}"
