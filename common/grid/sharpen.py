"""Range noise spreads a wall's hits over the cells before and behind it; the cell that the wall is in has most.

Before a cell of the wall many beams pass, so it is free by its counts. Behind it only the long ones come, which all
end there: by its counts it would be wall. So a cell with far fewer hits than a neighbour is published without them;
its visits stay. Two faces of one thin wall, each seen from its own side, have hits of the same order and both stay.

Farther behind, where single beams end, there are specks: few hits, with few around them, next to a wall of many. They
go, too. What is small and stands near a wall has hits all around its outline, and the beams that pass it to the wall
are fewer the larger it is: together its hits are more than the tenth part.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.grid.grid import TILE, Counts, TileKey

SHARE = (2, 5)
"""of the hits of the most hit cell among the eight around it, below which a cell's hits count as spread"""


REACH = 3
"""cells around within which a wall makes a speck of few hits: as far as lasers that err by 6 cm throw single ends"""
SPECK = 10
"""times as many hits as a speck and its eight neighbours together has the most hit cell within reach"""
MARGIN = REACH + 1
"""cells around a tile that its cells depend on"""


def sharpened(tiles: dict[TileKey, Counts], key: TileKey) -> Counts:
    """The tile's counts (2, 64, 64) without spread hits; its neighbours are looked up in `tiles`."""
    hits = np.zeros((TILE + 2 * MARGIN, TILE + 2 * MARGIN), np.uint16)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            tile = tiles.get((key[0] + dx, key[1] + dy))
            if tile is not None:
                hits[_to(dy), _to(dx)] = tile[0, _from(dy), _from(dx)]
    return np.stack([drop_specks(keep_peaks(hits)), tiles[key][1]])


def _to(step: int) -> slice:
    """Rows (or columns) of the padded array that a neighbour at `step` fills."""
    return (slice(0, MARGIN), slice(MARGIN, TILE + MARGIN), slice(TILE + MARGIN, TILE + 2 * MARGIN))[step + 1]


def _from(step: int) -> slice:
    """Rows (or columns) of a neighbour at `step` that are near the tile."""
    return (slice(TILE - MARGIN, TILE), slice(0, TILE), slice(0, MARGIN))[step + 1]


@njit(cache=True)
def keep_peaks(hits: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The inner (h - 2, w - 2) of hits (h, w), zero where a neighbour has more than 5/2 times as many."""
    height, width = hits.shape[0] - 2, hits.shape[1] - 2
    out = np.zeros((height, width), np.uint16)
    for y in range(height):
        for x in range(width):
            here = hits[y + 1, x + 1]
            if here == 0:
                continue
            most = here
            for v in range(y, y + 3):
                for u in range(x, x + 3):
                    most = max(most, hits[v, u])
            if SHARE[1] * np.int64(here) >= SHARE[0] * np.int64(most):
                out[y, x] = here
    return out


@njit(cache=True)
def drop_specks(hits: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The inner (h - 2 REACH, w - 2 REACH) of hits (h, w), zero where there are specks."""
    height, width = hits.shape[0] - 2 * REACH, hits.shape[1] - 2 * REACH
    out = np.zeros((height, width), np.uint16)
    for y in range(height):
        for x in range(width):
            here = hits[y + REACH, x + REACH]
            if here == 0:
                continue
            around, most = np.int64(0), np.int64(0)
            for v in range(y, y + 2 * REACH + 1):
                for u in range(x, x + 2 * REACH + 1):
                    most = max(most, np.int64(hits[v, u]))
                    if abs(v - y - REACH) <= 1 and abs(u - x - REACH) <= 1:
                        around += np.int64(hits[v, u])
            if SPECK * around >= most:
                out[y, x] = here
    return out
