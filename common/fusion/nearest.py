"""The nearest wall of every cell of a raster, as far as matching looks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK = 64
"""columns that the nearest walls are found for at once"""


class NearestWall(NamedTuple):
    """The nearest wall of every cell of the raster."""

    wall: NDArray[np.int32]
    """(h, w) index in `Walls` of the wall whose cell is nearest, of equals the first; -1 when there is none in reach"""
    cells: NDArray[np.int64]
    """(n, 2) row, column of the walls"""
    resolution: float
    """m per cell"""

    def distance(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
        """(m,) m from these cells' centres to that of their nearest wall cell; inf when there is none in reach."""
        found = self.wall[rows, columns]
        gaps = self.cells[found] - np.stack([rows, columns], axis=1) if len(self.cells) else np.zeros((len(rows), 2))
        return np.where(found >= 0, np.hypot(*gaps.T) * self.resolution, np.inf)


def nearest_wall(shape: tuple[int, ...], cells: NDArray[np.int64], resolution: float, reach_m: float) -> NearestWall:
    """The nearest of the walls `cells` (n, 2) for every cell of a raster, exact up to `reach_m`."""
    return NearestWall(_nearest(shape[0], shape[1], cells, math.ceil(reach_m / resolution)), cells, resolution)


@njit(cache=True)
def _nearest(height: int, width: int, cells: NDArray[np.int64], reach: int) -> NDArray[np.int32]:
    """(h, w) index of the nearest wall within reach.

    First along each row, then over the rows in reach, BLOCK columns side by side, and only where walls are near. There
    a cell's key is the squared distance and, below that, which row it came from: the least key is the nearest, first.
    """
    far, rows = np.int32(1 << 29), 2 * reach + 1
    blocks = -(-width // BLOCK)
    keys, wall = np.empty((height, blocks * BLOCK), np.int32), np.empty((height, blocks * BLOCK), np.int32)
    filled = np.zeros((height, blocks), np.bool_)
    for k in range(len(cells)):
        row, column = cells[k, 0], cells[k, 1]
        first, end = max(0, column - reach), min(width, column + reach + 1)
        for block in range(first // BLOCK, (end - 1) // BLOCK + 1):
            if not filled[row, block]:
                filled[row, block] = True
                keys[row, block * BLOCK : (block + 1) * BLOCK] = far
        for x in range(first, end):
            key = np.int32((x - column) * (x - column) * rows)
            if key < keys[row, x]:
                keys[row, x], wall[row, x] = key, k
    nearest = np.full((height, width), np.int32(-1))
    best, limit = np.empty(BLOCK, np.int32), (reach * reach + 1) * rows
    for y in range(height):
        for block in range(blocks):
            begin, near = block * BLOCK, False
            for row in range(max(0, y - reach), min(height, y + reach + 1)):
                if filled[row, block]:
                    if not near:
                        near = True
                        best[:] = far
                    down = np.int32((row - y) * (row - y) * rows + row - y + reach)
                    for x in range(BLOCK):
                        best[x] = min(best[x], keys[row, begin + x] + down)
            if near:
                for x in range(min(BLOCK, width - begin)):
                    if best[x] < limit:
                        nearest[y, begin + x] = wall[y - reach + best[x] % rows, begin + x]
    return nearest
