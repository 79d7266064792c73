"""Merging maps is adding counts: commutative, and one robot's ghost can be cleared by another's free space."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from common.errors import Unmergeable
from common.grid.grid import SATURATED, TILE, Counts, Grid, TileKey
from common.grid.sharpen import sharpened
from common.grid.standing import CERTAIN, certain


def add(grids: Iterable[Grid]) -> Grid:
    """The cell-wise sum of grids on one lattice, in the same bits whatever their order.

    Sums are exact; a cell whose visits exceed uint16 has both counts scaled down, so that its ratio stays. What one
    of them knows to be free for certain is free (see standing.py).
    Raises Unmergeable when resolutions differ: render the odd one onto the common lattice first.
    """
    grids = list(grids)
    if not grids:
        raise Unmergeable("no grids to add: leave out the merge, or give at least one grid")
    resolutions = sorted({grid.resolution for grid in grids})
    if len(resolutions) > 1:
        raise Unmergeable(f"grids of {resolutions} m/cell cannot be added: render them at one resolution first")
    sums: dict[TileKey, NDArray[np.uint32]] = {}
    sure: dict[TileKey, NDArray[np.bool_]] = {}
    for grid in grids:
        for key, counts in grid.tiles.items():
            sums.setdefault(key, np.zeros((2, TILE, TILE), np.uint32))[...] += counts
            if (known := certain(counts)).any():
                sure[key] = sure.get(key, False) | known
    for key, known in sure.items():
        sums[key][0, known], sums[key][1, known] = 0, CERTAIN
    merged = Grid(resolutions[0])
    merged.replace((key, saturate(sums[key])) for key in sorted(sums) if sums[key].any())
    return merged


def saturate(counts: NDArray[np.uint32]) -> Counts:
    """Counts (2, ...) as uint16; where visits do not fit, both are scaled so that the ratio stays."""
    if counts[1].max(initial=0) <= SATURATED:
        return counts.astype(np.uint16)
    wide = counts.astype(np.uint64)
    over = wide[1] > SATURATED
    wide[0, over] = (wide[0, over] * SATURATED + wide[1, over] // 2) // wide[1, over]
    wide[1, over] = SATURATED
    return wide.astype(np.uint16)


def cap_votes(grid: Grid, most: int) -> Grid:
    """The grid with at most `most` visits in a cell, ratios kept: a robot that stands still outvotes nobody.

    It also keeps the sum of 65535 / `most` robots exact in uint16, whatever the order and grouping of adding. What is
    free for certain stays so.
    """
    capped = Grid(grid.resolution)
    capped.replace((key, _capped(counts, most)) for key, counts in grid.tiles.items())
    return capped


def _capped(counts: Counts, most: int) -> Counts:
    over = (counts[1] > most) & ~certain(counts)
    if not over.any():
        return counts
    out = counts.astype(np.uint32)
    out[0, over] = (out[0, over] * most + out[1, over] // 2) // out[1, over]
    out[1, over] = most
    return out.astype(np.uint16)


def compose_into(product: Grid, parts: Iterable[Grid], *, sharpen: bool = False) -> None:
    """Make `product` the sum of `parts`; tiles that stay equal keep their version, vanished ones become zeros.

    `sharpen` the sum where it is the last one: maps that lie a fraction of a cell apart make walls two cells thick.
    A sharpened map must not be added to others, or the result would depend on the grouping.
    """
    parts = list(parts)
    merged = add(parts).tiles if parts else {}
    if sharpen:
        merged = {key: sharpened(merged, key) for key in merged}
    gone = {key: np.zeros((2, TILE, TILE), np.uint16) for key in product.tiles if key not in merged}
    product.replace_if_different([*sorted(merged.items()), *sorted(gone.items())])
