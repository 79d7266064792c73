"""The sketch of a map."""

from __future__ import annotations

import numpy as np
import pytest

from common.errors import Unmergeable
from common.grid import Grid
from common.grid.compose import cap_votes, compose_into
from common.grid.raster import Raster


def tile(hits: int, visits: int) -> np.ndarray:
    return np.stack([np.full((64, 64), hits, np.uint16), np.full((64, 64), visits, np.uint16)])


def test_a_sketch_follows_its_map() -> None:
    grid, sketch = Grid(0.05), Raster(0.05)
    for hits, visits in ((0, 0), (0, 5), (4, 5)):
        grid.replace([((-1, 2), tile(hits, visits))])
        sketch.follow(grid)
        cells, origin = sketch.dense()
        wanted, at = grid.occupancy()
        assert origin == at
        assert np.array_equal(cells, wanted)


def test_counts_that_change_no_cell_leave_the_sketch_as_it_is() -> None:
    grid, sketch = Grid(0.05), Raster(0.05)
    grid.replace([((0, 0), tile(0, 5))])
    sketch.follow(grid)
    version = sketch.version
    grid.replace([((0, 0), tile(1, 9))])
    sketch.follow(grid)
    assert sketch.version == version


def test_an_empty_sketch_is_one_unknown_cell() -> None:
    cells, origin = Raster(0.05).dense()
    assert (cells.tolist(), origin) == ([[-1]], (0, 0))


def test_votes_are_capped_with_their_ratio() -> None:
    grid = Grid(0.05)
    grid.replace([((0, 0), tile(1000, 4000)), ((1, 0), tile(3, 9))])
    capped = cap_votes(grid, 255)
    assert capped.tiles[0, 0][:, 0, 0].tolist() == [64, 255]
    assert capped.tiles[1, 0][:, 0, 0].tolist() == [3, 9]


def test_the_sum_does_not_depend_on_how_parts_are_grouped() -> None:
    rng = np.random.default_rng(1)
    grids = []
    for _ in range(5):
        visits = rng.integers(0, 60000, (64, 64), dtype=np.uint16)
        grid = Grid(0.05)
        grid.replace([((0, 0), np.stack([visits // 3, visits]))])
        grids.append(cap_votes(grid, 255))
    whole, left, right, both = Grid(0.05), Grid(0.05), Grid(0.05), Grid(0.05)
    compose_into(whole, grids)
    compose_into(left, grids[3:])
    compose_into(right, grids[:3])
    compose_into(both, [left, right])
    assert both.digest() == whole.digest()


def test_tiles_that_stay_equal_keep_their_version_and_vanished_ones_become_empty() -> None:
    a, b, product = Grid(0.05), Grid(0.05), Grid(0.05)
    a.replace([((0, 0), tile(1, 2))])
    b.replace([((1, 0), tile(1, 2))])
    compose_into(product, [a, b])
    version = product.version
    compose_into(product, [b, a])
    assert product.version == version
    compose_into(product, [a])
    assert product.delta(version) == [(1, 0)]
    assert not product.tiles[1, 0].any()


@pytest.mark.parametrize("far", [1000, -(2**57)])
def test_a_map_whose_tiles_lie_too_far_apart_is_refused_before_it_takes_memory(far: int) -> None:
    grid, sketch = Grid(0.05), Raster(0.05)
    grid.replace([((0, 0), tile(0, 5)), ((far, far), tile(0, 5))])
    sketch.follow(grid)
    for laid_out in (grid.dense, grid.occupancy, sketch.dense):
        with pytest.raises(Unmergeable, match=r"cells is too large"):
            laid_out()
