"""Free space: where a robot's centre may be, on a raster, and the shortest ways through it, compiled."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from common.sim.world import Point, World

MAX_CELLS = 4_000_000


@dataclass(frozen=True)
class FreeSpace:
    """Cells whose centres keep a clearance from every wall, whether or not they can be reached."""

    free: NDArray[np.bool_]
    """(height, width), row 0 the lowest y"""
    origin: NDArray[np.float64]
    """(2,) m, lower left corner of cell [0, 0]"""
    resolution: float

    @classmethod
    def of(cls, world: World, clearance: float, resolution: float = 0.1) -> FreeSpace:
        """Rasterise a world: free is what lies `clearance` metres or more from walls. Coarser when it is huge."""
        x0, y0, x1, y1 = world.bounds
        resolution = max(resolution, float(np.sqrt((x1 - x0) * (y1 - y0) / MAX_CELLS)))
        shape = (int(np.ceil((y1 - y0) / resolution)), int(np.ceil((x1 - x0) / resolution)))
        free = np.ones(shape, bool)
        block_cells(free, world.segments, x0, y0, resolution, clearance)
        return cls(free, np.array([x0, y0]), resolution)

    def cell(self, point: ArrayLike) -> tuple[int, int]:
        """(row, column) of the cell that holds a point (2,) in metres, the nearest border cell when outside."""
        column, row = np.floor((np.asarray(point) - self.origin) / self.resolution).astype(int)
        height, width = self.free.shape
        return int(np.clip(row, 0, height - 1)), int(np.clip(column, 0, width - 1))

    def centres(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """Centres (n, 2) in metres of cells given by their flat numbers (n,)."""
        rows, columns = np.divmod(cells, self.free.shape[1])
        return self.origin + (np.stack([columns, rows], axis=-1) + 0.5) * self.resolution

    def ways(self, start: Point, reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Free cells within `reach` metres of driving from `start`, and for each cell the one before it (-1: none).

        Returns flat numbers of the cells reached, nearest first, and parents (height * width,).
        """
        row, column = self.cell(start)
        return shortest_ways(self.free, row, column, reach / self.resolution)

    def open_line(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
        """The straight line between two points (2,) passes free cells only."""
        steps = int(np.ceil(np.hypot(*(b - a)) / (self.resolution / 4))) + 1
        points = a + np.linspace(0, 1, steps)[:, None] * (b - a)
        columns, rows = np.floor((points - self.origin) / self.resolution).astype(int).T
        return bool(self.free[rows, columns].all())


@njit(cache=True)
def block_cells(free, segments, x0, y0, resolution, clearance):  # type: ignore[no-untyped-def]
    height, width = free.shape
    for ax, ay, bx, by in segments:
        low_c = max(int((min(ax, bx) - clearance - x0) / resolution) - 1, 0)
        high_c = min(int((max(ax, bx) + clearance - x0) / resolution) + 2, width)
        low_r = max(int((min(ay, by) - clearance - y0) / resolution) - 1, 0)
        high_r = min(int((max(ay, by) + clearance - y0) / resolution) + 2, height)
        ex, ey = bx - ax, by - ay
        square = max(ex * ex + ey * ey, 1e-12)
        for row in range(low_r, high_r):
            for column in range(low_c, high_c):
                px, py = x0 + (column + 0.5) * resolution - ax, y0 + (row + 0.5) * resolution - ay
                share = min(max((px * ex + py * ey) / square, 0.0), 1.0)
                dx, dy = px - share * ex, py - share * ey
                if dx * dx + dy * dy < clearance * clearance:
                    free[row, column] = False


@njit(cache=True)
def shortest_ways(free, row, column, reach):  # type: ignore[no-untyped-def]
    """Dijkstra over 8 neighbours; `reach` in cells."""
    height, width = free.shape
    cost = np.full(height * width, np.inf)
    parents = np.full(height * width, -1, np.int64)
    done = np.zeros(height * width, np.bool_)
    order = np.empty(height * width, np.int64)
    count = 0
    start = np.int64(row * width + column)
    cost[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        so_far, here = heapq.heappop(heap)
        if done[here]:
            continue
        done[here] = True
        order[count] = here
        count += 1
        r, c = here // width, here % width
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                nr, nc = r + dr, c + dc
                if nr < 0 or nc < 0 or nr >= height or nc >= width or not free[nr, nc]:
                    continue
                there = nr * width + nc
                total = so_far + np.sqrt(float(dr * dr + dc * dc))
                if total <= reach and total < cost[there]:
                    cost[there] = total
                    parents[there] = here
                    heapq.heappush(heap, (total, there))
    return order[:count].copy(), parents
