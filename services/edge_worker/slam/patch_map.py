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

from common.geometry import apply

SIDE = 16
"""cells along one side of a patch"""
CELLS = SIDE * SIDE
SHIFT, LOW = 4, SIDE - 1
NONE = -1
MEAN_UNIT = 2.0**-16
"""of a cell, the unit of `mean`"""
NEAR_UNIT = 2.0**-13
"""of a cell, the unit of `near`"""
FAR = np.int16(32767)
"""stands for "no centroid" in `near`: four cells away, where nothing scores, without a branch"""
FAR_CELLS = 3.0
"""what `near` holds lies nearer than this to any point of its cell, FAR lies further"""
MOST_HITS = 1000
"""a centroid weighs at most so many hits, so that it can still follow a changed world"""
MARGIN = 4
"""patches of slack when the table grows"""
FIRST_PATCHES = 256


class PatchMap:
    """The endpoint maps of n particles.

    table (n, height, width) int32: patch numbers, NONE where a particle has none; corner: cell (x, y) of its origin.
    mean (patches, 256, 2) uint16: centroid of a cell's hits from the cell's corner, in MEAN_UNIT.
    near (patches, 256, 2) int16: nearest centroid of the 3 x 3 cells around, from this cell's corner, in NEAR_UNIT.
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
        self.free = np.arange(patches - 1, -1, -1, dtype=np.int32)
        self.spare = np.array([patches])

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

    def add(self, particle: int, points: NDArray[np.float32], pose: NDArray[np.float64]) -> None:
        """Count hits at `points` (n, 2) metres, base frame, in one particle's map; `pose` has them covered."""
        cells = self.to_table(apply(pose, points))
        done = 0
        while True:
            done = add_hits(
                cells, done, self.table[particle], self.mean, self.near, self.hits, self.holders, self.free, self.spare
            )
            if done == len(cells):
                return
            self._grow()

    def _grow(self) -> None:
        """Double the pool (patch numbers stay)."""
        size = len(self.holders)
        mean, near, hits, holders = self.mean, self.near, self.hits, self.holders
        free = self.free[: self.spare[0]]
        self._allocate(2 * size)
        self.mean[:size], self.near[:size], self.hits[:size], self.holders[:size] = mean, near, hits, holders
        self.spare[0] = size + len(free)
        self.free[: self.spare[0]] = np.concatenate([np.arange(2 * size - 1, size - 1, -1, dtype=np.int32), free])

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particle i takes over the map of particle `parents[i]`; patches that nobody holds any more are freed."""
        self.table = self.table[parents]
        self.free, self.spare = count_holders(self.table, self.holders)

    def state(self) -> dict[str, Any]:
        """Everything, as msgpack and arrays take it; patches are numbered anew, without gaps."""
        used = np.flatnonzero(self.holders)
        number = np.full(len(self.holders) + 1, NONE, np.int32)  # the last entry is where NONE points
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
        self._allocate(max(FIRST_PATCHES, 1 << (used - 1).bit_length()) if used else FIRST_PATCHES)
        self.mean[:used], self.near[:used], self.hits[:used] = state["mean"], state["near"], state["hits"]
        self.free, self.spare = count_holders(self.table, self.holders)


@njit(cache=True)
def count_holders(table, holders):  # type: ignore[no-untyped-def]
    """Recount `holders` from the tables; returns the list of free patches and, as an array of one, its length."""
    holders[:] = 0
    for number in table.ravel():
        if number >= 0:
            holders[number] += 1
    free = np.empty(len(holders), np.int32)
    spare = 0
    for number in range(len(holders) - 1, -1, -1):
        if holders[number] == 0:
            free[spare] = number
            spare += 1
    return free, np.array([spare])


@njit(cache=True)
def own(py, px, table, mean, near, hits, holders, free, spare):  # type: ignore[no-untyped-def]
    """Give this table a patch of its own at (py, px). The pool must have one to spare."""
    number = table[py, px]
    if number >= 0 and holders[number] == 1:
        return
    spare[0] -= 1
    fresh = free[spare[0]]
    holders[fresh] = 1
    if number >= 0:
        mean[fresh], near[fresh], hits[fresh] = mean[number], near[number], hits[number]
        holders[number] -= 1
    else:
        mean[fresh], near[fresh], hits[fresh] = np.uint16(0), FAR, np.uint16(0)
    table[py, px] = fresh


@njit(cache=True)
def add_hits(cells, start, table, mean, near, hits, holders, free, spare):  # type: ignore[no-untyped-def]
    """Count hits at cells[start:] (n, 2), table units; returns how many rows are done, n unless the pool ran out."""
    for row in range(start, len(cells)):
        i, j = int(cells[row, 0]), int(cells[row, 1])
        if spare[0] < 4:  # the 3 x 3 cells around a hit lie in at most four patches
            return row
        for py in range((j - 1) >> SHIFT, ((j + 1) >> SHIFT) + 1):
            for px in range((i - 1) >> SHIFT, ((i + 1) >> SHIFT) + 1):
                own(py, px, table, mean, near, hits, holders, free, spare)
        number, cell = table[j >> SHIFT, i >> SHIFT], (j & LOW) * SIDE + (i & LOW)
        if hits[number, cell] < MOST_HITS:
            hits[number, cell] += 1
        for axis in range(2):
            inside = (cells[row, axis] - (i if axis == 0 else j)) / MEAN_UNIT
            before = float(mean[number, cell, axis])
            after = before + (inside - before) / hits[number, cell]
            mean[number, cell, axis] = np.uint16(min(after + 0.5, 65535.0))
        for y in range(j - 1, j + 2):
            for x in range(i - 1, i + 2):
                find_near(x, y, table, mean, near, hits)
    return len(cells)


@njit(cache=True)
def find_near(i, j, table, mean, near, hits):  # type: ignore[no-untyped-def]
    """Set `near` of cell (i, j): the centroid within the 3 x 3 cells around that is nearest to the cell's centre."""
    best, best_x, best_y = 1e6, FAR, FAR
    for y in range(j - 1, j + 2):
        for x in range(i - 1, i + 2):
            number, cell = table[y >> SHIFT, x >> SHIFT], (y & LOW) * SIDE + (x & LOW)
            if number >= 0 and hits[number, cell] > 0:
                dx = x - i + mean[number, cell, 0] * MEAN_UNIT
                dy = y - j + mean[number, cell, 1] * MEAN_UNIT
                distance = (dx - 0.5) ** 2 + (dy - 0.5) ** 2
                if distance < best:
                    best = distance
                    best_x, best_y = np.int16(np.rint(dx / NEAR_UNIT)), np.int16(np.rint(dy / NEAR_UNIT))
    number, cell = table[j >> SHIFT, i >> SHIFT], (j & LOW) * SIDE + (i & LOW)
    near[number, cell, 0], near[number, cell, 1] = best_x, best_y
