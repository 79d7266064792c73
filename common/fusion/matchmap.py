"""One robot map prepared for matching: everything that matching needs, derived once from free, occupied, unknown.

The trinary raster is what travels as a sketch, so nothing here may need more than it. All of it is deterministic:
equal rasters give equal bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.errors import Unmergeable
from common.fusion.features import Features, find_features
from common.fusion.nearest import NearestWall, nearest_wall
from common.fusion.walls import Walls, find_walls, orientation_histogram
from common.grid.grid import FREE, STOOD, UNKNOWN, Grid
from common.grid.raster import sketched

MARGIN_M = 0.6
"""unknown border kept around the known area, so that walls at its edge have a full neighbourhood"""
REACH_M = 0.5
"""how far the nearest wall is looked for; no matching step looks farther"""
MAX_SAMPLES = 1500
"""wall points taken for refining and judging; more add time and no certainty"""
FIRST_SAMPLES = 300
"""those of them that a first look takes"""
PLACE_M = 1.0
"""squares of the map that sampled walls are ordered by"""


@dataclass(frozen=True, eq=False)
class MatchMap:
    """An occupancy raster with what is derived from it; make it with `of` or `from_grid`."""

    occupancy: NDArray[np.int8]
    """(h, w) -1 unknown, 0 free, 100 occupied, row 0 the lowest y, cropped to the known area with a margin"""
    origin_cell: tuple[int, int]
    """absolute cell (x, y) of [0, 0]"""
    resolution: float
    """m per cell"""
    ground: NDArray[np.int8]
    """as `occupancy`, but 1 where the robot itself stood: a wall that the other map has there is this robot"""
    _features: dict[int, Features] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, occupancy: NDArray[np.int8], origin_cell: tuple[int, int], resolution: float) -> MatchMap:
        """A map from a raster (h, w) of -1, 0, 1 (see STOOD), 100. Raises Unmergeable when it is no such raster."""
        if occupancy.ndim != 2 or not resolution > 0:
            raise Unmergeable(f"a map needs a raster (h, w) and a resolution > 0, got {occupancy.shape}, {resolution}")
        known = occupancy != UNKNOWN
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        if not len(rows):
            return cls(np.full((1, 1), UNKNOWN), origin_cell, resolution, np.full((1, 1), UNKNOWN))
        margin = round(MARGIN_M / resolution)
        y0, y1, x0, x1 = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
        ground = np.pad(occupancy[y0:y1, x0:x1].astype(np.int8), margin, constant_values=UNKNOWN)
        cropped = np.where(ground == STOOD, FREE, ground)
        for cells in (ground, cropped):
            cells.setflags(write=False)
        return cls(cropped, (origin_cell[0] + x0 - margin, origin_cell[1] + y0 - margin), resolution, ground)

    @classmethod
    def from_grid(cls, grid: Grid) -> MatchMap:
        """A map from hit and visit counts."""
        counts, origin = grid.dense()
        return cls.of(sketched(counts), origin, grid.resolution)

    @cached_property
    def origin(self) -> NDArray[np.float64]:
        """(2,) m, lower left corner of cell [0, 0] in the map frame."""
        return np.asarray(self.origin_cell, np.float64) * self.resolution

    @cached_property
    def known_cells(self) -> int:
        return int(np.count_nonzero(self.occupancy != UNKNOWN))

    @cached_property
    def known_m2(self) -> float:
        return self.known_cells * self.resolution**2

    @cached_property
    def walls(self) -> Walls:
        return find_walls(self.occupancy, self.origin, self.resolution)

    @cached_property
    def wall_m(self) -> float:
        """Length of wall, m: cells along it, whatever its thickness (the count of 0.2 m cells it passes)."""
        x, y = np.floor((self.walls.points - self.origin) / 0.2).astype(np.int64).T + 1
        passed = np.zeros((y.max(initial=0) + 1, x.max(initial=0) + 1), np.bool_)
        passed[y, x] = True
        return 0.2 * int(np.count_nonzero(passed))

    @cached_property
    def sample(self) -> Walls:
        """Walls spread evenly over the map, at most MAX_SAMPLES; the first FIRST_SAMPLES of them are so too.

        Both parts are ordered by place, so that looking them up in another map touches its memory in turn.
        """
        n = len(self.walls.points)
        chosen = np.random.default_rng(n).permutation(n)[:MAX_SAMPLES]
        parts = (chosen[:FIRST_SAMPLES], chosen[FIRST_SAMPLES:])
        return self.walls.at(np.concatenate([part[self._by_place(part)] for part in parts]))

    def _by_place(self, walls: NDArray[np.int64]) -> NDArray[np.int64]:
        """The order of the walls with these indices that goes through the map square by square."""
        rows, columns = self.walls.cells[walls].T // max(1, round(PLACE_M / self.resolution))
        return np.lexsort((walls, columns, rows))

    @cached_property
    def nearest(self) -> NearestWall:
        """The nearest wall of every cell, up to REACH_M."""
        return nearest_wall(self.occupancy.shape, self.walls.cells, self.resolution, REACH_M)

    @cached_property
    def histogram(self) -> NDArray[np.float64]:
        return orientation_histogram(self.walls)

    @cached_property
    def free_points(self) -> NDArray[np.float64]:
        """(n, 2) m: centres of free cells, one of every 2 x 2."""
        return _free_centres(self.occupancy, self.origin, self.resolution)

    def features(self, count: int) -> Features:
        """At most `count` ORB key points; found once per count."""
        if count not in self._features:
            self._features[count] = find_features(self.occupancy, self.origin, self.resolution, count)
        return self._features[count]


@njit(cache=True)
def _free_centres(occupancy: NDArray[np.int8], origin: NDArray[np.float64], resolution: float) -> NDArray[np.float64]:
    """(n, 2) m, row by row: centres of the free cells in even rows and columns."""
    count = 0
    for y in range(0, occupancy.shape[0], 2):
        for x in range(0, occupancy.shape[1], 2):
            count += occupancy[y, x] == FREE
    centres, k = np.empty((count, 2)), 0
    for y in range(0, occupancy.shape[0], 2):
        for x in range(0, occupancy.shape[1], 2):
            if occupancy[y, x] == FREE:
                centres[k, 0], centres[k, 1] = origin[0] + (x + 0.5) * resolution, origin[1] + (y + 0.5) * resolution
                k += 1
    return centres
