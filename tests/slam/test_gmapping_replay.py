"""Promises of the particles' maps made again from their trajectories."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_gmapping_maps import RESOLUTION, same_maps, walls

from services.edge_worker.slam.gmapping import patch_state
from services.edge_worker.slam.gmapping.particle_tree import Generation, ParticleTree
from services.edge_worker.slam.gmapping.patch_map import PatchMap
from services.edge_worker.slam.scan import NO_POINTS

N = 5


def filtered(scans: int = 20) -> tuple[PatchMap, ParticleTree, PatchMap]:
    """Maps of N particles that were resampled every third scan, their tree, and what of it is settled."""
    rng = np.random.default_rng(3)
    maps, settled, tree = PatchMap(N, RESOLUTION), PatchMap(1, RESOLUTION), ParticleTree()
    for scan in range(scans):
        parents = np.sort(rng.integers(0, 3, N)) if scan % 3 == 2 else np.arange(N)
        poses, points = rng.normal([1.5 * scan, 0, 0], [0.1, 0.1, 0.05], (N, 3)), walls(rng)
        maps.resample(parents)
        maps.cover(poses[:, :2].min(axis=0) - 4, poses[:, :2].max(axis=0) + 4)
        maps.add(points, poses)
        tree.append(Generation(poses, parents if scan else np.zeros(N, int), points, NO_POINTS, np.zeros(2)))
        patch_state.settle(settled, tree.settle())
    return maps, tree, settled


def again(maps: PatchMap, tree: ParticleTree, settled: PatchMap) -> PatchMap:
    copy = patch_state.restored(patch_state.state(settled), RESOLUTION)
    return patch_state.replayed(copy, tree.branches, maps.corner, list(maps.table.shape[1:]), N)


def test_maps_made_again_are_the_same_bit_for_bit_and_continue_like_the_originals() -> None:
    maps, tree, settled = filtered()
    assert tree.settled
    assert len(tree.branches) > 3
    twin = again(maps, tree, settled)
    assert twin.held == maps.held
    assert same_maps(twin, maps)
    rng = np.random.default_rng(4)
    more, poses = walls(rng), rng.normal([28.5, 0, 0], 0.1, (N, 3))
    for each in (maps, twin):
        each.add(more, poses)
        each.resample(np.array([0, 2, 2, 3, 3]))
    assert same_maps(twin, maps)


def test_maps_are_not_made_from_what_does_not_belong_together() -> None:
    maps, tree, settled = filtered()
    told, last = patch_state.state(settled), tree.branches[-1]
    for name, value in (("hits", told["hits"][:-1]), ("mean", told["mean"][1:]), ("places", told["places"] + 10**6)):
        with pytest.raises(ValueError, match="settled map"):
            patch_state.restored({**told, name: value}, RESOLUTION)
    for wrong, what in (
        (replace(last, poses=last.poses[1:]), "poses"),
        (replace(last, poses=last.poses + 1e3), "off the map"),
        (replace(last, parents=last.parents[:-1], poses=last.poses[:-1]), "particles"),
    ):
        tree.branches[-1] = wrong
        with pytest.raises(ValueError, match=what):
            again(maps, tree, settled)
