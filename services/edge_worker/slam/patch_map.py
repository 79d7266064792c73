"""Endpoint maps of all particles in one pool of small patches that particles share until one of them writes.

A particle's map is a table of patch numbers; copying a map copies its table and counts one more holder per patch
(GMapping's copy-on-write hierarchical grid). Per cell a patch keeps the number of hits, their centroid, and, so that
matching needs one look-up per beam, the nearest centroid among the 3 x 3 cells around (`near`). Nothing is ray traced.

Lengths here are in cells, "table units": cells from the lower left corner of the table.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

SIDE = 16
"""cells along one side of a patch"""
CELLS = SIDE * SIDE
SHIFT, LOW = 4, SIDE - 1
NONE = 0
"""number of the patch that every table has where it has none: never written, so that reading needs no branch"""
MEAN_BITS, NEAR_BITS = 16, 7
"""`mean` is in 2^-16 cells so that it can follow many hits, `near` in 2^-7 cells (0.4 mm of 5 cm) so that it rarely
changes"""
COARSER = MEAN_BITS - NEAR_BITS
NEAR_UNIT = 2.0**-NEAR_BITS
"""of a cell"""
CENTRE = 1 << (NEAR_BITS - 1)
FAR = np.int16(32767)
"""stands for "no centroid" in `near`: far away, where nothing scores, again without a branch"""
FAR_CELLS = 3.0
"""what `near` holds lies nearer than this to any point of its cell, FAR lies further"""
MOST_HITS = 16
"""a cell's centroid stands once it is the mean of so many hits: known places stay shared and cost nothing"""
MARGIN = 4
"""patches of slack when the table grows"""
FIRST_PATCHES = 256


class PatchMap:
    """The endpoint maps of n particles.

    table (n, height, width) int32: patch numbers, NONE where a particle has none; corner: cell (x, y) of its origin.
    mean (patches, 256, 2) uint16: centroid of a cell's hits from the cell's corner, in 2^-16 cells.
    near (patches, 256, 2) int16: nearest centroid of the 3 x 3 cells around, from this cell's corner, in 2^-7 cells;
    "nearest" to the cell's centre.
    hits (patches, 256) uint16; holders (patches,) int32: how many tables point to a patch.
    """

    def __init__(self, particles: int, resolution_m: float) -> None:
        self.resolution_m = resolution_m
        self.corner = np.zeros(2, np.int64)
        self.table = np.full((particles, 0, 0), NONE, np.int32)
        self._allocate(FIRST_PATCHES)

    def _allocate(self, patches: int) -> None:
        self.mean = np.zeros((patches, CELLS, 2), np.uint16)
        self.near = np.full((patches, CELLS, 2), FAR, np.int16)
        self.hits = np.zeros((patches, CELLS), np.uint16)
        self.holders = np.zeros(patches, np.int32)
        self.free = np.arange(patches - 1, NONE, -1, dtype=np.int32)
        self.spare = np.array([len(self.free)])

    @property
    def held(self) -> int:
        """Patches that some particle holds."""
        return len(self.free) - int(self.spare[0])

    @property
    def nbytes(self) -> int:
        """Memory of the pool and the tables."""
        return self.table.nbytes + self.mean.nbytes + self.near.nbytes + self.hits.nbytes + self.holders.nbytes

    def cover(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        """Grow the table until it covers the box low..high (metres, map frame) with a patch to spare all around."""
        size = self.resolution_m * SIDE
        first, last = np.floor(low / size).astype(np.int64) - 1, np.floor(high / size).astype(np.int64) + 1
        old = self.corner // SIDE
        size_now = np.array(self.table.shape[:0:-1])
        if self.table.size == 0:
            old, ends = first - MARGIN, last + MARGIN
        elif (first >= old).all() and (last < old + size_now).all():
            return
        else:
            ends = np.where(last >= old + size_now, last + MARGIN, old + size_now - 1)
        start = np.where(first < old, first - MARGIN, old)
        width, height = ends - start + 1
        table = np.full((len(self.table), height, width), NONE, np.int32)
        (x, y), (width, height) = old - start, size_now
        table[:, y : y + height, x : x + width] = self.table
        self.table, self.corner = table, start * SIDE

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
        done, todo = 0, len(points) * len(poses)
        while done < todo:
            done = add_scan(
                cells, bases, done, self.table, self.mean, self.near, self.hits, self.holders, self.free, self.spare
            )
            if done < todo:
                self._grow()

    def _grow(self) -> None:
        """Double the pool (patch numbers stay)."""
        size = len(self.holders)
        mean, near, hits, holders = self.mean, self.near, self.hits, self.holders
        free = self.free[: self.spare[0]].copy()
        self._allocate(2 * size)
        self.mean[:size], self.near[:size], self.hits[:size], self.holders[:size] = mean, near, hits, holders
        self.spare[0] = size + len(free)
        self.free[size : self.spare[0]] = free  # the new ones lie below: the same order as after `count_holders`

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particle i takes over the map of particle `parents[i]`; patches that nobody holds any more are freed."""
        self.table = self.table[parents]
        self.free, self.spare = count_holders(self.table, self.holders)

    def state(self) -> dict[str, Any]:
        """Everything, as msgpack and arrays take it; patches are numbered anew, without gaps."""
        used = np.concatenate([[NONE], np.flatnonzero(self.holders)])
        number = np.zeros(len(self.holders), np.int32)
        number[used] = np.arange(len(used), dtype=np.int32)
        return {
            "corner": self.corner,
            "table": number[self.table],
            "mean": self.mean[used],
            "near": self.near[used],
            "hits": self.hits[used],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """The inverse of `state`."""
        used = len(state["hits"])
        self.corner, self.table = state["corner"].copy(), state["table"].copy()
        self._allocate(max(FIRST_PATCHES, 1 << (used - 1).bit_length()))
        self.mean[:used], self.near[:used], self.hits[:used] = state["mean"], state["near"], state["hits"]
        self.free, self.spare = count_holders(self.table, self.holders)


@njit(cache=True)
def count_holders(table, holders):  # type: ignore[no-untyped-def]
    """Recount `holders` from the tables; returns the list of free patches and, as an array of one, its length."""
    holders[:] = 0
    for number in table.ravel():
        if number != NONE:
            holders[number] += 1
    free = np.empty(len(holders) - 1, np.int32)
    spare = 0
    for number in range(len(holders) - 1, NONE, -1):
        if holders[number] == 0:
            free[spare] = number
            spare += 1
    return free, np.array([spare])


@njit(cache=True)
def own(py, px, table, mean, near, hits, holders, free, spare):  # type: ignore[no-untyped-def]
    """Give this table a patch of its own at (py, px). The pool must have one to spare."""
    number = table[py, px]
    if number != NONE and holders[number] == 1:
        return
    spare[0] -= 1
    fresh = free[spare[0]]
    holders[fresh] = 1
    # of NONE this copies an empty patch, which also clears what an earlier holder left
    mean[fresh], near[fresh], hits[fresh] = mean[number], near[number], hits[number]
    if number != NONE:
        holders[number] -= 1
    table[py, px] = fresh


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
