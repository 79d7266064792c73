"""Counting scans into tiles: what a beam ends in is hit, what it passes is visited.

A scan counts a cell once, however many of its beams meet it, and a hit wins over a pass. Between the ends of two
neighbouring beams there may be wall: the cells there count as neither. Else beams that graze a wall eat it, each
passing several of its cells before it ends in one. Where both are known to lie on one surface (`joined`), the cells
between are hit as well. Counts are sums of whole numbers, so scans can be drawn in any order
and taken away again, and the result is the same bit for bit (until a cell saturates: then both counts freeze).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.grid import TILE, Grid, TileKey
from common.grid.grid import SATURATED
from common.grid.sharpen import sharpened
from services.edge_worker.slam.scan import NO_POINTS, Points

NOWHERE = np.empty(0, np.bool_)
"""no two ends are joined"""
UNSEEN, PASSED, HIT = np.uint8(0), np.uint8(1), np.uint8(2)
NEIGHBOURS = np.tan(np.radians(3.5))
"""tangent of the angle within which two beams that end are neighbours; lasers have 0.25 to 2 degrees between beams"""


class Canvas:
    """Tiled counts of the scans drawn so far."""

    def __init__(self, resolution: float) -> None:
        """`resolution` in metres per cell."""
        self.resolution = resolution
        self.tiles: dict[TileKey, NDArray[np.uint16]] = {}
        self.touched: set[TileKey] = set()
        """tiles that changed since the last `publish`"""

    def draw(
        self,
        pose: NDArray[np.float64],
        points: Points,
        laser: NDArray[np.float64],
        silent: Points = NO_POINTS,
        times: int = 1,
        joined: NDArray[np.bool_] = NOWHERE,
    ) -> None:
        """Count a scan taken at `pose` (3,): ends (n, 2) and `laser` (2,) in the base frame; `times=-1` takes it away.

        `silent` (m, 2) are ends of beams that met nothing: passed, not hit. There is wall from the ends that are
        `joined` (n,) to the next one.
        """
        if len(points) + len(silent) == 0:
            return
        patch, x0, y0 = trace(pose, points, silent, laser, self.resolution, joined)
        height, width = patch.shape
        for ty in range(y0 // TILE, (y0 + height - 1) // TILE + 1):
            for tx in range(x0 // TILE, (x0 + width - 1) // TILE + 1):
                self._count(patch, x0, y0, (tx, ty), times)

    def clear(self) -> None:
        """Take everything away; the emptied tiles stay, as zeros."""
        for key, tile in self.tiles.items():
            tile[:] = 0
            self.touched.add(key)

    def publish(self, grid: Grid) -> None:
        """Bring `grid` up to date, walls sharpened: one new version, for the tiles whose counts differ."""
        grid.replace_if_different((key, sharpened(self.tiles, key)) for key in sorted(self.stale()))
        self.touched.clear()

    def stale(self) -> set[TileKey]:
        """Tiles that may be published otherwise: those that changed since, and their neighbours."""
        around = {(x + dx, y + dy) for x, y in self.touched for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
        return around & self.tiles.keys()

    def _count(self, patch: NDArray[np.uint8], x0: int, y0: int, key: TileKey, times: int) -> None:
        tile = self.tiles.get(key)
        if tile is None:
            tile = np.zeros((2, TILE, TILE), np.uint16)
        if add(tile, patch, key[0] * TILE - x0, key[1] * TILE - y0, times):
            self.tiles[key] = tile
            self.touched.add(key)


@njit(cache=True)
def trace(
    pose: NDArray[np.float64],
    points: Points,
    silent: Points,
    laser: NDArray[np.float64],
    resolution: float,
    joined: NDArray[np.bool_],
) -> tuple[NDArray[np.uint8], int, int]:
    """One scan on its own patch: uint8 (height, width) of UNSEEN, PASSED and HIT, and the cell (x, y) of its [0, 0].

    Rays run cell by cell from the laser to each end (the slab walk of Amanatides and Woo, 1987).
    """
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ox = (pose[0] + c * laser[0] - s * laser[1]) / resolution
    oy = (pose[1] + s * laser[0] + c * laser[1]) / resolution
    n, m = len(points), len(silent)
    ends = np.empty((n + m, 2))
    for i in range(n + m):
        px, py = (points[i, 0], points[i, 1]) if i < n else (silent[i - n, 0], silent[i - n, 1])
        ends[i, 0] = (pose[0] + c * px - s * py) / resolution
        ends[i, 1] = (pose[1] + s * px + c * py) / resolution
    x0 = int(np.floor(min(ox, ends[:, 0].min())))
    y0 = int(np.floor(min(oy, ends[:, 1].min())))
    width = int(np.floor(max(ox, ends[:, 0].max()))) - x0 + 1
    height = int(np.floor(max(oy, ends[:, 1].max()))) - y0 + 1
    patch = np.zeros((height, width), np.uint8)
    for i in range(n + m):
        _walk(patch, x0, y0, (ox, oy), ends[i], PASSED)
        if i >= n:
            patch[int(np.floor(ends[i, 1])) - y0, int(np.floor(ends[i, 0])) - x0] = PASSED
    for i in range(n):
        after = (i + 1) % n
        if _neighbours(points[i] - laser, points[after] - laser):
            _walk(patch, x0, y0, (ends[i, 0], ends[i, 1]), ends[after], UNSEEN)
    for i in range(n):
        if len(joined) and joined[i]:
            _walk(patch, x0, y0, (ends[i, 0], ends[i, 1]), ends[(i + 1) % n], HIT)
        patch[int(np.floor(ends[i, 1])) - y0, int(np.floor(ends[i, 0])) - x0] = HIT
    return patch, x0, y0


@njit(cache=True)
def _neighbours(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Are two beams (2,) so near in angle that one surface may have stopped both?"""
    return bool(abs(a[0] * b[1] - a[1] * b[0]) <= NEIGHBOURS * (a[0] * b[0] + a[1] * b[1]))


@njit(cache=True)
def _walk(
    patch: NDArray[np.uint8], x0: int, y0: int, start: tuple[float, float], end: NDArray[np.float64], mark: np.uint8
) -> None:
    """Mark the cells from `start` to before the last one, in which `end` (2,) lies. All in cells of the lattice.

    Cells are found before the patch's corner is taken off: the difference of two floats may round up to a cell
    that neither lies in.
    """
    (x, y), end_x, end_y = start, end[0], end[1]
    i, j = int(np.floor(x)) - x0, int(np.floor(y)) - y0
    last_i, last_j = int(np.floor(end_x)) - x0, int(np.floor(end_y)) - y0
    dx, dy = end_x - x, end_y - y
    step_i, step_j = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    per_i = abs(1.0 / dx) if dx != 0.0 else np.inf
    per_j = abs(1.0 / dy) if dy != 0.0 else np.inf
    next_i = ((i + x0 + 1 - x) if dx > 0 else (x - i - x0)) * per_i if dx != 0.0 else np.inf
    next_j = ((j + y0 + 1 - y) if dy > 0 else (y - j - y0)) * per_j if dy != 0.0 else np.inf
    for _ in range(abs(last_i - i) + abs(last_j - j)):
        patch[j, i] = mark
        if (next_i < next_j and i != last_i) or j == last_j:
            next_i += per_i
            i += step_i
        else:
            next_j += per_j
            j += step_j


@njit(cache=True)
def add(tile: NDArray[np.uint16], patch: NDArray[np.uint8], x: int, y: int, times: int) -> bool:
    """Add `times` (1 or -1) the patch to a tile (2, 64, 64) whose [.., 0, 0] is the patch's (x, y).

    Returns whether any cell of the tile was met.
    """
    met = False
    for row in range(max(0, -y), min(TILE, patch.shape[0] - y)):
        for column in range(max(0, -x), min(TILE, patch.shape[1] - x)):
            mark = patch[y + row, x + column]
            if mark == 0:
                continue
            met = True
            if tile[1, row, column] == SATURATED:
                continue
            tile[1, row, column] = np.uint16(tile[1, row, column] + times)
            if mark == HIT:
                tile[0, row, column] = np.uint16(tile[0, row, column] + times)
    return met
