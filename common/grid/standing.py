"""Where a robot has stood nothing else can be, whatever the other robots took it for.

To others a robot that stands still is a small wall: they see it again and again, while its own map, which knows the
place as free, grows by few visits meanwhile. So the robot's own map says it for certain: cells that it saw free close
to where it stood, and those under its body, hold no hits and all visits there can be (`CERTAIN`), and adding maps keeps
that (see compose.py). Sketches tell it as well, for a wall of another map that lies there says nothing about how two
maps fit (see common/fusion/evidence.py). What only drives past leaves few hits, which ordinary visits outweigh. SLAM
itself never sees these marks.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.grid.grid import OCCUPIED_RATIO, SATURATED, TILE, Counts, Grid, TileKey

STOOD_S = 2.0
"""s in one place that make it one where the robot has stood; a turn on the spot may be one"""
STILL_M = 0.1
"""m that it may creep meanwhile"""
NEAR_M = 0.5
"""m around such a place that belong to the robot, if it saw them free: larger than most are"""
BODY_M = 0.25
"""m around such a place that count as free unseen, where no wall is so close: beams without an echo clear nothing"""
CERTAIN = SATURATED
"""visits, with no hits, of a cell that is free for certain"""

Places = NDArray[np.float64]
"""(k, 2) m in the map's frame"""


def stands(trajectory: NDArray[np.float64]) -> Places:
    """The mean place of each stay in a trajectory, rows (stamp s, x m, y m, theta rad)."""
    stays = _stays(np.ascontiguousarray(trajectory, np.float64))
    return np.array([trajectory[first:after, 1:3].mean(axis=0) for first, after in stays]).reshape(-1, 2)


@njit(cache=True)
def _stays(trajectory: NDArray[np.float64]) -> NDArray[np.int64]:
    """(k, 2) first row of each stay and the row after its last."""
    stays = []
    first = 0
    for row in range(len(trajectory) + 1):
        if row < len(trajectory):
            x, y = trajectory[row, 1] - trajectory[first, 1], trajectory[row, 2] - trajectory[first, 2]
            if x * x + y * y <= STILL_M * STILL_M:
                continue
        if row > first and trajectory[row - 1, 0] - trajectory[first, 0] >= STOOD_S:
            stays.append((first, row))
        first = row
    out = np.empty((len(stays), 2), np.int64)
    for k, (begin, end) in enumerate(stays):
        out[k, 0], out[k, 1] = begin, end
    return out


def certain(counts: NDArray[np.unsignedinteger]) -> NDArray[np.bool_]:
    """Which cells of counts (2, ...) are free for certain."""
    return (counts[1] == CERTAIN) & (counts[0] == 0)


class MarkedMap:
    """A robot's map with its stands marked; follows the kernel's map, which stays as it is."""

    def __init__(self, resolution: float, version: int) -> None:
        self.grid = Grid(resolution, version=version)
        self._seen = 0
        """version of the kernel's map taken in"""
        self._places = np.empty((0, 2))

    def follow(self, grid: Grid, places: Places) -> None:
        """Take in what has changed in `grid` and of the stands since the last call; equal tiles keep their version."""
        keys = set(grid.delta(self._seen))
        if not np.array_equal(places, self._places):
            keys |= {
                *_tiles_near(places, grid.resolution),
                *_tiles_near(self._places, grid.resolution),
            } & grid.tiles.keys()
        self._seen, self._places = grid.version, places
        self.grid.replace_if_different(
            (key, marked(grid.tiles[key], key, places, grid.resolution)) for key in sorted(keys)
        )


def marked(counts: Counts, key: TileKey, places: Places, resolution: float) -> Counts:
    """A tile's counts (2, 64, 64) with what it saw free near `places` marked for certain."""
    side = TILE * resolution
    low = np.array(key) * side
    beyond = np.maximum(low - places, places - low - side)
    close = places[(beyond <= NEAR_M).all(axis=1)]
    if not len(close):
        return counts
    x, y = ((low[axis] + (np.arange(TILE) + 0.5) * resolution) for axis in (0, 1))
    square = np.full((TILE, TILE), np.inf)
    for place in close:
        square = np.minimum(square, (x[None, :] - place[0]) ** 2 + (y[:, None] - place[1]) ** 2)
    seen, wall, body = counts[1] > 0, counts[0] > OCCUPIED_RATIO * counts[1], square <= BODY_M**2
    free = (square <= NEAR_M**2) & seen & ~wall
    if not (body & wall).any():
        free |= body & ~seen
    out = counts.copy()
    out[0, free], out[1, free] = 0, CERTAIN
    return out


def _tiles_near(places: Places, resolution: float) -> Iterator[TileKey]:
    side = TILE * resolution
    for place in places:
        (x0, y0), (x1, y1) = (np.floor((place + reach) / side).astype(int).tolist() for reach in (-NEAR_M, NEAR_M))
        yield from ((x, y) for x in range(x0, x1 + 1) for y in range(y0, y1 + 1))
