"""A map of small wall pieces to match scans against, and the likelihood field of the same points.

Both live on a torus: cell (i, j) is kept at (i mod size, j mod size), so the map has no border and nothing moves
as the robot goes on; what lies more than a torus apart must not be in it together. A surfel is the mean of the
points and normals that fell into one cell from one side: a thin wall has one on each face, a corner two.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.scan import Points

CELL = 0.1
"""m, of surfels"""
FINE = 0.05
"""m, of the likelihood field"""
SPREAD = 0.075
"""m, standard deviation of the likelihood around a point"""
REACH = 3
"""fine cells around a point that its likelihood reaches"""
SAME_SIDE = 0.5
"""cosine between normals that belong to one surfel"""


def _splat() -> NDArray[np.uint8]:
    squares = (np.arange(-REACH, REACH + 1) * FINE) ** 2
    return np.rint(255 * np.exp(-(squares[:, None] + squares) / (2 * SPREAD**2))).astype(np.uint8)


SPLAT = _splat()


class SurfelMap:
    """Surfels and likelihood field of the keyframes inserted since the last `clear`."""

    def __init__(self, size: int) -> None:
        """`size` cells of the torus each way, a power of two."""
        self.index = np.full((size, size), -1, np.int32)
        """first surfel of each cell, -1 for none"""
        self.sums = np.zeros((4096, 5))
        """(capacity, 5): points, their sum of x and y, of normal x and y"""
        self.chain = np.empty(4096, np.int32)
        """next surfel of the same cell, -1 for none"""
        self.cells = np.empty((4096, 2), np.int32)
        """cell (i, j) of each surfel"""
        self.count = 0
        self.field = np.zeros((2 * size, 2 * size), np.uint8)
        """likelihood of an end per fine cell, 255 at a point"""

    def clear(self) -> None:
        forget(self.index, self.cells[: self.count], self.field)
        self.count = 0

    def insert(self, points: Points, normals: Points, pose: NDArray[np.float64]) -> None:
        """Add points (n, 2) with normals (n, 2), given in the frame of `pose` (3,)."""
        while self.count + len(points) > len(self.sums):
            self.sums = np.concatenate([self.sums, np.zeros_like(self.sums)])
            self.chain = np.concatenate([self.chain, np.empty_like(self.chain)])
            self.cells = np.concatenate([self.cells, np.empty_like(self.cells)])
        self.count = insert(
            self.index, self.sums, self.chain, self.cells, self.count, self.field, SPLAT, points, normals, pose
        )

    def slots(self, points: Points, normals: Points, pose: NDArray[np.float64]) -> NDArray[np.int64]:
        """The surfels (m,) of points (n, 2) with normals (n, 2) that were inserted in the frame of `pose` (3,)."""
        return slots(self.index, self.sums, self.chain, points, normals, pose)


@njit(cache=True)
def forget(index: NDArray[np.int32], cells: NDArray[np.int32], field: NDArray[np.uint8]) -> None:
    """Empty what insertion has filled."""
    mask = len(index) - 1
    for k in range(len(cells)):
        index[cells[k, 1] & mask, cells[k, 0] & mask] = -1
    field[:] = 0


@njit(cache=True)
def insert(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    cells: NDArray[np.int32],
    count: int,
    field: NDArray[np.uint8],
    splat: NDArray[np.uint8],
    points: Points,
    normals: Points,
    pose: NDArray[np.float64],
) -> int:
    """Add points to surfels and field; returns the number of surfels."""
    mask = len(index) - 1
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for k in range(len(points)):
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        _lay(field, splat, int(np.floor(x / FINE)), int(np.floor(y / FINE)))
        nx = c * normals[k, 0] - s * normals[k, 1]
        ny = s * normals[k, 0] + c * normals[k, 1]
        if nx == 0.0 and ny == 0.0:
            continue
        i, j = int(np.floor(x / CELL)), int(np.floor(y / CELL))
        slot = at(index, sums, chain, i, j, nx, ny)
        if slot < 0:
            slot = count
            count += 1
            sums[slot] = 0.0
            cells[slot, 0], cells[slot, 1] = i, j
            chain[slot] = index[j & mask, i & mask]
            index[j & mask, i & mask] = slot
        sums[slot, 0] += 1.0
        sums[slot, 1] += x
        sums[slot, 2] += y
        sums[slot, 3] += nx
        sums[slot, 4] += ny
    return count


@njit(cache=True)
def slots(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    points: Points,
    normals: Points,
    pose: NDArray[np.float64],
) -> NDArray[np.int64]:
    """The surfels of the cells that points (n, 2) with normals (n, 2), of the frame of `pose` (3,), lie in."""
    count = 0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    out = np.empty(len(points), np.int64)
    for k in range(len(points)):
        nx, ny = c * normals[k, 0] - s * normals[k, 1], s * normals[k, 0] + c * normals[k, 1]
        if nx == 0.0 and ny == 0.0:
            continue
        i = int(np.floor((pose[0] + c * points[k, 0] - s * points[k, 1]) / CELL))
        j = int(np.floor((pose[1] + s * points[k, 0] + c * points[k, 1]) / CELL))
        slot = at(index, sums, chain, i, j, nx, ny)
        if slot >= 0:
            out[count] = slot
            count += 1
    return out[:count]


@njit(cache=True)
def at(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    i: int,
    j: int,
    nx: float,
    ny: float,
) -> int:
    """The surfel of cell (i, j) that faces as (nx, ny) does; -1 for none."""
    mask = len(index) - 1
    slot = index[j & mask, i & mask]
    while slot >= 0 and not faces(sums, slot, nx, ny):
        slot = chain[slot]
    return int(slot)


@njit(cache=True)
def met(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    x: float,
    y: float,
    nx: float,
    ny: float,
) -> tuple[int, float, float, float]:
    """The surfel (-1 for none) that a point at (x, y) with a normal meets, its normal, and m off its line."""
    slot = nearest(index, sums, chain, x, y, nx, ny)
    if slot < 0:
        return -1, 0.0, 0.0, 0.0
    norm = np.hypot(sums[slot, 3], sums[slot, 4])
    wx, wy = sums[slot, 3] / norm, sums[slot, 4] / norm
    return slot, wx, wy, wx * (x - sums[slot, 1] / sums[slot, 0]) + wy * (y - sums[slot, 2] / sums[slot, 0])


@njit(cache=True)
def nearest(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    x: float,
    y: float,
    nx: float,
    ny: float,
) -> int:
    """The surfel with the nearest mean in the 3 x 3 cells around (x, y) that faces as (nx, ny) does; -1 for none."""
    mask = len(index) - 1
    i, j = int(np.floor(x / CELL)), int(np.floor(y / CELL))
    found, best = -1, np.inf
    for row in range(j - 1, j + 2):
        for column in range(i - 1, i + 2):
            slot = index[row & mask, column & mask]
            while slot >= 0:
                if faces(sums, slot, nx, ny):
                    dx, dy = x - sums[slot, 1] / sums[slot, 0], y - sums[slot, 2] / sums[slot, 0]
                    square = dx * dx + dy * dy
                    if square < best:
                        found, best = slot, square
                slot = chain[slot]
    return found


@njit(cache=True)
def faces(sums: NDArray[np.float64], slot: int, nx: float, ny: float) -> bool:
    """Does a surfel face as (nx, ny) does, give or take?"""
    along = nx * sums[slot, 3] + ny * sums[slot, 4]
    return bool(along > SAME_SIDE * np.hypot(sums[slot, 3], sums[slot, 4]))


@njit(cache=True)
def _lay(field: NDArray[np.uint8], splat: NDArray[np.uint8], i: int, j: int) -> None:
    """Raise the likelihood around fine cell (i, j)."""
    mask, reach = len(field) - 1, len(splat) // 2
    for dj in range(-reach, reach + 1):
        row = (j + dj) & mask
        for di in range(-reach, reach + 1):
            column = (i + di) & mask
            field[row, column] = max(field[row, column], splat[dj + reach, di + reach])
