"""What ``evaluate people`` counts, of squares in one picture and a segmenter that numbers them by a list."""

import numpy as np
import pytest

from depthmocap.evaluate.people_protocol import TrackingScore
from depthmocap.evaluate.scenario_scene import SceneFrame
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera
from depthmocap.segment.people_segmenter import PeopleSegmenter, PersonMasks

CAMERA = DepthCamera("cam0", 8, 8, 4.0, 4.0, 3.5, 3.5)
NOBODY = np.zeros((8, 8), np.bool_)


def square(person: int) -> np.ndarray:
    mask = NOBODY.copy()
    mask[4 * person : 4 * person + 4, :4] = True
    return mask


class ByList(PeopleSegmenter):
    """Gives everybody in view the number that is listed for them."""

    def __init__(self, numbers: list[tuple[int, ...]]) -> None:
        self.numbers, self.index = numbers, 0
        super().__init__({})

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        numbers = self.numbers[min(self.index, len(self.numbers) - 1)]
        self.index += 1
        return tuple(PersonMasks(number, (square(k),)) for k, number in enumerate(numbers) if number)

    def reset(self) -> None:
        super().reset()
        self.index = 0


@pytest.mark.parametrize(
    ("returns", "outcome"), [((1, 2), (2, 0, 0)), ((1, 3), (1, 1, 0)), ((2, 1), (0, 0, 2)), ((2, 3), (0, 1, 1))]
)
def test_returns_count_by_the_number_of_the_track(returns, outcome):
    score = TrackingScore()
    numbers = [(1, 2)] * 3 + [(0, 0)] * 3 + [returns] * 3
    score.start_scene(ByList(numbers), 2)
    for i, listed in enumerate(numbers):
        masks = tuple((square(k) if number else NOBODY,) for k, number in enumerate(listed))
        frames = FrameSet(i * 10**9, (View(CAMERA, np.ones((8, 8), np.float32)),))
        score.add(SceneFrame(frames, masks, (np.full((18, 3), np.nan),) * 2))
    row = score.numbers()
    assert (row["returns_old"], row["returns_new"], row["returns_wrong"]) == outcome
    assert row["switches"] == sum(number != old for number, old in zip(returns, (1, 2), strict=True))
    assert (row["found_share"], row["arrivals"], row["ghost_sets"]) == (1.0, 4, 0)
