"""The pool of small patches that the particles' maps are made of.

Per cell a patch keeps the number of hits, their centroid, and, so that matching needs one look-up per beam, the nearest
centroid among the 3 x 3 cells around (`near`). Memory is taken as patches are first written, not as the pool grows, and
is given back when most of what was written has no holder any more.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

SIDE = 8
"""cells along one side of a patch: walls are thin, and of a larger patch more is empty"""
CELLS = SIDE * SIDE
SHIFT, LOW = 3, SIDE - 1
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
FIRST_PATCHES = 1024
SHRINK = 4
"""the pool shrinks when not even one patch in so many is held"""


class PatchPool:
    """Patches by number.

    mean (patches, CELLS, 2) uint16: centroid of a cell's hits from the cell's corner, in 2^-16 cells.
    near (patches, CELLS, 2) int16: nearest centroid of the 3 x 3 cells around, from this cell's corner, in 2^-7 cells;
    "nearest" to the cell's centre (see patch_near).
    hits (patches, CELLS) uint8; holders (patches,) int32: how many tables point to a patch.
    What a patch without holders contains means nothing.
    """

    def __init__(self, patches: int = FIRST_PATCHES) -> None:
        self.mean = np.empty((patches, CELLS, 2), np.uint16)
        self.near = np.empty((patches, CELLS, 2), np.int16)
        self.hits = np.empty((patches, CELLS), np.uint8)
        self.mean[NONE], self.near[NONE], self.hits[NONE] = 0, FAR, 0
        self.holders = np.zeros(patches, np.int32)
        self.free, self.spare = unheld(self.holders)

    @property
    def held(self) -> int:
        """Patches that some table points to."""
        return len(self.holders) - 1 - int(self.spare[0])

    @property
    def nbytes(self) -> int:
        """Most memory that the pool takes at its size."""
        return self.mean.nbytes + self.near.nbytes + self.hits.nbytes + self.holders.nbytes + self.free.nbytes

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """mean, near, hits, holders, free and spare, as compiled code takes them."""
        return self.mean, self.near, self.hits, self.holders, self.free, self.spare

    def grow(self) -> None:
        """Double the pool; patch numbers stay."""
        size = len(self.holders)
        self._move(2 * size, slice(None))
        free = np.arange(2 * size - 1, size - 1, -1, dtype=np.int32)
        self.free = np.concatenate([free, self.free[: self.spare[0]]])
        self.spare = np.array([len(self.free)])

    def only(self, table: NDArray[np.int32]) -> NDArray[np.int32]:
        """Free all but what `table` points to; returns the table, patches numbered anew if that shrank the pool."""
        count_holders(table, self.holders)
        used = np.flatnonzero(self.holders)
        size = enough_for(2 * len(used))
        if len(used) * SHRINK < len(self.holders) and size < len(self.holders):
            number = np.zeros(len(self.holders), np.int32)
            number[used] = np.arange(1, len(used) + 1, dtype=np.int32)
            table = number[table]
            self._move(size, np.concatenate([[NONE], used]))
        self.free, self.spare = unheld(self.holders)
        return table

    def _move(self, size: int, kept: Any) -> None:
        """Into arrays for `size` patches, one after the other, so that only one is there twice."""
        for name in ("mean", "near", "hits", "holders"):
            old = getattr(self, name)[kept]
            new = np.zeros(size, np.int32) if name == "holders" else np.empty((size, *old.shape[1:]), old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)
            del old


def enough_for(patches: int) -> int:
    """Size of a pool that holds so many."""
    return max(FIRST_PATCHES, 1 << patches.bit_length())


@njit(cache=True)
def count_holders(table, holders):  # type: ignore[no-untyped-def]
    """Recount `holders` from the tables."""
    holders[:] = 0
    for number in table.ravel():
        if number != NONE:
            holders[number] += 1


@njit(cache=True)
def unheld(holders):  # type: ignore[no-untyped-def]
    """The free patches, the lowest last, as it is taken first; and, as an array of one, how many."""
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
