"""The sketch of a robot map: its cells as unknown, free, stood on or occupied, tiled and versioned like the counts.

It is all that matching two maps needs and takes a tenth of the bytes of the counts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common.grid.grid import STOOD, TILE, UNKNOWN, Grid, TileKey, check_size, occupancy
from common.grid.standing import certain

Cells = NDArray[np.int8]


def sketched(counts: NDArray[np.unsignedinteger]) -> Cells:
    """Counts (2, ...) as cells of a sketch."""
    cells = occupancy(counts)
    cells[certain(counts)] = STOOD
    return cells


@dataclass
class Raster:
    """Tiles of int8 (64, 64) on the lattice of `resolution` m: -1, 0, 1 (free, the robot itself stood here) and 100."""

    resolution: float
    tiles: dict[TileKey, Cells] = field(default_factory=dict)
    version: int = 0
    changed: dict[TileKey, int] = field(default_factory=dict)
    seen: int = 0
    """version of the grid that `follow` has taken in"""

    def replace(self, tiles: Iterable[tuple[TileKey, Cells]]) -> None:
        """Set whole tiles and mark them with the next version."""
        version = self.version + 1
        for key, cells in tiles:
            self.tiles[key] = cells
            self.changed[key] = self.version = version

    def follow(self, grid: Grid) -> None:
        """Take in what has changed in `grid` since the last call; equal tiles keep their version."""
        fresh = [(key, sketched(grid.tiles[key])) for key in grid.delta(self.seen)]
        self.seen = grid.version
        self.replace(
            (key, cells) for key, cells in fresh if key not in self.tiles or not np.array_equal(self.tiles[key], cells)
        )

    def dense(self) -> tuple[Cells, tuple[int, int]]:
        """(height, width), row 0 the lowest y, and the cell (x, y) of its [0, 0].

        Raises Unmergeable when the tiles lie too far apart.
        """
        if not self.tiles:
            return np.full((1, 1), UNKNOWN), (0, 0)
        keys = np.array(list(self.tiles))
        low, high = keys.min(axis=0).tolist(), keys.max(axis=0).tolist()
        width, height = ((last + 1 - first) * TILE for first, last in zip(low, high, strict=True))
        check_size(width, height)
        out = np.full((height, width), UNKNOWN)
        for (x, y), cells in self.tiles.items():
            row, column = (y - low[1]) * TILE, (x - low[0]) * TILE
            out[row : row + TILE, column : column + TILE] = cells
        return out, (low[0] * TILE, low[1] * TILE)
