"""The particles' maps as few small arrays and back.

Patches are told place by place, so that it does not matter which numbers they had, and where particles share them is a
short code. Of `near` only those cells are kept in which it is not what a search from scratch finds: two centroids were
equally near, and the one that came first stayed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.patch_map import PatchMap, off_centre
from services.edge_worker.slam.patch_pool import (
    CELLS,
    COARSER,
    FAR,
    LOW,
    NEAR_BITS,
    NONE,
    SHIFT,
    SIDE,
    PatchPool,
    enough_for,
)


def state(maps: PatchMap) -> dict[str, Any]:
    """Everything, as msgpack and arrays take it.

    places (k,): index in the table of one particle; codes (k, n) uint16: which of the place's patches each particle
    has, from 1 on, 0 for none. hits (patches, CELLS) in the order of places and codes; mean (m, 2) of the cells with
    hits. odd (l,): cells, counted through `hits`, in which `near` is odd_near (l, 2).
    """
    pool, particles = maps.pool, len(maps.table)
    places = np.flatnonzero((maps.table != NONE).any(axis=0))
    columns = np.ascontiguousarray(maps.table.reshape(particles, -1)[:, places].T)
    codes, used, owners, rows = numbered(columns, len(pool.holders), pool.held)
    odd = np.flatnonzero(differing(maps.table, used, owners, places[rows], pool.mean, pool.near, pool.hits))
    return {
        "corner": maps.corner,
        "shape": list(maps.table.shape[1:]),
        "places": places,
        "codes": codes,
        "hits": pool.hits[used],
        "mean": taken_out(used, pool.mean, pool.hits),
        "odd": odd,
        "odd_near": pool.near[used[odd // CELLS], odd % CELLS].view(np.uint16),
    }


def restored(state: dict[str, Any], particles: int, resolution_m: float) -> PatchMap:
    """The inverse of `state`. Raises ValueError when the arrays do not belong together."""
    places, codes, hits, mean, odd = (state[name] for name in ("places", "codes", "hits", "mean", "odd"))
    (height, width), patches = state["shape"], len(hits)
    most = codes.max(axis=1, initial=0).astype(np.int64)
    whole = codes.shape == (len(places), particles) and hits.shape == (most.sum(), CELLS)
    whole = whole and mean.shape == (np.count_nonzero(hits), 2) and state["odd_near"].shape == (len(odd), 2)
    if not whole or not within(places, height * width) or not within(odd, hits.size):
        raise ValueError("the particles' maps are not all there")
    maps, pool = PatchMap(particles, resolution_m), PatchPool(enough_for(patches))
    table = np.full((particles, height, width), NONE, np.int32)
    first = np.cumsum(most) - most
    table.reshape(particles, -1)[:, places] = np.where(codes > 0, first[:, None] + codes, NONE).T
    if len(pool.only(table)) != particles or pool.held != patches:
        raise ValueError("the particles' maps hold patches that no particle has")
    pool.hits[1 : patches + 1] = hits
    put_back(mean, pool.mean, pool.hits, patches)
    columns = np.ascontiguousarray(table.reshape(particles, -1)[:, places].T)
    _, used, owners, rows = numbered(columns, len(pool.holders), patches)
    find_all(table, used, owners, places[rows], pool.mean, pool.near, pool.hits)
    pool.near[1 + odd // CELLS, odd % CELLS] = state["odd_near"].view(np.int16)
    maps.corner, maps.table, maps.pool = state["corner"].copy(), table, pool
    return maps


def within(index: NDArray[np.int64], size: int) -> bool:
    return len(index) == 0 or bool(0 <= index.min() <= index.max() < size)


@njit(cache=True)
def numbered(columns, patches, held):  # type: ignore[no-untyped-def]
    """Number the patches of each place in the order of its particles: `columns` (k, n) holds their pool numbers.

    Returns codes (k, n) uint16 and, for each held patch in the order of places and codes, its number in the pool, a
    particle that has it, and the row of its place.
    """
    codes, code = np.zeros(columns.shape, np.uint16), np.zeros(patches, np.uint16)
    used, owners, rows = np.empty(held, np.int64), np.empty(held, np.int64), np.empty(held, np.int64)
    n = 0
    for row in range(columns.shape[0]):
        here = 0
        for particle in range(columns.shape[1]):
            number = columns[row, particle]
            if number == NONE:
                continue
            if code[number] == 0:
                here += 1
                code[number] = here
                used[n], owners[n], rows[n] = number, particle, row
                n += 1
            codes[row, particle] = code[number]
    return codes, used, owners, rows


@njit(cache=True)
def taken_out(used, mean, hits):  # type: ignore[no-untyped-def]
    """Centroids (m, 2) of the cells with hits of the patches `used`."""
    n = 0
    for number in used:
        n += int(np.count_nonzero(hits[number]))
    out = np.empty((n, 2), np.uint16)
    n = 0
    for number in used:
        for cell in range(CELLS):
            if hits[number, cell] > 0:
                out[n, 0], out[n, 1] = mean[number, cell, 0], mean[number, cell, 1]
                n += 1
    return out


@njit(cache=True)
def put_back(centroids, mean, hits, patches):  # type: ignore[no-untyped-def]
    """The inverse of `taken_out`, for the patches 1 to `patches`."""
    n = 0
    for number in range(1, patches + 1):
        for cell in range(CELLS):
            mean[number, cell, 0] = mean[number, cell, 1] = 0
            if hits[number, cell] > 0:
                mean[number, cell, 0], mean[number, cell, 1] = centroids[n, 0], centroids[n, 1]
                n += 1


@njit(cache=True)
def differing(tables, used, owners, places, mean, near, hits):  # type: ignore[no-untyped-def]
    """In which cells (patches * CELLS,) of the patches `used` is `near` not what `find_patch` finds?"""
    out, found = np.zeros(len(used) * CELLS, np.bool_), np.empty((CELLS, 2), np.int16)
    for k in range(len(used)):
        find_patch(tables[owners[k]], places[k], mean, hits, found)
        for cell in range(CELLS):
            out[k * CELLS + cell] = found[cell, 0] != near[used[k], cell, 0] or found[cell, 1] != near[used[k], cell, 1]
    return out


@njit(cache=True)
def find_all(tables, used, owners, places, mean, near, hits):  # type: ignore[no-untyped-def]
    """Set `near` of the patches `used` to what `find_patch` finds."""
    for k in range(len(used)):
        find_patch(tables[owners[k]], places[k], mean, hits, near[used[k]])


@njit(cache=True)
def find_patch(table, place, mean, hits, out):  # type: ignore[no-untyped-def]
    """`near` (CELLS, 2) of the patch at `place` of a table, as `find_near` would find it for each cell."""
    height, width = table.shape
    py, px = place // width, place % width
    best = np.full(CELLS, off_centre(int(FAR), int(FAR)))
    out[:] = FAR
    for j in range(-1, SIDE + 1):
        row = py + (j >> SHIFT)
        for column in range(max(px - 1, 0), min(px + 2, width)):
            number = table[row, column] if 0 <= row < height else NONE
            if number == NONE:
                continue
            left = (column - px) * SIDE
            for i in range(max(left, -1), min(left + SIDE, SIDE + 1)):
                cell = (j & LOW) * SIDE + i - left
                if hits[number, cell] == 0:
                    continue
                at_x, at_y = int(mean[number, cell, 0]) >> COARSER, int(mean[number, cell, 1]) >> COARSER
                for y in range(max(j - 1, 0), min(j + 2, SIDE)):
                    for x in range(max(i - 1, 0), min(i + 2, SIDE)):
                        dx, dy = ((i - x) << NEAR_BITS) + at_x, ((j - y) << NEAR_BITS) + at_y
                        away = off_centre(dx, dy)
                        if away < best[y * SIDE + x]:
                            best[y * SIDE + x] = away
                            out[y * SIDE + x, 0], out[y * SIDE + x, 1] = dx, dy
