"""Endpoint maps of all particles: tables of numbers of patches, which particles share until one of them writes.

Copying a map copies its table and counts one more holder per patch (GMapping's copy-on-write hierarchical grid).
Nothing is ray traced. Lengths here are in cells, "table units": cells from the lower left corner of the table.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.patch_pool import (
    CENTRE,
    COARSER,
    FAR,
    LOW,
    MEAN_BITS,
    MOST_HITS,
    NEAR_BITS,
    NONE,
    SHIFT,
    SIDE,
    PatchPool,
    own,
)

BLOCK = 16
"""cells; the table grows in steps of so many"""
MARGIN = 4
"""blocks of slack when it grows"""


class PatchMap:
    """The endpoint maps of n particles.

    table (n, height, width) int32: patch numbers, NONE where a particle has none; corner: cell (x, y) of its origin.
    """

    def __init__(self, particles: int, resolution_m: float) -> None:
        self.resolution_m = resolution_m
        self.corner = np.zeros(2, np.int64)
        self.table = np.full((particles, 0, 0), NONE, np.int32)
        self.pool = PatchPool()

    @property
    def held(self) -> int:
        """Patches that some particle holds."""
        return self.pool.held

    def cover(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        """Grow the table until it covers the box low..high (metres, map frame) with a block to spare all around."""
        size = self.resolution_m * BLOCK
        first, last = np.floor(low / size).astype(np.int64) - 1, np.floor(high / size).astype(np.int64) + 1
        old = self.corner // BLOCK
        size_now = np.array(self.table.shape[:0:-1]) * SIDE // BLOCK
        if self.table.size == 0:
            old, ends = first - MARGIN, last + MARGIN
        elif (first >= old).all() and (last < old + size_now).all():
            return
        else:
            ends = np.where(last >= old + size_now, last + MARGIN, old + size_now - 1)
        start = np.where(first < old, first - MARGIN, old)
        width, height = (ends - start + 1) * BLOCK // SIDE
        table = np.full((len(self.table), height, width), NONE, np.int32)
        (x, y), (height, width) = (old - start) * BLOCK // SIDE, self.table.shape[1:]
        table[:, y : y + height, x : x + width] = self.table
        self.table, self.corner = table, start * BLOCK

    def to_table(self, metres: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) of the map frame in table units."""
        return metres / self.resolution_m - self.corner

    def to_metres(self, cells: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse of `to_table`."""
        return (cells + self.corner) * self.resolution_m

    def add(self, points: NDArray[np.float32], poses: NDArray[np.float64]) -> None:
        """Count hits at `points` (k, 2) metres, base frame, in each particle's map at its pose (n, 3); all covered."""
        cells = points.astype(np.float64) / self.resolution_m
        bases = np.concatenate([self.to_table(poses[:, :2]), poses[:, 2:]], axis=1)
        pool = self.pool
        done, todo = 0, len(points) * len(poses)
        while done < todo:
            done = add_scan(
                cells, bases, done, self.table, pool.mean, pool.near, pool.hits, pool.holders, pool.free, pool.spare
            )
            if done < todo:
                pool.grow()

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particle i takes over the map of particle `parents[i]`; patches that nobody holds any more are freed."""
        self.table = self.pool.only(self.table[parents])


@njit(cache=True)
def add_scan(points, poses, start, tables, mean, near, hits, holders, free, spare):  # type: ignore[no-untyped-def]
    """Count `points` (k, 2) at the poses (n, 3) of n particles, in cells, from pair number `start` on.

    Pair p is point p % k of particle p // k. Returns how many pairs are done, fewer than n * k when the pool ran out.
    """
    k = len(points)
    for pair in range(start, k * len(poses)):
        if spare[0] < 4:  # the 3 x 3 cells around a hit lie in at most four patches
            return pair
        particle, row = pair // k, pair % k
        table = tables[particle]
        c, s = np.cos(poses[particle, 2]), np.sin(poses[particle, 2])
        u = poses[particle, 0] + c * points[row, 0] - s * points[row, 1]
        v = poses[particle, 1] + s * points[row, 0] + c * points[row, 1]
        i, j = int(u), int(v)
        number, cell = table[j >> SHIFT, i >> SHIFT], (j & LOW) * SIDE + (i & LOW)
        if hits[number, cell] >= MOST_HITS:
            continue
        for py in range((j - 1) >> SHIFT, ((j + 1) >> SHIFT) + 1):
            for px in range((i - 1) >> SHIFT, ((i + 1) >> SHIFT) + 1):
                own(py, px, table, mean, near, hits, holders, free, spare)
        number = table[j >> SHIFT, i >> SHIFT]
        hits[number, cell] += 1
        old_x, old_y = mean[number, cell, 0], mean[number, cell, 1]
        new_x, new_y = follow(old_x, u - i, hits[number, cell]), follow(old_y, v - j, hits[number, cell])
        mean[number, cell, 0], mean[number, cell, 1] = new_x, new_y
        if hits[number, cell] == 1 or new_x >> COARSER != old_x >> COARSER or new_y >> COARSER != old_y >> COARSER:
            for y in range(j - 1, j + 2):
                for x in range(i - 1, i + 2):
                    update_near(x, y, i, j, table, mean, near, hits)
    return k * len(poses)


@njit(cache=True, inline="always")
def follow(mean, value, count):  # type: ignore[no-untyped-def]
    """The mean, in 2^-16 cells, once `value` (cells, [0, 1)) is the last of `count` values."""
    before = float(mean)
    after = before + (value * (1 << MEAN_BITS) - before) / count
    return np.uint16(min(after + 0.5, 65535.0))


@njit(cache=True, inline="always")
def update_near(x, y, i, j, table, mean, near, hits):  # type: ignore[no-untyped-def]
    """The centroid of cell (i, j) has moved: bring `near` of cell (x, y) beside it up to date."""
    at, cell = table[j >> SHIFT, i >> SHIFT], (j & LOW) * SIDE + (i & LOW)
    dx = ((i - x) << NEAR_BITS) + (int(mean[at, cell, 0]) >> COARSER)
    dy = ((j - y) << NEAR_BITS) + (int(mean[at, cell, 1]) >> COARSER)
    number, here = table[y >> SHIFT, x >> SHIFT], (y & LOW) * SIDE + (x & LOW)
    old_x, old_y = int(near[number, here, 0]), int(near[number, here, 1])
    if off_centre(dx, dy) < off_centre(old_x, old_y):
        near[number, here, 0], near[number, here, 1] = dx, dy
    elif old_x >> NEAR_BITS == i - x and old_y >> NEAR_BITS == j - y:
        find_near(x, y, table, mean, near, hits)  # it was the nearest and has moved off: another may be nearer now


@njit(cache=True, inline="always")
def off_centre(dx, dy):  # type: ignore[no-untyped-def]
    return (dx - CENTRE) * (dx - CENTRE) + (dy - CENTRE) * (dy - CENTRE)


@njit(cache=True)
def find_near(x, y, table, mean, near, hits):  # type: ignore[no-untyped-def]
    """Set `near` of cell (x, y): the centroid within the 3 x 3 cells around that is nearest to the cell's centre."""
    best_x, best_y = int(FAR), int(FAR)
    for j in range(y - 1, y + 2):
        for i in range(x - 1, x + 2):
            number, cell = table[j >> SHIFT, i >> SHIFT], (j & LOW) * SIDE + (i & LOW)
            if hits[number, cell] > 0:
                dx = ((i - x) << NEAR_BITS) + (int(mean[number, cell, 0]) >> COARSER)
                dy = ((j - y) << NEAR_BITS) + (int(mean[number, cell, 1]) >> COARSER)
                if off_centre(dx, dy) < off_centre(best_x, best_y):
                    best_x, best_y = dx, dy
    number, cell = table[y >> SHIFT, x >> SHIFT], (y & LOW) * SIDE + (x & LOW)
    near[number, cell, 0], near[number, cell, 1] = best_x, best_y
