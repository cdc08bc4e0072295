"""A growing set of distinct postures in bounded memory, and the most dissimilar of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.kernels.nearest_postures import grow_cover, pick_farthest
from depthmocap.synth.motion.mocap import without_heading
from depthmocap.synth.motion.postures import joint_positions

#: When the cover is full its radius grows by this: the doubling algorithm of streaming k-centre in smaller steps.
_GROWTH = 1.2
#: Picks between two reports of progress, and postures in a block of neighbours.
_BLOCK, _LEAF = 500, 48


class Cover:
    """Postures no two of which are within ``radius_m`` (the joint that differs most), each with a tag of the caller's.

    The radius grows when there are more than ``capacity``.
    """

    def __init__(self, radius_m: float, capacity: int) -> None:
        self.radius_m, self.capacity = radius_m, capacity
        self.count = 0
        self._ends = np.empty((capacity, 20, 3), np.float32)
        self._postures = np.empty((capacity, 20, 3), np.float32)
        self._tags = np.empty(capacity, np.int64)
        self._following = np.empty(capacity, np.int32)
        self._table = np.full(1 << int(np.ceil(np.log2(2 * capacity))), -1, np.int32)

    @property
    def postures(self) -> Float[ndarray, "n 20 3"]:
        return self._postures[: self.count]

    @property
    def ends(self) -> Float[ndarray, "n 20 3"]:
        """Joint positions by which postures are compared."""
        return self._ends[: self.count]

    @property
    def tags(self) -> Int[ndarray, "n"]:
        return self._tags[: self.count]

    def add(self, postures: Float[ndarray, "n 20 3"], tags: Int[ndarray, "n"], limit: int | None = None) -> int:
        """Add the distinct ones of some postures, without their headings; returns how many were added.

        With a ``limit`` at most that many are held, and the radius stays."""
        postures = without_heading(postures).astype(np.float32)
        ends = joint_positions(postures).astype(np.float32)
        before, start = self.count, 0
        while start < len(postures):
            is_kept = np.zeros(len(postures) - start, dtype=bool)
            most = self.capacity if limit is None else min(limit, self.capacity)
            first = self.count
            self.count, read = grow_cover(
                ends[start:], self.radius_m, self._ends, first, self._table, self._following, is_kept, most
            )
            self._postures[first : self.count] = postures[start:][is_kept]
            self._tags[first : self.count] = tags[start:][is_kept]
            start += read
            if start < len(postures):
                if limit is not None:
                    break
                self._widen()
        return self.count - before

    def _widen(self) -> None:
        """Grow the radius until a third of the room is free again."""
        while self.count > self.capacity * 2 // 3:
            self.radius_m *= _GROWTH
            ends, kept = self.ends.copy(), np.zeros(self.count, dtype=bool)
            self._table.fill(-1)
            count, _ = grow_cover(ends, self.radius_m, self._ends, 0, self._table, self._following, kept, self.capacity)
            self._postures[:count] = self.postures[kept]
            self._tags[:count] = self.tags[kept]
            self.count = count


def farthest_points(
    ends: Float[ndarray, "n 20 3"],
    stages: list[tuple[Bool[ndarray, "n"], int]],
    progress: Callable[[int], object] = lambda picked: None,
) -> tuple[Int[ndarray, "k"], float]:
    """Greedy k-centre: the posture furthest from all that are picked, again and again.

    Args:
        ends: joint positions.
        stages: which postures may be picked, and the number of picks at which the stage ends; one after another.
        progress: called with the number of selected postures now and then.

    Returns:
        Indices in the order of picking, and the distance of the posture that would have been next (metres): every
        posture of the last stage is at least this near to a pick; 0 when none is left.
    """
    order, starts = _blocks(ends)
    points = ends[order]
    low, high = np.minimum.reduceat(points, starts[:-1]), np.maximum.reduceat(points, starts[:-1])
    nearest2 = np.full(len(points), np.inf, np.float32)
    picks = np.empty(max([0, *(target for _, target in stages)]), np.int64)
    count, left2 = 0, 0.0
    for allowed, target in stages:
        left2 = np.inf
        while count < target and left2 >= 0:
            step = min(count + _BLOCK, target)
            count, left2 = pick_farthest(points, starts, low, high, allowed[order], nearest2, picks, count, step)
            progress(count)
    return order[picks[:count]], float(np.sqrt(max(left2, 0.0)))


def _blocks(ends: Float[ndarray, "n 20 3"]) -> tuple[Int[ndarray, "n"], Int[ndarray, "b"]]:
    """An order in which neighbours lie together, halved at the widest coordinate down to blocks, and their starts."""
    leaves: list[ndarray] = []
    stack = [np.arange(len(ends))]
    while stack:
        part = stack.pop()
        if len(part) <= _LEAF:
            leaves.append(part)
            continue
        flat = ends[part].reshape(len(part), -1)
        halves = np.argpartition(flat[:, np.ptp(flat, axis=0).argmax()], len(part) // 2)
        stack += [part[halves[: len(part) // 2]], part[halves[len(part) // 2 :]]]
    return np.concatenate(leaves), np.cumsum([0, *map(len, leaves)])
