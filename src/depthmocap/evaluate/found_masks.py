"""Views with the masks that the network finds in place of the true ones."""

from __future__ import annotations

import dataclasses

import numpy as np

from depthmocap.frames import View
from depthmocap.segment.people_detector import PeopleDetector
from depthmocap.segment.person_by_network import people_at_once

#: So many people are told of at most.
_PEOPLE = 8


def with_found_masks(views: tuple[View, ...], detector: PeopleDetector) -> tuple[View, ...]:
    """The views with the masks of the one found who overlaps most with the true ones; empty masks where nobody is."""
    people = people_at_once(tuple(View(view.camera, view.depth_m) for view in views), detector, _PEOPLE)
    true = [np.zeros(view.depth_m.shape, np.bool_) if view.mask is None else view.mask for view in views]
    best, most = [np.zeros_like(mask) for mask in true], 0.0
    for person in people:
        pairs = list(zip(person.masks, true, strict=True))
        overlap = sum((a & b).sum() for a, b in pairs) / max(sum((a | b).sum() for a, b in pairs), 1)
        if overlap > most:
            best, most = list(person.masks), float(overlap)
    return tuple(dataclasses.replace(view, mask=mask) for view, mask in zip(views, best, strict=True))
