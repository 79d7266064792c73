"""Walls of an occupancy raster: sub-cell points, normals, and how straight the wall is there.

A wall's line near a cell is the principal axis of the wall cells around it: their mean gives the line's place to a
fraction of a cell, their spread its direction (period 180 degrees) and its straightness.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.grid.grid import FREE, OCCUPIED, UNKNOWN

WINDOW_M = 0.3
"""radius of the neighbourhood that a wall's line is taken from"""
ORIENTATION_BINS = 360
"""of half a degree over the half turn"""
ONE_SIDED = 0.25
"""a wall with less free space behind it, relative to before it, has been seen from one side"""
SAME_WAY = 0.7
"""least cosine between the normals of one wall in two maps"""
STRAIGHT = 0.5
"""below this straightness a wall is a corner or a dot and may match any direction"""
X, Y, NX, NY, STRAIGHTNESS, SIDED = range(6)
"""columns of `Walls.lines`"""


class Walls(NamedTuple):
    """Wall cells and the lines of the walls there."""

    cells: NDArray[np.int64]
    """(n, 2) row, column in the raster"""
    lines: NDArray[np.float64]
    """(n, 6) x, y, normal's x and y, straightness, sided: what is asked for together lies together"""

    @property
    def points(self) -> NDArray[np.float64]:
        """(n, 2) m in the map frame, on the wall's middle line."""
        return self.lines[:, X : Y + 1]

    @property
    def normals(self) -> NDArray[np.float64]:
        """(n, 2) unit vectors across the wall, towards the side that is free (or freer)."""
        return self.lines[:, NX : NY + 1]

    @property
    def straightness(self) -> NDArray[np.float64]:
        """(n,) 0 a dot or a crossing, 1 a straight wall."""
        return self.lines[:, STRAIGHTNESS]

    @property
    def sided(self) -> NDArray[np.bool_]:
        """(n,) whether only that side is free: the wall has been seen from there alone."""
        return self.lines[:, SIDED] > 0

    def at(self, indices: NDArray[np.int64]) -> Walls:
        """Some of the walls."""
        return Walls(self.cells[indices], self.lines[indices])


def find_walls(raster: NDArray[np.int8], origin_m: NDArray[np.float64], resolution: float) -> Walls:
    """Walls of an occupancy raster (h, w) whose cell [0, 0] has its lower left corner at `origin_m` (x, y)."""
    places = np.flatnonzero(raster == OCCUPIED)
    cells = np.stack([places // raster.shape[1], places % raster.shape[1]], axis=1)
    reach = max(round(WINDOW_M / resolution), 2)
    lines = _lines(np.pad(raster, reach, constant_values=UNKNOWN), cells, reach)
    lines[:, X : Y + 1] = origin_m + (cells[:, ::-1] + 0.5) * resolution + lines[:, X : Y + 1] * resolution
    return Walls(cells, lines)


def orientation_histogram(walls: Walls) -> NDArray[np.float64]:
    """(360,) weight of wall by the direction of its normal, half a degree a bin, period 180 degrees."""
    angle = np.arctan2(walls.normals[:, 1], walls.normals[:, 0]) % np.pi
    bins = np.floor(angle * (ORIENTATION_BINS / np.pi)).astype(np.int64) % ORIENTATION_BINS
    return np.bincount(bins, weights=walls.straightness**2, minlength=ORIENTATION_BINS).astype(np.float64)


@njit(cache=True)
def alike(cosine: float, straight_a: float, straight_b: float, sided_a: float, sided_b: float) -> bool:
    """Whether two walls, `cosine` between their normals, can be one.

    They run the same way, and face the same way if each was seen from one side. (Numbers, not rows of `lines`: handing
    over rows costs more than all the rest.)
    """
    if straight_a < STRAIGHT or straight_b < STRAIGHT:
        return True
    return cosine > SAME_WAY if sided_a > 0.0 and sided_b > 0.0 else abs(cosine) > SAME_WAY


@njit(cache=True)
def _lines(raster: NDArray[np.int8], cells: NDArray[np.int64], reach: int) -> NDArray[np.float64]:
    """`Walls.lines` but for x and y, which are cells to the line; `raster` is padded by `reach`.

    Cells come row by row, so that those of one row within reach are a run of `cells`, which only moves on.
    """
    n = len(cells)
    lines = np.zeros((n, 6))
    begins = np.searchsorted(cells[:, 0], np.arange(raster.shape[0] + 1) - reach)
    free = _free_before(raster)
    run = np.zeros(2 * reach + 1, np.int64)
    spans = np.floor(np.sqrt(reach**2 - np.arange(-reach, reach + 1) ** 2)).astype(np.int64)
    for k in range(n):
        row, column = cells[k, 0] + reach, cells[k, 1] + reach
        if k == 0 or cells[k - 1, 0] != cells[k, 0]:
            run[:] = begins[row - reach : row + reach + 1]
        count, sx, sy, sxx, syy, sxy = 0, 0, 0, 0, 0, 0
        for dy in range(-reach, reach + 1):
            span, last = spans[dy + reach], begins[row + dy + 1]
            i = run[dy + reach]
            while i < last and cells[i, 1] < cells[k, 1] - reach:
                i += 1
            run[dy + reach] = i
            inside, along, squares = 0, 0, 0
            while i < last and cells[i, 1] <= cells[k, 1] + span:
                dx = cells[i, 1] - cells[k, 1]
                i += 1
                if dx >= -span:
                    inside, along, squares = inside + 1, along + dx, squares + dx * dx
            count, sx, sy = count + inside, sx + along, sy + dy * inside
            sxx, syy, sxy = sxx + squares, syy + dy * dy * inside, sxy + dy * along
        mx, my = sx / count, sy / count
        vxx, vyy, vxy = sxx / count - mx * mx, syy / count - my * my, sxy / count - mx * my
        across = 0.5 * math.atan2(2.0 * vxy, vxx - vyy) + 0.5 * math.pi
        nx, ny = math.cos(across), math.sin(across)
        shift = min(max(nx * mx + ny * my, -1.0), 1.0)
        lines[k, X], lines[k, Y] = shift * nx, shift * ny
        front, back = _free_sides(free, row, column, reach, nx, ny)
        if back > front:
            front, back, nx, ny = back, front, -nx, -ny
        lines[k, NX], lines[k, NY], lines[k, SIDED] = nx, ny, 1.0 if back < ONE_SIDED * front else 0.0
        spread = vxx + vyy
        if spread > 0.0:
            lines[k, STRAIGHTNESS] = math.sqrt((vxx - vyy) ** 2 + 4.0 * vxy * vxy) / spread
    return lines


@njit(cache=True)
def _free_before(raster: NDArray[np.int8]) -> NDArray[np.int32]:
    """(h, w + 1) how many cells of the row to the left of each are free."""
    height, width = raster.shape
    before = np.zeros((height, width + 1), np.int32)
    for y in range(height):
        count = np.int32(0)
        for x in range(width):
            count += np.int32(raster[y, x] == FREE)
            before[y, x + 1] = count
    return before


@njit(cache=True)
def _free_sides(free: NDArray[np.int32], row: int, column: int, reach: int, nx: float, ny: float) -> tuple[int, int]:
    """Free cells more than one cell before and behind the line through a cell with the normal (nx, ny)."""
    front, back, left, width = 0, 0, column - reach, 2 * reach + 1
    if abs(nx) < 1e-9:
        for dy in range(-reach, reach + 1):
            count = free[row + dy, left + width] - free[row + dy, left]
            front += count if ny * dy > 1.0 else 0
            back += count if ny * dy < -1.0 else 0
        return front, back
    # cells whose nx dx + ny dy is > 1 or < -1: those right of one column and left of another
    side = 1.0 if nx > 0.0 else -1.0
    for dy in range(-reach, reach + 1):
        first = min(max(math.floor((side - ny * dy) / nx) + 1 + reach, 0), width)
        end = min(max(math.ceil((-side - ny * dy) / nx) + reach, 0), width)
        front += free[row + dy, left + width] - free[row + dy, left + first]
        back += free[row + dy, left + end] - free[row + dy, left]
    if nx < 0.0:
        front, back = back, front
    return front, back
