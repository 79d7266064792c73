"""A grid is a sparse set of 64 x 64 tiles of hit and visit counts, addressed by absolute cell index.

Cell (i, j) covers [i*r, (i+1)*r) x [j*r, (j+1)*r) metres of the grid's frame (i along x, j along y, r the
resolution), so the frame never moves as the grid grows. A tile is a uint16 array (2, 64, 64): plane 0 hits,
plane 1 visits (hits included), indexed [plane, y, x]. When a cell saturates, both counts freeze, so that
their ratio stays. Every change gives the grid a new version, kept per tile: a reader asks for what changed
since the version it has and *replaces* those tiles (an emptied tile is sent as zeros).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common.errors import Unmergeable

TILE = 64
SATURATED = np.iinfo(np.uint16).max
OCCUPIED_RATIO = 0.25
"""A cell is occupied when hits/visits exceeds this (GMapping's threshold)."""

MAX_CELLS = 1 << 28
"""largest map that is laid out as one array: 800 m by 800 m at 5 cm. One whose tiles lie farther apart is broken, and
must not take the memory of all others"""

TileKey = tuple[int, int]
Counts = NDArray[np.uint16]
Dense = NDArray[np.uint16]

UNKNOWN, FREE, OCCUPIED = np.int8(-1), np.int8(0), np.int8(100)
STOOD = np.int8(1)
"""in sketches: free, and the robot whose map it is has stood there"""


@dataclass
class Grid:
    """Counts on one lattice. `tiles[(tx, ty)]` covers cells [64 tx, 64 tx + 64) x [64 ty, 64 ty + 64)."""

    resolution: float
    """metres per cell"""
    tiles: dict[TileKey, Counts] = field(default_factory=dict)
    version: int = 0
    changed: dict[TileKey, int] = field(default_factory=dict)
    """the version at which each tile last changed"""

    def replace(self, tiles: Iterable[tuple[TileKey, Counts]]) -> None:
        """Set whole tiles and mark them with the next version; nothing given, nothing changes."""
        version = self.version + 1
        for key, counts in tiles:
            if counts.shape != (2, TILE, TILE) or counts.dtype != np.uint16:
                raise Unmergeable(f"tile {key} is {counts.dtype} {counts.shape}, not uint16 (2, 64, 64)")
            self.tiles[key] = counts
            self.changed[key] = self.version = version

    def replace_if_different(self, tiles: Iterable[tuple[TileKey, Counts]]) -> None:
        """Like `replace`, but tiles that already hold these counts keep their version."""
        self.replace(
            (key, counts)
            for key, counts in tiles
            if key not in self.tiles or not np.array_equal(self.tiles[key], counts)
        )

    def delta(self, since: int) -> list[TileKey]:
        """Keys of the tiles changed after version `since`, oldest change first, then by key."""
        keys = [key for key, version in self.changed.items() if version > since]
        return sorted(keys, key=lambda key: (self.changed[key], key))

    def bounds(self) -> tuple[int, int, int, int]:
        """(x0, y0, x1, y1) in cells around all tiles, upper ends excluded; (0, 0, 0, 0) when empty."""
        if not self.tiles:
            return 0, 0, 0, 0
        keys = np.array(list(self.tiles))
        (tx0, ty0), (tx1, ty1) = keys.min(axis=0), keys.max(axis=0) + 1
        return int(tx0) * TILE, int(ty0) * TILE, int(tx1) * TILE, int(ty1) * TILE

    def dense(self) -> tuple[Dense, tuple[int, int]]:
        """All tiles as one array (2, height, width) uint16, and the cell (x, y) of its [.., 0, 0].

        Raises Unmergeable when they lie too far apart.
        """
        x0, y0, x1, y1 = self.bounds()
        check_size(x1 - x0, y1 - y0)
        out = np.zeros((2, y1 - y0, x1 - x0), np.uint16)
        for (tx, ty), counts in self.tiles.items():
            y, x = ty * TILE - y0, tx * TILE - x0
            out[:, y : y + TILE, x : x + TILE] = counts
        return out, (x0, y0)

    def occupancy(self) -> tuple[NDArray[np.int8], tuple[int, int]]:
        """-1 unknown, 0 free, 100 occupied, (height, width), row 0 the lowest y, and the cell of [0, 0]."""
        dense, origin = self.dense()
        return occupancy(dense), origin

    def known_m2(self) -> float:
        """Area of the cells that have been visited, m²."""
        known = sum(int(np.count_nonzero(counts[1])) for counts in self.tiles.values())
        return known * self.resolution**2

    def digest(self) -> str:
        """SHA-256 over resolution and counts; equal for equal maps, however they came about."""
        sha = hashlib.sha256(np.float64(self.resolution).tobytes())
        for key in sorted(self.tiles):
            if self.tiles[key].any():
                sha.update(np.array(key, np.int64).tobytes())
                sha.update(np.ascontiguousarray(self.tiles[key]).tobytes())
        return sha.hexdigest()

    @classmethod
    def from_dense(cls, counts: Dense, origin: tuple[int, int], resolution: float) -> Grid:
        """A grid of the tiles in which `counts` (2, height, width) is not all zero."""
        grid = cls(resolution)
        grid.replace(tiles_of(counts, origin))
        return grid


def check_size(width: int, height: int) -> None:
    """Raises Unmergeable for more cells than are laid out as one array."""
    if width * height > MAX_CELLS:
        raise Unmergeable(f"a map of {width} x {height} cells is too large: choose a coarser one, or look for a jump")


def tiles_of(counts: Dense, origin: tuple[int, int]) -> Iterator[tuple[TileKey, Counts]]:
    """Cut a dense array (2, height, width) whose [.., 0, 0] is cell `origin` into its non-empty tiles."""
    x0, y0 = origin
    height, width = counts.shape[1:]
    left, low = x0 % TILE, y0 % TILE
    padded = np.zeros((2, -(-(height + low) // TILE) * TILE, -(-(width + left) // TILE) * TILE), np.uint16)
    padded[:, low : low + height, left : left + width] = counts
    for y in range(0, padded.shape[1], TILE):
        for x in range(0, padded.shape[2], TILE):
            tile = padded[:, y : y + TILE, x : x + TILE]
            if tile.any():
                yield ((x0 - left + x) // TILE, (y0 - low + y) // TILE), np.ascontiguousarray(tile)


def occupancy(counts: NDArray[np.unsignedinteger]) -> NDArray[np.int8]:
    """Counts (2, ...) as -1 unknown, 0 free, 100 occupied."""
    hits, visits = counts[0].astype(np.float32), counts[1].astype(np.float32)
    out = np.full(hits.shape, UNKNOWN)
    out[visits > 0] = FREE
    out[(visits > 0) & (hits > OCCUPIED_RATIO * visits)] = OCCUPIED
    return out
