"""Clusters of votes for the centres of people: one for each person."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.kernels.people_votes import assign_votes, densest_vote
from depthmocap.segment.tracking_rules import CLUSTERING


@dataclasses.dataclass(frozen=True, eq=False)
class Votes:
    """Samples of all cameras that show people.

    Attributes:
        places: what each votes for: the centre of its person in the world (metres).
        points: where each is (metres).
        areas_m2: its surface.
        certainties: the network's probability that it shows a person.
        before: whether it is where the scene was seen empty.
    """

    places: Float[ndarray, "n 3"]
    points: Float[ndarray, "n 3"]
    areas_m2: Float[ndarray, " n"]
    certainties: Float[ndarray, " n"]
    before: Bool[ndarray, " n"]


def cluster_votes(
    votes: Votes, centres: Float[ndarray, "k 3"]
) -> tuple[Int[ndarray, " n"], Float[ndarray, "m 4"], Float[ndarray, "m 3"]]:
    """The owner of each vote (-1 for none), the sums of each owner (m², m² · place), and all centres: the predicted
    ones, then new ones."""
    places, areas = votes.places, votes.areas_m2
    owners = np.full(len(places), -1)
    sums = np.zeros((len(centres), 4))
    for _ in range(2 if len(centres) else 0):
        assign_votes(places, areas, centres, CLUSTERING.reach_m, owners, sums)
        moved = sums[:, 1:] / np.maximum(sums[:, :1], 1e-9)
        centres = np.where(sums[:, :1] > CLUSTERING.seen_m2, moved, centres).astype(np.float32)
    # Votes are the same for all samples of a cell; what is left may be somebody new.
    left = owners.copy()
    for _ in range(CLUSTERING.new_centres):
        centre = np.zeros(3)
        area = densest_vote(places, areas, left, CLUSTERING.places, CLUSTERING.new_reach_m, centre)
        if area < CLUSTERING.new_m2:
            break
        near = (np.linalg.norm(places - centre, axis=1) < CLUSTERING.new_reach_m) & (left < 0)
        if not near.any():
            break
        distances = np.linalg.norm(centres - centre, axis=1)
        nearest = int(distances.argmin()) if len(centres) else -1
        limb = nearest >= 0 and (
            distances[nearest] < CLUSTERING.apart_m
            or (
                distances[nearest] < CLUSTERING.limb_m
                and (area < CLUSTERING.limb_m2 or are_one_heap(votes, centres[nearest], centre))
            )
        )
        if limb:
            left[near] = nearest
        else:
            centres = np.concatenate([centres, centre[None].astype(np.float32)])
            left[near] = len(centres) - 1
    if not len(centres):
        return owners, np.zeros((0, 4)), centres
    sums = np.zeros((len(centres), 4))
    assign_votes(places, areas, centres, CLUSTERING.reach_m, owners, sums)
    # Few votes that are farther off are for limbs.
    far = np.empty(len(places), np.int64)
    assign_votes(places, areas, centres, CLUSTERING.limb_m, far, np.empty_like(sums))
    owners = np.where(owners < 0, np.where(left >= 0, left, far), owners)
    return owners, sums, centres


def are_one_heap(votes: Votes, one: Float[ndarray, "3"], other: Float[ndarray, "3"]) -> bool:
    """Whether the votes about two centres have no valley between them: those for one person, who lies perhaps."""
    line = other - one
    length = float(np.linalg.norm(line))
    along = (votes.places - one) @ (line / length)
    aside = np.linalg.norm(votes.places - one - along[:, None] * (line / length), axis=1)
    places = np.linspace(0, length, 9)
    kernel = np.abs(along[:, None] - places) < CLUSTERING.valley_m
    heights = (votes.areas_m2[:, None] * (kernel & (aside < CLUSTERING.reach_m)[:, None])).sum(0)
    return bool(heights[1:-1].min() > CLUSTERING.valley_share * min(heights[0], heights[-1]))
