"""Promises of the particles' shared endpoint maps, held against plain numpy."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

from services.edge_worker.slam.gmapping.hill_climb import climb, fit, misfit, rotate, search
from services.edge_worker.slam.gmapping.patch_map import PatchMap
from services.edge_worker.slam.gmapping.patch_pool import (
    COARSER,
    FAR,
    MEAN_BITS,
    MOST_HITS,
    NEAR_BITS,
    NEAR_UNIT,
    NONE,
    SHRINK,
    SIDE,
)

RESOLUTION = 0.05


def a_map(particles: int = 2, radius: float = 4.0) -> PatchMap:
    maps = PatchMap(particles, RESOLUTION)
    maps.cover(np.full(2, -radius), np.full(2, radius))
    return maps


def walls(rng: np.random.Generator, n: int = 300) -> np.ndarray:
    """Points (n, 2) on the walls of a 4 x 3 m room with a step in one wall, a little noise on them."""
    corners = np.array([[-2, -1.5], [2, -1.5], [2, 0.3], [1.4, 0.3], [1.4, 1.5], [-2, 1.5], [-2, -1.5]])
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    way = rng.uniform(0, lengths.sum(), n)
    ends = np.cumsum(lengths)
    side = np.searchsorted(ends, way)
    share = (1 - (ends[side] - way) / lengths[side])[:, None]
    points = corners[side] * (1 - share) + corners[side + 1] * share
    return (points + rng.normal(0, 0.005, points.shape)).astype(np.float32)


def dense(maps: PatchMap, particle: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """hits (h, w), mean (h, w, 2) and near (h, w, 2) of one particle, rows along y."""
    table = maps.table[particle]
    out = []
    for plane in (maps.pool.hits[table][..., None], maps.pool.mean[table], maps.pool.near[table]):
        tiles = plane.reshape(*table.shape, SIDE, SIDE, plane.shape[-1]).transpose(0, 2, 1, 3, 4)
        out.append(tiles.reshape(table.shape[0] * SIDE, table.shape[1] * SIDE, plane.shape[-1]))
    return out[0][..., 0], out[1], out[2]


def near_twin(hits: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Distance from each inner cell's centre to the nearest centroid of the 3 x 3 cells around, in 2^-7 cells."""
    best = np.full((hits.shape[0] - 2, hits.shape[1] - 2), np.inf)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            window = np.s_[1 + dy : hits.shape[0] - 1 + dy, 1 + dx : hits.shape[1] - 1 + dx]
            offset = (np.array([dx, dy]) << NEAR_BITS) + (mean[window].astype(int) >> COARSER) - (1 << NEAR_BITS - 1)
            best = np.where(hits[window] > 0, np.minimum(best, np.hypot(offset[..., 0], offset[..., 1])), best)
    return best


def test_hits_and_centroids_are_those_of_plain_numpy() -> None:
    points = walls(np.random.default_rng(1))
    maps = a_map(1)
    maps.add(points, np.zeros((1, 3)))
    hits, mean, _ = dense(maps, 0)
    cells = points.astype(np.float64) / RESOLUTION - maps.corner
    index = np.floor(cells).astype(int)
    count = np.zeros(hits.shape, int)
    np.add.at(count, (index[:, 1], index[:, 0]), 1)
    assert (hits == np.minimum(count, MOST_HITS)).all()
    total = np.zeros((*hits.shape, 2))
    np.add.at(total, (index[:, 1], index[:, 0]), cells - index)
    some = (count > 0) & (count < MOST_HITS)
    assert np.abs(mean[some] / 2**MEAN_BITS - total[some] / count[some][:, None]).max() < 1e-3


def test_the_nearest_centroid_is_what_a_search_from_scratch_finds() -> None:
    rng = np.random.default_rng(2)
    maps = a_map(3)
    for _ in range(4):
        maps.add(walls(rng, 120), rng.normal(0, [0.1, 0.1, 0.05], (3, 3)))
        maps.resample(np.array([0, 0, 2]))
    for particle in range(3):
        hits, mean, near = dense(maps, particle)
        wanted = near_twin(hits, mean)
        inner = near[1:-1, 1:-1]
        found = np.hypot(*(inner.astype(int) - (1 << NEAR_BITS - 1)).transpose(2, 0, 1))
        nothing = (inner == FAR).all(axis=-1)
        assert (nothing == np.isinf(wanted)).all()
        np.testing.assert_allclose(found[~nothing], wanted[~nothing])


def test_a_copied_map_is_shared_until_one_of_the_two_is_written() -> None:
    rng = np.random.default_rng(3)
    maps = a_map(2)
    maps.add(walls(rng), np.array([[0.0, 0, 0], [0.5, 0, 0]]))
    apart = maps.held
    maps.resample(np.array([0, 0]))
    assert maps.held < apart
    assert (maps.pool.holders[maps.table[maps.table != NONE]] == 2).all()
    before = dense(maps, 0)
    maps.add(np.array([[1.0, 1.0]], np.float32), np.array([[0.0, 0, 0], [9.0, 0, 0]])[:1])
    assert not np.array_equal(dense(maps, 0)[0], before[0])
    assert all(np.array_equal(a, b) for a, b in zip(dense(maps, 1), before, strict=True))


def test_patches_that_no_particle_holds_are_used_again() -> None:
    rng = np.random.default_rng(4)
    maps = a_map(8)
    sizes = []
    for _ in range(30):
        maps.add(walls(rng, 60), rng.normal(0, [0.3, 0.3, 0.3], (8, 3)))
        maps.resample(np.zeros(8, int))
        sizes.append(len(maps.pool.holders))
    assert sizes[-1] == sizes[3]
    assert maps.held == len(np.unique(maps.table[maps.table != NONE]))


def test_a_grown_table_and_pool_hold_what_was_there() -> None:
    rng = np.random.default_rng(5)
    maps, twin = a_map(6, 3.0), a_map(6, 60.0)
    poses = rng.normal(0, [0.2, 0.2, 1.0], (6, 3))
    for shift in (0.0, -12.0, 25.0):
        poses[:, 0] += shift
        maps.cover(poses[:, :2].min(axis=0) - 5, poses[:, :2].max(axis=0) + 5)
        points = walls(rng)
        maps.add(points, poses)
        twin.add(points, poses)
    for particle in range(6):
        hits, other = dense(maps, particle)[0], dense(twin, particle)[0]
        y, x = np.argwhere(hits)[:, 0] + maps.corner[1], np.argwhere(hits)[:, 1] + maps.corner[0]
        assert hits.sum() == other.sum()
        assert (other[y - twin.corner[1], x - twin.corner[0]] == hits[hits > 0]).all()


def test_fit_and_misfit_are_those_of_plain_numpy() -> None:
    rng = np.random.default_rng(6)
    maps = a_map(1)
    maps.add(walls(rng), np.zeros((1, 3)))
    _, _, near = dense(maps, 0)
    cells = maps.to_table(rng.uniform(-3.5, 3.5, (400, 2)))
    index = np.floor(cells).astype(int)
    square = np.square(near[index[:, 1], index[:, 0]] * NEAR_UNIT - (cells - index)).sum(axis=1)
    table = maps.table[0]
    assert fit(cells, 0.0, 0.0, table, maps.pool.near, 3.0) == pytest.approx(np.maximum(1 - square / 9, 0).sum())
    cost, found = misfit(cells, 0.0, 0.0, table, maps.pool.near, 2.0, 1.5)
    assert found == (square < 9).sum()
    assert cost == pytest.approx(np.where(square < 9, np.minimum(square / 8, 1.5), 1.5).sum())


def test_points_off_the_table_score_nothing() -> None:
    maps = a_map(1)
    far = np.array([[-1e4, 3.0], [3.0, -1e4], [1e4, 3.0], [3.0, 1e4], [-0.5, 5.0]])
    assert fit(far, 0.0, 0.0, maps.table[0], maps.pool.near, 3.0) == 0.0
    assert misfit(far, 0.0, 0.0, maps.table[0], maps.pool.near, 1.0, 2.0) == (10.0, 0)


@pytest.mark.parametrize("offset", [(0.06, -0.04, 0.03), (-0.2, 0.25, -0.1)])
def test_a_scan_finds_back_to_where_it_was_taken(offset: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(7)
    maps = a_map(1)
    for _ in range(5):
        maps.add(walls(rng), np.zeros((1, 3)))
    points = walls(rng, 180) / RESOLUTION
    start = np.array([*maps.to_table(np.array(offset[:2])), offset[2]])
    free = np.zeros(2)
    near = search(points, start, free, 6, 6, 0.03, maps.table[0], maps.pool.near, 3.0)
    x, y, theta, score = climb(points, near, near, free, 1.0, 0.05, 5, maps.table[0], maps.pool.near, 3.0)
    assert np.abs(maps.to_metres(np.array([x, y]))).max() < 0.01
    assert abs(theta) < 0.006
    turned = np.empty_like(points)
    rotate(points, theta, turned)
    assert score == pytest.approx(fit(turned, x, y, maps.table[0], maps.pool.near, 3.0))


def same_maps(a: PatchMap, b: PatchMap) -> bool:
    return all(
        np.array_equal(x, y)
        for particle in range(len(a.table))
        for x, y in zip(dense(a, particle), dense(b, particle), strict=True)
    )


def test_a_pool_that_is_mostly_free_shrinks_and_keeps_the_maps() -> None:
    rng = np.random.default_rng(9)
    maps = a_map(12, 9.0)
    for _ in range(6):
        maps.add(walls(rng), rng.normal(0, [2.0, 2.0, 1.0], (12, 3)))
    twin = deepcopy(maps)
    large, crowded = maps.pool.nbytes, maps.held
    maps.resample(np.zeros(12, int))
    assert maps.held * SHRINK < crowded
    assert maps.pool.nbytes < large / 2
    for particle in range(12):
        assert all(np.array_equal(a, b) for a, b in zip(dense(maps, particle), dense(twin, 0), strict=True))
    maps.add(walls(rng), rng.normal(0, [2.0, 2.0, 1.0], (12, 3)))
    for particle in range(12):
        hits, mean, near = dense(maps, particle)
        inner = near[1:-1, 1:-1].astype(int)
        wanted = near_twin(hits, mean)
        found = np.hypot(*(inner - (1 << NEAR_BITS - 1)).transpose(2, 0, 1))
        np.testing.assert_allclose(found[np.isfinite(wanted)], wanted[np.isfinite(wanted)])


def test_a_grown_pool_holds_what_was_there_and_numbers_stay() -> None:
    rng = np.random.default_rng(10)
    maps = a_map(4)
    maps.add(walls(rng), rng.normal(0, [0.2, 0.2, 0.5], (4, 3)))
    twin, table, size = deepcopy(maps), maps.table.copy(), maps.held
    maps.pool.grow()
    assert np.array_equal(maps.table, table)
    assert maps.held == size
    assert same_maps(maps, twin)
    fresh = maps.pool.free[: maps.pool.spare[0]]
    assert sorted([*fresh, *np.unique(table)]) == list(range(len(maps.pool.holders)))


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_equally_near_centroids_the_same_one_counts_whichever_came_first(first: int) -> None:
    both = np.array([[0.525, 0.525], [0.425, 0.525]], np.float32)  # to both sides of the cell between them
    maps = a_map(1)
    maps.add(both[[first, 1 - first]], np.zeros((1, 3)))
    x, y = np.array([9, 10]) - maps.corner
    assert dense(maps, 0)[2][y, x, 0] < 0
    kept = dense(maps, 0)
    maps.find_near()
    assert all(np.array_equal(a, b) for a, b in zip(dense(maps, 0), kept, strict=True))


@pytest.mark.parametrize("low", [0.0, -50.0])
def test_where_a_hit_lies_in_its_cell_does_not_depend_on_how_far_the_table_reaches(low: float) -> None:
    x = 3 * RESOLUTION
    while x / RESOLUTION >= 3:
        x = np.nextafter(x, 0)  # in the third cell, by so little that an offset of some cells would round it off
    maps = PatchMap(1, RESOLUTION)
    maps.cover(np.full(2, low), np.full(2, 1.0))
    maps.add(np.zeros((1, 2), np.float32), np.array([[x, 0.02, 0.0]]))
    hits, mean, _ = dense(maps, 0)
    assert (np.argwhere(hits)[:, ::-1] + maps.corner == [[2, 0]]).all()
    assert mean[hits > 0][0, 0] == 2**MEAN_BITS - 1


def test_a_hit_off_the_table_is_refused_and_harms_nothing() -> None:
    for where in (1e3, -1e3, np.nan):
        with pytest.raises(ValueError, match="off the map"):
            a_map(1).add(np.full((1, 2), where, np.float32), np.zeros((1, 3)))
