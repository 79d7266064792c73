"""The particles' maps as what they are made from, and made again.

They follow from the tree of trajectories: each hit is a point of a registered scan at a particle's pose. Only the hits
of settled scans, which the tree has forgotten, are kept, and are the same for all particles: one map, `settled`. All
else is counted again in the same order, which gives the same maps bit for bit. Particles' centroids are all different
and of random digits, so there is no smaller way to tell them, and none that takes less time when a state is asked for.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.edge_worker.slam.gmapping.particle_tree import Generation, Pose
from services.edge_worker.slam.gmapping.patch_map import PatchMap
from services.edge_worker.slam.gmapping.patch_pool import CELLS, NONE, PatchPool, enough_for


def settle(settled: PatchMap, fixed: Iterable[tuple[Pose, Generation]]) -> None:
    """Generations are leaving the tree's branches, oldest first: count their hits in the map of one particle."""
    for pose, generation in fixed:
        if len(generation.points):
            settled.cover_scan(generation.points, pose[None])
            settled.add(generation.points, pose[None], nearest=False)


def replayed(
    maps: PatchMap, branches: Iterable[Generation], corner: NDArray[np.int64], shape: list[int], particles: int
) -> PatchMap:
    """What a copy of the settled map becomes by the hits of all generations since, in a table of `shape` patches.

    Raises ValueError when these do not belong together.
    """
    maps.lay_out(corner.copy(), *shape)
    for generation in branches:
        if len(generation.poses) != len(generation.parents):
            raise ValueError("a generation has not as many poses as parents")
        if not np.array_equal(generation.parents, np.arange(len(maps.table))):
            maps.resample(generation.parents)
        maps.add(generation.points, generation.poses, nearest=False)
    if len(maps.table) != particles:
        raise ValueError(f"there are maps of {len(maps.table)} particles, not of {particles}")
    maps.find_near()
    return maps


def state(settled: PatchMap) -> dict[str, Any]:
    """One particle's map, as msgpack and arrays take it.

    places (k,): index in the table where there is a patch. hits (k, CELLS); mean (m, 2) of the cells with hits.
    """
    places = np.flatnonzero(settled.table[0] != NONE)
    used = settled.table[0].ravel()[places]
    hits = settled.pool.hits[used]
    mean = settled.pool.mean[used][hits > 0]
    return {
        "corner": settled.corner,
        "shape": list(settled.table.shape[1:]),
        "places": places,
        "hits": hits,
        "mean": mean,
    }


def restored(state: dict[str, Any], resolution_m: float) -> PatchMap:
    """The inverse of `state`, but for `near`. Raises ValueError when the arrays do not belong together."""
    places, hits, mean, (height, width) = state["places"], state["hits"], state["mean"], state["shape"]
    size = len(places)
    whole = hits.shape == (size, CELLS) and mean.shape == (np.count_nonzero(hits), 2)
    if not whole or (size and not 0 <= places.min() <= places.max() < height * width):
        raise ValueError("the settled map is not all there")
    maps, pool = PatchMap(1, resolution_m), PatchPool(enough_for(size))
    table = np.full((1, height, width), NONE, np.int32)
    table.reshape(-1)[places] = np.arange(1, size + 1)
    pool.hits[1 : size + 1] = hits
    pool.mean[1 : size + 1] = 0
    pool.mean[1 : size + 1][hits > 0] = mean
    maps.corner, maps.table, maps.pool = state["corner"].copy(), pool.only(table), pool
    return maps
