"""Map scores: hand-made maps get the score that counting by hand gives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import UsageError
from common.evaluation.maps import cell_centres, score_map, score_occupancy, wall_thickness

CELL = 0.05


def wall(x0: float, x1: float, y: float) -> np.ndarray:
    """Points on a face along x, denser than cells."""
    x = np.arange(x0, x1, CELL / 5)
    return np.column_stack([x, np.full(len(x), y)])


def cells_along(x0: float, x1: float, y: float) -> np.ndarray:
    x = np.arange(x0 + CELL / 2, x1, CELL)
    return np.column_stack([x, np.full(len(x), y)])


def test_a_wall_within_a_cell_is_found_and_beyond_it_is_invented():
    truth = wall(0, 5, 0.0)
    assert score_map(cells_along(0, 5, CELL / 2), truth, CELL)[:4] == (1, 1, 1, 1)
    assert score_map(cells_along(0, 5, CELL * 0.99), truth, CELL).precision == 1
    assert score_map(cells_along(0, 5, CELL * 1.1), truth, CELL)[:3] == (0, 0, 0)
    assert score_map(cells_along(0, 5, CELL * 1.1), truth, CELL, tolerance=2).iou == 1


def test_a_distance_of_exactly_one_cell_is_within_one_cell():
    points = np.column_stack([np.arange(100) * 0.3, np.zeros(100)])
    for far in (np.zeros(2), np.array([1000.0, 0])):
        assert score_map(points + far + np.array([0, 0.1]), points + far, 0.1).iou == 1


def test_half_the_walls_found_and_as_much_invented():
    truth = np.concatenate([wall(0, 5, 0), wall(0, 5, 3)])
    cells = np.concatenate([cells_along(0, 5, 0), cells_along(0, 5, 9)])
    score = score_map(cells, truth, CELL)
    assert (score.precision, score.recall) == (0.5, 0.5)
    assert score.iou == pytest.approx(1 / 3)
    assert score.coverage == 0.5
    assert (score.cells, score.truth) == (200, len(truth))


@given(st.integers(0, 50))
def test_iou_is_matches_over_union(seed):
    rng = np.random.default_rng(seed)
    cells, truth = rng.integers(0, 12, (30, 2)) * CELL, rng.integers(0, 12, (25, 2)) * CELL
    score = score_map(cells, truth, CELL)
    near = np.hypot(*(cells[:, None] - truth[None]).transpose(2, 0, 1)) <= CELL + 1e-9
    precision, recall = near.any(axis=1).mean(), near.any(axis=0).mean()
    assert (score.precision, score.recall) == (precision, recall)
    assert score.iou == pytest.approx(1 / (1 / precision + 1 / recall - 1))
    assert score.iou <= min(precision, recall)


def test_coverage_is_the_known_share_of_the_space_that_could_be_seen():
    known = cell_centres(np.ones((10, 10), bool), CELL)
    free = np.random.default_rng(0).uniform(0, 1, (4000, 2)) * [1.0, 0.5]
    score = score_map(known[:10], wall(0, 0.5, 0), CELL, known=known, truth_free=free)
    assert score.coverage == pytest.approx(0.5, abs=0.04)


def test_an_empty_map_scores_nothing_and_no_truth_is_refused():
    assert score_map(np.empty((0, 2)), wall(0, 1, 0), CELL)[:5] == (0, 0, 0, 0, 0)
    with pytest.raises(UsageError, match="no truth"):
        score_map(wall(0, 1, 0), [], CELL)
    with pytest.raises(UsageError, match="not finite"):
        score_map([[np.nan, 0]], wall(0, 1, 0), CELL)


def test_cell_centres_lie_where_origin_and_pose_put_them():
    mask = np.array([[False, False], [True, False]])
    np.testing.assert_allclose(cell_centres(mask, 0.1), [[0.05, 0.15]])
    np.testing.assert_allclose(cell_centres(mask, 0.1, (1, 2, np.pi / 2)), [[1 - 0.15, 2.05]])
    np.testing.assert_allclose(cell_centres(mask, 0.1, (1, 2, np.pi / 2), (0, 0, np.pi)), [[-0.85, -2.05]], atol=1e-12)


def test_a_map_is_scored_where_its_robots_say_it_lies():
    grid = np.full((40, 100), -1, np.int8)
    grid[10:, :] = 0
    grid[9] = 100
    truth = [in_truth(*point) for point in wall(0, 5, 9.5 * CELL)]
    seen = [in_truth(*point) for point in np.random.default_rng(0).uniform((0, 0.5), (5, 2), (500, 2))]
    placed = score_occupancy(grid, CELL, truth, origin=(1, 2, np.pi / 2), pose=(-3, 0, np.pi), truth_free=seen)
    assert placed[:4] == (1, 1, 1, 1)
    assert score_occupancy(grid, CELL, truth, origin=(1, 2, np.pi / 2), truth_free=seen).iou == 0


def in_truth(x: float, y: float) -> tuple[float, float]:
    """Turned a quarter at (1, 2), and that half round at (-3, 0)."""
    return -3 - (1 - y), -(2 + x)


@pytest.mark.parametrize("thick", [1, 2, 3, 5])
def test_a_walls_thickness_is_counted_across_it(thick):
    grid = np.zeros((60, 60), np.int8)
    grid[20 : 20 + thick, 5:55] = 100
    assert wall_thickness(grid) == pytest.approx(thick, rel=0.04)
    assert wall_thickness(grid.T) == wall_thickness(grid)


@pytest.mark.parametrize("angle", [0, 10, 22.5, 30, 45, 60, 80])
def test_slanted_walls_are_not_taken_for_thicker_ones(angle):
    y, x = np.mgrid[-100:100, -100:100] + 0.5
    across = -np.sin(np.radians(angle)) * x + np.cos(np.radians(angle)) * y
    along = np.cos(np.radians(angle)) * x + np.sin(np.radians(angle)) * y
    grid = np.where((np.abs(across) < 4) & (np.abs(along) < 80), 100, 0).astype(np.int8)
    assert 7.0 < wall_thickness(grid) < 8.8
    assert wall_thickness(np.where(np.eye(20, dtype=bool), 100, -1).astype(np.int8)) == 1


def test_a_map_without_walls_has_no_thickness():
    assert np.isnan(wall_thickness(np.zeros((4, 4), np.int8)))
