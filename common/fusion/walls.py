"""Walls of an occupancy raster: sub-cell points, normals, how straight the wall is there, and the nearest wall.

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
FAR_M = np.float32(1e3)
BLOCK = 64
"""columns that the nearest walls are found for at once"""


class Walls(NamedTuple):
    """Wall cells, row by row from the lowest."""

    cells: NDArray[np.int64]
    """(n, 2) row, column in the raster"""
    points: NDArray[np.float64]
    """(n, 2) m in the map frame, on the wall's middle line"""
    normals: NDArray[np.float64]
    """(n, 2) unit vectors across the wall, towards the side that is free (or freer)"""
    straightness: NDArray[np.float64]
    """(n,) 0 a dot or a crossing, 1 a straight wall"""
    sided: NDArray[np.bool_]
    """(n,) whether only that side is free: the wall has been seen from there alone"""

    def at(self, indices: NDArray[np.int64]) -> Walls:
        """Some of the walls."""
        return Walls(
            self.cells[indices],
            self.points[indices],
            self.normals[indices],
            self.straightness[indices],
            self.sided[indices],
        )


class NearestWall(NamedTuple):
    """The nearest wall of every cell of the raster, as far as was looked."""

    distance: NDArray[np.float32]
    """(h, w) m from the cell's centre to that of the nearest wall cell; FAR_M when there is none in reach"""
    wall: NDArray[np.int32]
    """(h, w) index of that wall in `Walls`, -1 when there is none in reach"""


def find_walls(raster: NDArray[np.int8], origin_m: NDArray[np.float64], resolution: float) -> Walls:
    """Walls of an occupancy raster (h, w) whose cell [0, 0] has its lower left corner at `origin_m` (x, y)."""
    places = np.flatnonzero(raster == OCCUPIED)
    cells = np.stack([places // raster.shape[1], places % raster.shape[1]], axis=1)
    reach = max(round(WINDOW_M / resolution), 2)
    offsets, normals, straightness, sided = _lines(np.pad(raster, reach, constant_values=UNKNOWN), cells, reach)
    centres = origin_m + (cells[:, ::-1] + 0.5) * resolution
    return Walls(cells, centres + offsets * resolution, normals, straightness, sided)


def nearest_wall(shape: tuple[int, ...], cells: NDArray[np.int64], resolution: float, reach_m: float) -> NearestWall:
    """The nearest of the walls `cells` (n, 2) for every cell of a raster, exact up to `reach_m`."""
    return NearestWall(*_nearest(shape[0], shape[1], cells, math.ceil(reach_m / resolution), resolution))


def orientation_histogram(walls: Walls) -> NDArray[np.float64]:
    """(360,) weight of wall by the direction of its normal, half a degree a bin, period 180 degrees."""
    angle = np.arctan2(walls.normals[:, 1], walls.normals[:, 0]) % np.pi
    bins = np.floor(angle * (ORIENTATION_BINS / np.pi)).astype(np.int64) % ORIENTATION_BINS
    return np.bincount(bins, weights=walls.straightness**2, minlength=ORIENTATION_BINS).astype(np.float64)


@njit(cache=True)
def alike(cosine: float, straight_a: float, straight_b: float, sided_a: bool, sided_b: bool) -> bool:
    """Whether two walls can be one: they run the same way, and face the same way if each was seen from one side."""
    if straight_a < STRAIGHT or straight_b < STRAIGHT:
        return True
    if sided_a and sided_b:
        return cosine > SAME_WAY
    return abs(cosine) > SAME_WAY


@njit(cache=True)
def _lines(
    raster: NDArray[np.int8], cells: NDArray[np.int64], reach: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """(offsets (n, 2) cells to the line, normals (n, 2), straightness, sided); `raster` is padded by `reach`.

    Cells come row by row, so that those of one row within reach are a run of `cells`, which only moves on.
    """
    n = len(cells)
    offsets, normals, straightness, sided = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n), np.zeros(n, np.bool_)
    begins = np.searchsorted(cells[:, 0], np.arange(raster.shape[0] + 1) - reach)
    free = _free_before(raster)
    run = np.zeros(2 * reach + 1, np.int64)
    for k in range(n):
        row, column = cells[k, 0] + reach, cells[k, 1] + reach
        if k == 0 or cells[k - 1, 0] != cells[k, 0]:
            run[:] = begins[row - reach : row + reach + 1]
        count, sx, sy, sxx, syy, sxy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for dy in range(-reach, reach + 1):
            span = math.floor(math.sqrt(reach * reach - dy * dy))
            last = begins[row + dy + 1]
            i = run[dy + reach]
            while i < last and cells[i, 1] < cells[k, 1] - reach:
                i += 1
            run[dy + reach] = i
            while i < last and cells[i, 1] <= cells[k, 1] + span:
                dx = cells[i, 1] - cells[k, 1]
                i += 1
                if dx >= -span:
                    count += 1.0
                    sx, sy = sx + dx, sy + dy
                    sxx, syy, sxy = sxx + dx * dx, syy + dy * dy, sxy + dx * dy
        mx, my = sx / count, sy / count
        vxx, vyy, vxy = sxx / count - mx * mx, syy / count - my * my, sxy / count - mx * my
        across = 0.5 * math.atan2(2.0 * vxy, vxx - vyy) + 0.5 * math.pi
        nx, ny = math.cos(across), math.sin(across)
        shift = min(max(nx * mx + ny * my, -1.0), 1.0)
        offsets[k, 0], offsets[k, 1] = shift * nx, shift * ny
        front, back = _free_sides(free, row, column, reach, nx, ny)
        if back > front:
            front, back, nx, ny = back, front, -nx, -ny
        sided[k] = back < ONE_SIDED * front
        normals[k, 0], normals[k, 1] = nx, ny
        spread = vxx + vyy
        if spread > 0.0:
            straightness[k] = math.sqrt((vxx - vyy) ** 2 + 4.0 * vxy * vxy) / spread
    return offsets, normals, straightness, sided


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
    front, back = 0, 0
    for dy in range(-reach, reach + 1):
        along = free[row + dy, column - reach : column + reach + 2]
        t = ny * dy
        if abs(nx) < 1e-9:
            all_ = along[2 * reach + 1] - along[0]
            front += all_ if t > 1.0 else 0
            back += all_ if t < -1.0 else 0
            continue
        # cells whose nx dx + t is > 1 or < -1: those right of one column and left of the other, or the reverse
        rightwards, leftwards = (1.0 - t) / nx, (-1.0 - t) / nx
        if nx < 0.0:
            rightwards, leftwards = leftwards, rightwards
        first = min(max(math.floor(rightwards) + 1 + reach, 0), 2 * reach + 1)
        end = min(max(math.ceil(leftwards) + reach, 0), 2 * reach + 1)
        right, left = along[2 * reach + 1] - along[first], along[end] - along[0]
        if nx > 0.0:
            front, back = front + right, back + left
        else:
            front, back = front + left, back + right
    return front, back


@njit(cache=True)
def _nearest(
    height: int, width: int, cells: NDArray[np.int64], reach: int, resolution: float
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """(distance in m, index) of the nearest wall within reach, of equals the first.

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
    distance, nearest = np.full((height, width), FAR_M), np.full((height, width), np.int32(-1))
    lengths = np.sqrt(np.arange(reach * reach + 1).astype(np.float32)) * np.float32(resolution)
    best = np.empty(BLOCK, np.int32)
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
                    square, row = best[x] // rows, y - reach + best[x] % rows
                    if square <= reach * reach:
                        distance[y, begin + x] = lengths[square]
                        nearest[y, begin + x] = wall[row, begin + x]
    return distance, nearest
