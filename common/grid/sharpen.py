"""Range noise spreads a wall's hits over the cells before and behind it; the cell that the wall is in has most.

Before a cell of the wall many beams pass, so it is free by its counts. Behind it only the long ones come, which all
end there: by its counts it would be wall. So a cell with far fewer hits than a neighbour is published without them;
its visits stay. Two faces of one thin wall, each seen from its own side, have hits of the same order and both stay.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.grid.grid import TILE, Counts, TileKey

SHARE = (2, 5)
"""of the hits of the most hit cell among the eight around it, below which a cell's hits count as spread"""


def sharpened(tiles: dict[TileKey, Counts], key: TileKey) -> Counts:
    """The tile's counts (2, 64, 64) without spread hits; its neighbours are looked up in `tiles`."""
    hits = np.zeros((TILE + 2, TILE + 2), np.uint16)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            tile = tiles.get((key[0] + dx, key[1] + dy))
            if tile is not None:
                hits[_to(dy), _to(dx)] = tile[0, _from(dy), _from(dx)]
    return np.stack([keep_peaks(hits), tiles[key][1]])


def _to(step: int) -> slice:
    """Rows (or columns) of the padded array that a neighbour at `step` fills."""
    return (slice(0, 1), slice(1, TILE + 1), slice(TILE + 1, TILE + 2))[step + 1]


def _from(step: int) -> slice:
    """Rows (or columns) of a neighbour at `step` that touch the tile."""
    return (slice(TILE - 1, TILE), slice(0, TILE), slice(0, 1))[step + 1]


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
