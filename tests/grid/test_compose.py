"""Adding maps is commutative, keeps ratios and refuses to mix lattices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import Unmergeable
from common.grid import Grid
from common.grid.compose import add, saturate


def random_grid(seed: int, top: int = 60_000) -> Grid:
    rng = np.random.default_rng(seed)
    visits = rng.integers(0, top, (90, 130)) * (rng.random((90, 130)) < 0.4)
    hits = (visits * rng.random(visits.shape)).astype(np.uint16)
    origin = (int(rng.integers(-200, 200)), int(rng.integers(-200, 200)))
    return Grid.from_dense(np.stack([hits, visits.astype(np.uint16)]), origin, 0.05)


@given(st.permutations(range(5)))
@settings(max_examples=15, deadline=None)
def test_the_sum_does_not_depend_on_the_order(order: list[int]) -> None:
    grids = [random_grid(seed) for seed in range(5)]
    assert add(grids[k] for k in order).digest() == add(grids).digest()


def test_any_grouping_gives_the_same_sum_while_nothing_saturates() -> None:
    a, b, c = (random_grid(seed, top=300) for seed in range(3))
    assert add([add([a, b]), c]).digest() == add([a, add([b, c])]).digest() == add([a, b, c]).digest()


def test_saturated_cells_keep_their_ratio() -> None:
    counts = saturate(np.array([[60_000, 10], [120_000, 40]], np.uint32))
    assert counts[1, 0] == 65_535
    assert counts[0, 0] / counts[1, 0] == pytest.approx(0.5, abs=1e-4)
    assert counts[:, 1].tolist() == [10, 40]


def test_one_robots_ghost_is_cleared_by_anothers_free_space() -> None:
    ghost, free = np.zeros((2, 4, 4), np.uint16), np.zeros((2, 4, 4), np.uint16)
    ghost[:, 1, 1] = 2
    free[1, 1, 1] = 20
    merged = add([Grid.from_dense(ghost, (0, 0), 0.05), Grid.from_dense(free, (0, 0), 0.05)])
    assert merged.occupancy()[0][1, 1] == 0


def test_different_resolutions_are_refused() -> None:
    with pytest.raises(Unmergeable, match="render"):
        add([Grid(0.05), Grid(0.1)])


def test_nothing_to_add_is_refused() -> None:
    with pytest.raises(Unmergeable):
        add([])
