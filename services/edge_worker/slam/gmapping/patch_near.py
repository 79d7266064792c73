"""Which centroid is the nearest to a cell, kept up to date hit by hit (`near`), or found for whole maps at once.

Of two equally near centroids that of the cell first in the order of rows counts. So `near` follows from the centroids
alone, whichever hit came first, and a map that is built again has the same.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from services.edge_worker.slam.gmapping.patch_pool import CENTRE, COARSER, FAR, LOW, NEAR_BITS, NONE, SHIFT, SIDE


@njit(cache=True, inline="always")
def rank(dx, dy):  # type: ignore[no-untyped-def]
    """Of two centroids, (dx, dy) off this cell's corner in 2^-7 cells, the nearer to its centre has the lower."""
    square = (dx - CENTRE) * (dx - CENTRE) + (dy - CENTRE) * (dy - CENTRE)
    return square * 9 + ((dy >> NEAR_BITS) + 1) * 3 + (dx >> NEAR_BITS) + 1


@njit(cache=True, inline="always")
def update_near(x, y, i, j, table, mean, near, hits):  # type: ignore[no-untyped-def]
    """The centroid of cell (i, j) has moved: bring `near` of cell (x, y) beside it up to date."""
    at, cell = table[j >> SHIFT, i >> SHIFT], (j & LOW) * SIDE + (i & LOW)
    dx = ((i - x) << NEAR_BITS) + (int(mean[at, cell, 0]) >> COARSER)
    dy = ((j - y) << NEAR_BITS) + (int(mean[at, cell, 1]) >> COARSER)
    number, here = table[y >> SHIFT, x >> SHIFT], (y & LOW) * SIDE + (x & LOW)
    old_x, old_y = int(near[number, here, 0]), int(near[number, here, 1])
    if rank(dx, dy) < rank(old_x, old_y):
        near[number, here, 0], near[number, here, 1] = dx, dy
    elif old_x >> NEAR_BITS == i - x and old_y >> NEAR_BITS == j - y:
        find_near(x, y, table, mean, near, hits)  # it was the nearest and has moved off: another may be nearer now


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
                if rank(dx, dy) < rank(best_x, best_y):
                    best_x, best_y = dx, dy
    number, cell = table[y >> SHIFT, x >> SHIFT], (y & LOW) * SIDE + (x & LOW)
    near[number, cell, 0], near[number, cell, 1] = best_x, best_y


@njit(cache=True)
def find_all(tables, mean, near, hits):  # type: ignore[no-untyped-def]
    """Set `near` of all patches of the tables (n, height, width) as `find_near` would."""
    done = np.zeros(len(hits), np.bool_)
    done[NONE] = True
    for table in tables:
        for py in range(table.shape[0]):
            for px in range(table.shape[1]):
                number = table[py, px]
                if not done[number]:
                    find_patch(py, px, table, mean, hits, near[number])
                    done[number] = True


@njit(cache=True)
def find_patch(py, px, table, mean, hits, out):  # type: ignore[no-untyped-def]
    """`near` (CELLS, 2) of the patch at (py, px) of a table: each centroid is shown to the cells around it."""
    height, width = table.shape
    best = np.full(SIDE * SIDE, rank(int(FAR), int(FAR)))
    out[:] = FAR
    for j in range(-1, SIDE + 1):
        row = py + (j >> SHIFT)
        for column in range(max(px - 1, 0), min(px + 2, width)):
            number = table[row, column] if 0 <= row < height else NONE
            if number == NONE:
                continue
            left = (column - px) * SIDE
            for i in range(max(left, -1), min(left + SIDE, SIDE + 1)):
                cell = (j & LOW) * SIDE + i - left
                if hits[number, cell] == 0:
                    continue
                at_x, at_y = int(mean[number, cell, 0]) >> COARSER, int(mean[number, cell, 1]) >> COARSER
                for y in range(max(j - 1, 0), min(j + 2, SIDE)):
                    for x in range(max(i - 1, 0), min(i + 2, SIDE)):
                        dx, dy = ((i - x) << NEAR_BITS) + at_x, ((j - y) << NEAR_BITS) + at_y
                        away = rank(dx, dy)
                        if away < best[y * SIDE + x]:
                            best[y * SIDE + x] = away
                            out[y * SIDE + x, 0], out[y * SIDE + x, 1] = dx, dy
