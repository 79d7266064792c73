"""Rendering: one resampling of counts from a robot's frame straight onto another lattice.

Two rules make the picture. *Backward*: a target cell takes the counts of the source cell under its centre, which
leaves no holes in areas. *Forward*: an occupied source cell is also carried along its centre and along the short
arms to its occupied neighbours; samples are less than one cell apart, so any 8-connected wall stays 8-connected,
at every angle, without being thickened on both sides as interpolation would. All cells are found in integer
arithmetic on a rotation rounded to 2^-36 cells, so every machine renders the same bits.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from common.errors import Unmergeable
from common.grid.grid import Counts, Dense, Grid, check_size, occupancy, tiles_of
from common.grid.warp import SHIFT, STRAIGHT, Lattice, lattice, shift_at
from common.wire.cloud import Warp

ARM = round(0.49 * (1 << SHIFT))
"""reach of a wall sample towards an occupied neighbour: just inside its own cell, so that identity is exact"""
MAX_REACH_M = 10_000.0
"""transforms that move a map farther are wrong, and would overflow the fixed point"""


def render(grid: Grid, transform: ArrayLike, resolution: float, warp: Warp | None = None) -> Grid:
    """The grid's counts on the lattice of `resolution` m/cell in the frame that `transform` leads to.

    `transform` is the pose (x m, y m, theta rad) of the grid's frame in the target frame; a bent map is straightened
    by its `warp` before. Render a map once, from its own frame: a second resampling ruins thin walls. Raises
    Unmergeable for a target that cannot be.
    """
    x, y, theta = (float(v) for v in np.asarray(transform, np.float64))
    if not (max(abs(x), abs(y)) < MAX_REACH_M and math.isfinite(theta) and 1e-3 <= resolution <= 1e3):
        raise Unmergeable(f"cannot render onto {resolution} m/cell by {x, y, theta}: check the transform")
    source, origin = grid.dense()
    if not source.any():
        return Grid(resolution)
    source, origin = crop(source, origin)
    forward = _affine(x / resolution, y / resolution, theta, grid.resolution / resolution)
    c, s = math.cos(theta), math.sin(theta)
    back = (-(c * x + s * y) / grid.resolution, -(c * y - s * x) / grid.resolution)
    backward = _affine(*back, -theta, resolution / grid.resolution)
    bend = lattice(warp, grid.resolution) if warp is not None else STRAIGHT
    target_origin, shape = _extent(source.shape[1:], origin, forward, bend)
    target = np.zeros((2, *shape), np.uint16)
    _backward(source, np.array(origin), backward, target, np.array(target_origin), *bend)
    walls = np.argwhere(occupancy(source) == 100)
    nearest = np.full(shape, np.iinfo(np.int64).max)
    _forward(source, np.array(origin), walls, forward, target, np.array(target_origin), nearest, *bend)
    rendered = Grid(resolution)
    rendered.replace(tiles_of(target, target_origin))
    return rendered


def crop(counts: Dense, origin: tuple[int, int]) -> tuple[Dense, tuple[int, int]]:
    """Counts (2, h, w), not all zero, cut down to what is visited, with the cell of the new [.., 0, 0]."""
    rows, columns = np.flatnonzero(counts[1].any(axis=1)), np.flatnonzero(counts[1].any(axis=0))
    y0, y1, x0, x1 = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    return np.ascontiguousarray(counts[:, y0:y1, x0:x1]), (origin[0] + x0, origin[1] + y0)


def _affine(x: float, y: float, theta: float, scale: float) -> NDArray[np.int64]:
    """(2, 3) fixed point: rotation times half a cell, and translation, in cells of the target of the map."""
    c, s = math.cos(theta) * scale / 2, math.sin(theta) * scale / 2
    return np.array([[round(v * (1 << SHIFT)) for v in row] for row in ((c, -s, x), (s, c, y))], np.int64)


def _extent(
    shape: tuple[int, ...], origin: tuple[int, int], forward: NDArray[np.int64], bend: Lattice
) -> tuple[tuple[int, int], tuple[int, int]]:
    """(first cell (x, y), shape (h, w)) of the target around the mapped corners of the source."""
    slack = -((-int(np.abs(bend.shifts).max(initial=0))) >> SHIFT)
    x0, y0, x1, y1 = origin[0] - slack, origin[1] - slack, origin[0] + shape[1] + slack, origin[1] + shape[0] + slack
    corners = 2 * np.array([[x0, x1, x0, x1], [y0, y0, y1, y1]])
    cells = (forward[:, :2] @ corners + forward[:, 2:]) >> SHIFT
    low, high = cells.min(axis=1) - 1, cells.max(axis=1) + 2
    width, height = (int(v) for v in high - low)
    check_size(width, height)
    return (int(low[0]), int(low[1])), (height, width)


@njit(cache=True)
def _backward(
    source: Counts,
    origin: NDArray[np.int64],
    affine: NDArray[np.int64],
    target: Counts,
    target_origin: NDArray[np.int64],
    first: NDArray[np.int64],
    spacing: int,
    shifts: NDArray[np.int64],
) -> None:
    """Each target cell takes the counts of the source cell that its centre falls in."""
    height, width = source.shape[1:]
    for row in range(target.shape[1]):
        v = 2 * (row + target_origin[1]) + 1
        for column in range(target.shape[2]):
            u = 2 * (column + target_origin[0]) + 1
            x = affine[0, 0] * u + affine[0, 1] * v + affine[0, 2]
            y = affine[1, 0] * u + affine[1, 1] * v + affine[1, 2]
            if len(shifts):
                bx, by = shift_at(x, y, first, spacing, shifts)
                bx, by = shift_at(x - bx, y - by, first, spacing, shifts)  # where it came from, to a fraction of it
                x, y = x - bx, y - by
            x, y = (x >> SHIFT) - origin[0], (y >> SHIFT) - origin[1]
            if 0 <= x < width and 0 <= y < height:
                target[0, row, column] = source[0, y, x]
                target[1, row, column] = source[1, y, x]


@njit(cache=True)
def _forward(
    source: Counts,
    origin: NDArray[np.int64],
    walls: NDArray[np.int64],
    affine: NDArray[np.int64],
    target: Counts,
    target_origin: NDArray[np.int64],
    nearest: NDArray[np.int64],
    first: NDArray[np.int64],
    spacing: int,
    shifts: NDArray[np.int64],
) -> None:
    """Each wall sample claims the target cell it falls in; of several, the one nearest to the cell's centre."""
    height, width = source.shape[1:]
    occupied = np.zeros((height + 2, width + 2), np.bool_)
    for k in range(len(walls)):
        occupied[walls[k, 0] + 1, walls[k, 1] + 1] = True
    half = 1 << (SHIFT - 1)
    for k in range(len(walls)):
        row, column = walls[k]
        u, v = 2 * (column + origin[0]) + 1, 2 * (row + origin[1]) + 1
        bx, by = 0, 0
        if len(shifts):
            bx, by = shift_at(u << (SHIFT - 1), v << (SHIFT - 1), first, spacing, shifts)
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if not occupied[row + 1 + dy, column + 1 + dx]:
                    continue
                ex, ey = (2 * (dx * ARM + bx)) >> 16, (2 * (dy * ARM + by)) >> 16
                x = affine[0, 0] * u + affine[0, 1] * v + affine[0, 2]
                y = affine[1, 0] * u + affine[1, 1] * v + affine[1, 2]
                x += ((affine[0, 0] >> 16) * ex + (affine[0, 1] >> 16) * ey) >> (SHIFT - 32)
                y += ((affine[1, 0] >> 16) * ex + (affine[1, 1] >> 16) * ey) >> (SHIFT - 32)
                i, j = (x >> SHIFT), (y >> SHIFT)
                away = max(abs(x - (i << SHIFT) - half), abs(y - (j << SHIFT) - half))
                i, j = i - target_origin[0], j - target_origin[1]
                if 0 <= i < target.shape[2] and 0 <= j < target.shape[1] and away < nearest[j, i]:
                    nearest[j, i] = away
                    target[0, j, i] = source[0, row, column]
                    target[1, j, i] = source[1, row, column]
