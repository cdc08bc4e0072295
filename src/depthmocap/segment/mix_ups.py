"""Who cannot be told apart: two who are so near to each other that their centres are one, or one of whom is hidden.

Nor somebody new from those who left and are as tall.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from depthmocap.segment.person_tracks import PersonTrack

#: From this distance of their centres on (metres) two are told apart for certain;
CLEAR_M = 0.45
#: at this distance (metres) not at all.
ONE_M = 0.2
#: Somebody hidden this near to another (metres) may be who is seen there.
HIDDEN_M = 0.5
#: The probability that a number is the other's, where nothing tells.
EVEN = 0.5


@dataclasses.dataclass(frozen=True)
class MixUp:
    """Numbers of those whom somebody may be mistaken for, and the probability of it."""

    others: tuple[int, ...] = ()
    doubt: float = 0.0


#: Of somebody who is nobody else.
CERTAIN = MixUp()


def find_mix_ups(tracks: Sequence[PersonTrack]) -> dict[int, MixUp]:
    """By number: who may be mistaken for whom in this set."""
    people = [track for track in tracks if track.number]
    mix_ups = {track.number: MixUp(track.perhaps) for track in people if track.perhaps}
    for one, other in itertools.combinations(people, 2):
        if not (one.area_m2 or other.area_m2):
            continue
        distance_m = float(np.linalg.norm(one.centre_m - other.centre_m))
        doubt = EVEN * float(np.clip((CLEAR_M - distance_m) / (CLEAR_M - ONE_M), 0, 1))
        if not (one.area_m2 and other.area_m2):
            doubt = EVEN if distance_m < HIDDEN_M else 0.0
        if doubt:
            for this, that in ((one, other), (other, one)):
                before = mix_ups.get(this.number, CERTAIN)
                mix_ups[this.number] = MixUp((*before.others, that.number), max(before.doubt, doubt))
    return mix_ups
