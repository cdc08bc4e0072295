"""Sets of distinct postures: a streaming cover in bounded memory, and farthest-point sampling."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.kernels.nearest_postures import grow_cover, pick_farthest
from depthmocap.synth.motion.mocap import without_heading
from depthmocap.synth.motion.postures import joint_positions

#: Growth of the radius of a full cover: the doubling algorithm of streaming k-centre in smaller steps.
_RADIUS_GROWTH = 1.2
#: Number of picks between two reports of progress.
_PROGRESS_STEP = 500
#: Largest number of postures in a block of neighbours.
_BLOCK_SIZE = 48


class Cover:
    """Postures with pairwise distances above ``radius_m`` (of the joint that differs most), each with a caller's tag.

    The radius grows when there are more than ``capacity`` postures.
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
        """Joint positions by which postures are compared (metres)."""
        return self._ends[: self.count]

    @property
    def tags(self) -> Int[ndarray, "n"]:
        return self._tags[: self.count]

    def add(self, postures: Float[ndarray, "n 20 3"], tags: Int[ndarray, "n"], limit: int | None = None) -> int:
        """Add the distinct ones of some postures, without their headings; returns their number.

        With a ``limit`` the cover holds at most that many postures and keeps its radius.
        """
        postures = without_heading(postures).astype(np.float32)
        ends = joint_positions(postures).astype(np.float32)
        before, start = self.count, 0
        while start < len(postures):
            is_kept = np.zeros(len(postures) - start, dtype=bool)
            limit_count = self.capacity if limit is None else min(limit, self.capacity)
            first = self.count
            self.count, processed = grow_cover(
                ends[start:], self.radius_m, self._ends, first, self._table, self._following, is_kept, limit_count
            )
            self._postures[first : self.count] = postures[start:][is_kept]
            self._tags[first : self.count] = tags[start:][is_kept]
            start += processed
            if start < len(postures):
                if limit is not None:
                    break
                self._grow_radius()
        return self.count - before

    def _grow_radius(self) -> None:
        """Grow the radius until a third of the capacity is free."""
        while self.count > self.capacity * 2 // 3:
            self.radius_m *= _RADIUS_GROWTH
            ends, is_kept = self.ends.copy(), np.zeros(self.count, dtype=bool)
            self._table.fill(-1)
            count, _ = grow_cover(
                ends, self.radius_m, self._ends, 0, self._table, self._following, is_kept, self.capacity
            )
            self._postures[:count] = self.postures[is_kept]
            self._tags[:count] = self.tags[is_kept]
            self.count = count


def farthest_points(
    ends: Float[ndarray, "n 20 3"],
    stages: list[tuple[Bool[ndarray, "n"], int]],
    progress: Callable[[int], object] = lambda picked: None,
) -> tuple[Int[ndarray, "k"], float]:
    """Greedy k-centre: repeatedly pick the posture farthest from all picked ones.

    Args:
        ends: joint positions.
        stages: one after another: candidates, and the number of picks at which the stage ends.
        progress: called repeatedly with the number of picks.

    Returns:
        Indices in the order of picking, and the distance of the next pick (metres), which bounds the distance of every
        candidate of the last stage from the picks; 0 when no candidate is left.
    """
    order, starts = _spatial_blocks(ends)
    points = ends[order]
    low, high = np.minimum.reduceat(points, starts[:-1]), np.maximum.reduceat(points, starts[:-1])
    nearest2 = np.full(len(points), np.inf, np.float32)
    picks = np.empty(max([0, *(target for _, target in stages)]), np.int64)
    count, left2 = 0, 0.0
    for allowed, target in stages:
        left2 = np.inf
        while count < target and left2 >= 0:
            step = min(count + _PROGRESS_STEP, target)
            count, left2 = pick_farthest(points, starts, low, high, allowed[order], nearest2, picks, count, step)
            progress(count)
    return order[picks[:count]], float(np.sqrt(max(left2, 0.0)))


def _spatial_blocks(ends: Float[ndarray, "n 20 3"]) -> tuple[Int[ndarray, "n"], Int[ndarray, "b"]]:
    """An order that groups neighbours in blocks, by halving at the widest coordinate, and the blocks' starts."""
    leaves: list[ndarray] = []
    stack = [np.arange(len(ends))]
    while stack:
        part = stack.pop()
        if len(part) <= _BLOCK_SIZE:
            leaves.append(part)
            continue
        flat = ends[part].reshape(len(part), -1)
        halves = np.argpartition(flat[:, np.ptp(flat, axis=0).argmax()], len(part) // 2)
        stack += [part[halves[: len(part) // 2]], part[halves[len(part) // 2 :]]]
    return np.concatenate(leaves), np.cumsum([0, *map(len, leaves)])
