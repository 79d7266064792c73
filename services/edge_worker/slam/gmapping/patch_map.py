"""Endpoint maps of all particles: tables of numbers of patches, which particles share until one of them writes.

Copying a map copies its table and counts one more holder per patch (GMapping's copy-on-write hierarchical grid).
Nothing is ray traced. Lengths here are in cells, "table units": cells from the lower left corner of the table.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.errors import MapTooLarge
from services.edge_worker.slam.gmapping.patch_near import find_all, update_near
from services.edge_worker.slam.gmapping.patch_pool import (
    COARSER,
    LOW,
    MEAN_BITS,
    MOST_HITS,
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
MOST_BYTES = 1 << 30
"""of all tables: 30 particles may see 1.2 x 1.2 km"""


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
        """Grow the table until it covers the box low..high (metres, map frame) with a block to spare all around.

        Raises MapTooLarge, and is then as it was.
        """
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
        if float(width) * float(height) * len(self.table) * self.table.itemsize > MOST_BYTES:
            metres = " x ".join(f"{side * SIDE * self.resolution_m:.0f}" for side in (width, height))
            raise MapTooLarge(
                f"gmapping: the map would be {metres} m, which {len(self.table)} particles cannot have; "
                f"where the robot did go so far, use kernel 'graph'"
            )
        self.lay_out(start * BLOCK, height, width)

    def cover_scan(self, points: NDArray[np.float32], poses: NDArray[np.float64], slack_m: float = 0.0) -> None:
        """Grow the table until it covers `points` (k, 2) metres, base frame, and `slack_m` more at the poses (n, 3)."""
        radius = float(np.sqrt(np.square(points).sum(axis=1).max())) + slack_m
        self.cover(poses[:, :2].min(axis=0) - radius, poses[:, :2].max(axis=0) + radius)

    def lay_out(self, corner: NDArray[np.int64], height: int, width: int) -> None:
        """Make the table so large, with cell `corner` as its origin; it must have room for what the table holds."""
        table = np.full((len(self.table), height, width), NONE, np.int32)
        (x, y), (height, width) = (self.corner - corner) // SIDE, self.table.shape[1:]
        table[:, y : y + height, x : x + width] = self.table
        self.table, self.corner = table, corner

    def to_table(self, metres: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) of the map frame in table units."""
        return metres / self.resolution_m - self.corner

    def to_metres(self, cells: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse of `to_table`."""
        return (cells + self.corner) * self.resolution_m

    def add(self, points: NDArray[np.float32], poses: NDArray[np.float64], nearest: bool = True) -> None:
        """Count hits at `points` (k, 2) metres, base frame, in each particle's map at its pose (n, 3); all covered.

        With `nearest` false, `near` is left for `find_near`. Raises ValueError when a hit lies off the table.
        """
        cells, bases = (
            points.astype(np.float64) / self.resolution_m,
            poses / [self.resolution_m, self.resolution_m, 1.0],
        )
        done, todo = 0, len(points) * len(poses)
        while done < todo:
            done = add_scan(cells, bases, done, nearest, self.corner, self.table, *self.pool.arrays)
            if done < todo:
                self.pool.grow()

    def find_near(self) -> None:
        """Find all nearest centroids anew."""
        find_all(self.table, *self.pool.arrays[:3])

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particle i takes over the map of particle `parents[i]`; patches that nobody holds any more are freed."""
        self.table = self.pool.only(self.table[parents])


@njit(cache=True)
def add_scan(points, poses, start, nearest, corner, tables, mean, near, hits, holders, free, spare):  # type: ignore[no-untyped-def]
    """Count `points` (k, 2) at the poses (n, 3) of n particles, in cells of the map frame, from pair `start` on.

    Pair p is point p % k of particle p // k. Returns how many pairs are done, fewer than n * k when the pool ran out.
    Where a hit lies in its cell does not depend on the table's corner, so that the same hits give the same map however
    the table grew.
    """
    k = len(points)
    height, width = tables.shape[1] * SIDE, tables.shape[2] * SIDE
    for particle in range(start // k, len(poses)):
        table = tables[particle]
        x, y, c, s = poses[particle, 0], poses[particle, 1], np.cos(poses[particle, 2]), np.sin(poses[particle, 2])
        for row in range(max(start - particle * k, 0), k):
            if spare[0] < 4:  # the 3 x 3 cells around a hit lie in at most four patches
                return particle * k + row
            u, v = x + c * points[row, 0] - s * points[row, 1], y + s * points[row, 0] + c * points[row, 1]
            left, below = np.floor(u), np.floor(v)
            i, j = int(left) - corner[0], int(below) - corner[1]
            if not (0 < i < width - 1 and 0 < j < height - 1):
                raise ValueError("a hit lies off the map")
            number, cell = table[j >> SHIFT, i >> SHIFT], (j & LOW) * SIDE + (i & LOW)
            if hits[number, cell] >= MOST_HITS:
                continue
            for py in range((j - 1) >> SHIFT, ((j + 1) >> SHIFT) + 1):
                for px in range((i - 1) >> SHIFT, ((i + 1) >> SHIFT) + 1):
                    own(py, px, table, mean, near, hits, holders, free, spare)
            number = table[j >> SHIFT, i >> SHIFT]
            hits[number, cell] += 1
            old_x, old_y = mean[number, cell, 0], mean[number, cell, 1]
            new_x, new_y = follow(old_x, u - left, hits[number, cell]), follow(old_y, v - below, hits[number, cell])
            mean[number, cell, 0], mean[number, cell, 1] = new_x, new_y
            first = hits[number, cell] == 1
            if nearest and (first or new_x >> COARSER != old_x >> COARSER or new_y >> COARSER != old_y >> COARSER):
                for b in range(j - 1, j + 2):
                    for a in range(i - 1, i + 2):
                        update_near(a, b, i, j, table, mean, near, hits)
    return k * len(poses)


@njit(cache=True, inline="always")
def follow(mean, value, count):  # type: ignore[no-untyped-def]
    """The mean, in 2^-16 cells, once `value` (cells, [0, 1)) is the last of `count` values."""
    before = float(mean)
    after = before + (value * (1 << MEAN_BITS) - before) / count
    return np.uint16(min(after + 0.5, 65535.0))
