"""A uniform grid over wall segments, in which rays are walked cell by cell: exact first hits, compiled.

The walk is the grid traversal of Amanatides and Woo (1987): a ray only meets the segments listed in the cells
that it passes, and ends in the first cell that holds a hit before the cell's far side. Importing this module
imports numba; nothing does so before the first ray is cast.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

MAX_CELLS = 1 << 22


@dataclass(frozen=True)
class SegmentIndex:
    """Segments (n, 4) with, for each cell of a grid, the list of those that touch it (CSR)."""

    segments: NDArray[np.float64]
    origin: NDArray[np.float64]
    """(2,) metres, lower left corner of cell (0, 0)"""
    cell: float
    """metres"""
    shape: tuple[int, int]
    """cells in y, in x"""
    starts: NDArray[np.int64]
    """(cells + 1,)"""
    members: NDArray[np.int32]

    @classmethod
    def of(cls, segments: NDArray[np.float64]) -> SegmentIndex:
        """Sort segments (n, 4) metres into cells of about half a metre, coarser for huge worlds."""
        ends = segments.reshape(-1, 2)
        low, high = ends.min(axis=0) - 0.01, ends.max(axis=0) + 0.01
        cell = max(0.5, float(np.sqrt(np.prod(high - low) / MAX_CELLS)))
        width, height = (int(n) for n in np.ceil((high - low) / cell))
        cells, members = [], []
        for number, (x0, y0, x1, y1) in enumerate(segments):
            found = _touched(np.array([x0, y0]) - low, np.array([x1, y1]) - low, cell, (height, width))
            cells.append(found)
            members.append(np.full(len(found), number, np.int32))
        flat = np.concatenate(cells)
        order = np.argsort(flat, kind="stable")
        starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=width * height))]).astype(np.int64)
        return cls(np.ascontiguousarray(segments), low, cell, (height, width), starts, np.concatenate(members)[order])

    def cast(self, origins: NDArray[np.float64], angles: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
        """Distance (n,) in metres along each ray to the first wall, +inf when none is nearer than `limit`.

        Ray i starts at `origins[i]` (n, 2) metres and points at `angles[i]` rad, in the world's frame.
        """
        return cast_rays(
            self.segments, self.origin, self.cell, self.shape[0], self.shape[1], self.starts, self.members,
            np.ascontiguousarray(origins, dtype=np.float64), np.ascontiguousarray(angles, dtype=np.float64), limit,
        )  # fmt: skip


def _touched(a: NDArray[np.float64], b: NDArray[np.float64], cell: float, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Flat numbers of the cells that the segment a-b passes, with those within a millimetre of it."""
    slack = 1e-3
    low = np.floor((np.minimum(a, b) - slack) / cell).astype(int)
    high = np.floor((np.maximum(a, b) + slack) / cell).astype(int)
    xs = np.arange(max(low[0], 0), min(high[0], shape[1] - 1) + 1)
    ys = np.arange(max(low[1], 0), min(high[1], shape[0] - 1) + 1)
    x, y = (v.ravel() for v in np.meshgrid(xs, ys))
    along = b - a
    length = float(np.hypot(*along))
    if length > 0:  # distance of a cell's centre to the line, against the cell's reach across it
        aside = np.abs(along[0] * ((y + 0.5) * cell - a[1]) - along[1] * ((x + 0.5) * cell - a[0])) / length
        near = aside <= cell / 2 * float(np.abs(along).sum()) / length + slack
        x, y = x[near], y[near]
    return np.asarray(y * shape[1] + x, dtype=np.int64)


def cast_rays_numpy(
    segments: NDArray[np.float64], origins: NDArray[np.float64], angles: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """The same as `SegmentIndex.cast`, every ray against every segment: slow, plain, the kernel's reference."""
    dx, dy = np.cos(angles)[:, None], np.sin(angles)[:, None]
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    fx, fy = segments[:, 0] - origins[:, :1], segments[:, 1] - origins[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = dx * ey - dy * ex
        distance = (fx * ey - fy * ex) / across
        share = (fx * dy - fy * dx) / across
        hit = (distance >= 0) & (distance < limit) & (share >= -1e-9) & (share <= 1 + 1e-9)
    return np.where(hit, distance, np.inf).min(axis=1)


@njit(cache=True)
def cast_rays(segments, origin, cell, rows, columns, starts, members, origins, angles, limit):  # type: ignore[no-untyped-def]
    out = np.empty(len(angles))
    for ray in range(len(angles)):
        ox, oy = origins[ray, 0], origins[ray, 1]
        dx, dy = np.cos(angles[ray]), np.sin(angles[ray])
        out[ray] = _first_hit(segments, origin, cell, rows, columns, starts, members, ox, oy, dx, dy, limit)
    return out


@njit(cache=True)
def _first_hit(segments, origin, cell, rows, columns, starts, members, ox, oy, dx, dy, limit):  # type: ignore[no-untyped-def]
    enter, leave = _clip(ox - origin[0], dx, columns * cell, 0.0, limit)
    enter, leave = _clip(oy - origin[1], dy, rows * cell, enter, leave)
    if enter > leave:
        return np.inf
    px, py = ox - origin[0] + enter * dx, oy - origin[1] + enter * dy
    column = min(max(int(np.floor(px / cell)), 0), columns - 1)
    row = min(max(int(np.floor(py / cell)), 0), rows - 1)
    next_x, delta_x, step_x = _pace(ox - origin[0], dx, column, cell)
    next_y, delta_y, step_y = _pace(oy - origin[1], dy, row, cell)
    best = np.inf
    while True:
        here = row * columns + column
        for k in range(starts[here], starts[here + 1]):
            distance = _meet(segments[members[k]], ox, oy, dx, dy)
            if distance < best and distance < limit:
                best = distance
        far = min(next_x, next_y)
        if best <= far or far > leave:
            return best
        if next_x < next_y:
            column += step_x
            next_x += delta_x
        else:
            row += step_y
            next_y += delta_y
        if column < 0 or row < 0 or column >= columns or row >= rows:
            return best


@njit(cache=True)
def _clip(position, direction, extent, enter, leave):  # type: ignore[no-untyped-def]
    """The stretch of the ray that lies within [0, extent] on one axis."""
    if abs(direction) < 1e-15:
        return (enter, leave) if 0.0 <= position <= extent else (1.0, 0.0)
    a, b = -position / direction, (extent - position) / direction
    return max(enter, min(a, b)), min(leave, max(a, b))


@njit(cache=True)
def _pace(position, direction, cell_number, cell):  # type: ignore[no-untyped-def]
    """Distance along the ray to the next cell border on one axis, between borders, and the step taken there."""
    if direction > 1e-15:
        return ((cell_number + 1) * cell - position) / direction, cell / direction, 1
    if direction < -1e-15:
        return (cell_number * cell - position) / direction, -cell / direction, -1
    return np.inf, np.inf, 0


@njit(cache=True)
def _meet(segment, ox, oy, dx, dy):  # type: ignore[no-untyped-def]
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    fx, fy = segment[0] - ox, segment[1] - oy
    across = dx * ey - dy * ex
    if across == 0.0:
        return np.inf
    distance = (fx * ey - fy * ex) / across
    share = (fx * dy - fy * dx) / across
    if distance < 0.0 or share < -1e-9 or share > 1.0 + 1e-9:
        return np.inf
    return distance
