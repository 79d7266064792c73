"""Algorithms 1 to 3 do what the paper prints, bit for bit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from paper_twins import algorithm_1, algorithm_2, algorithm_3, fitness
from scheduling_problems import graph

from common.errors import UsageError
from services.scheduler.graph import balanced_sizes, cut, quantise
from services.scheduler.grouping import balanced_grouping, initial_grouping
from services.scheduler.placement import bottleneck_assignment, edge_offloading
from services.scheduler.tabu import tabu_search

KINDS = ["dense", "sparse", "edgeless", "disconnected", "ties"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("robots", "groups"), [(0, 3), (1, 1), (1, 4), (3, 5), (7, 1), (9, 2), (12, 5), (23, 4)])
def test_algorithm_1_equals_its_line_by_line_twin(kind: str, robots: int, groups: int) -> None:
    weights = graph(kind, robots, seed=robots)
    assert np.array_equal(initial_grouping(weights, groups), algorithm_1(weights, groups))


@pytest.mark.parametrize("mode", ["printed", "intended"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("robots", "groups"), [(0, 2), (1, 1), (3, 5), (4, 2), (6, 1), (8, 3), (10, 4)])
def test_algorithm_2_equals_its_line_by_line_twin(mode: str, kind: str, robots: int, groups: int) -> None:
    weights = graph(kind, robots, seed=robots)
    start = initial_grouping(weights, groups)
    for kappa, tau in ((1, 1), (12, 3)):
        expected = algorithm_2(weights, start, kappa, tau, mode)
        assert np.array_equal(tabu_search(weights, start, kappa, tau, mode), expected)


@pytest.mark.parametrize("kind", KINDS)
def test_group_sizes_differ_by_at_most_one(kind: str) -> None:
    for robots, groups in itertools.product((0, 1, 2, 5, 17, 40), (1, 2, 3, 7, 41)):
        labels = balanced_grouping(graph(kind, robots), groups, kappa=100, tau=10)
        assert sorted(np.bincount(labels, minlength=groups)) == sorted(balanced_sizes(robots, groups))


def test_algorithm_2_never_worsens_the_grouping_and_more_iterations_never_hurt() -> None:
    weights = graph("sparse", 30, seed=3)
    start = initial_grouping(weights, 4)
    for mode in ("printed", "intended"):
        cuts = [cut(weights, tabu_search(weights, start, kappa, 10, mode)) for kappa in (1, 5, 50, 500)]
        assert cuts == sorted(cuts, reverse=True)
        assert cuts[0] <= cut(weights, start)


def test_the_tabu_list_lets_the_search_leave_a_local_optimum() -> None:
    better = 0
    for seed in range(10):
        weights = graph("sparse", 30, seed)
        start = initial_grouping(weights, 4)
        printed = cut(weights, tabu_search(weights, start, 1000, 30, "printed"))
        intended = cut(weights, tabu_search(weights, start, 1000, 30, "intended"))
        assert intended <= printed
        better += intended < printed
    assert better >= 3


def test_the_cut_counts_each_pair_once() -> None:
    weights = graph("dense", 9)
    groups = np.arange(9) % 3
    assert cut(weights, groups) == fitness(weights, groups)


@pytest.mark.parametrize("size", [0, 1, 2, 7])
def test_algorithm_3_equals_its_line_by_line_twin(size: int) -> None:
    rng = np.random.default_rng(size)
    for _ in range(20):
        latencies = rng.integers(0, 4, (size, size)).astype(float)
        latencies[latencies == 3] = np.inf
        assert edge_offloading(latencies).tolist() == algorithm_3(latencies.tolist())


def test_algorithm_3_gives_each_group_in_turn_the_best_edge_left() -> None:
    latencies = np.array([[2.0, 1.0, 3.0], [9.0, 1.0, 5.0], [1.0, 1.0, 8.0]])
    assert edge_offloading(latencies).tolist() == [1, 2, 0]


def test_the_bottleneck_assignment_is_the_best_of_all_permutations() -> None:
    rng = np.random.default_rng(0)
    for size in (1, 2, 5, 6):
        for blocked in (0.0, 0.3):
            latencies = rng.integers(1, 9, (size, size)).astype(float)
            latencies[rng.random((size, size)) < blocked] = np.inf
            theta = bottleneck_assignment(latencies)
            rows = np.arange(size)
            every = [latencies[rows, list(order)] for order in itertools.permutations(range(size))]
            best = min((row.max(), row.sum()) for row in every)
            chosen = latencies[rows, theta]
            if np.isfinite(best[0]):
                assert (chosen.max(), chosen.sum()) == best
            else:
                assert np.isinf(chosen).sum() == min(np.isinf(row).sum() for row in every)
            assert sorted(theta) == list(range(size))


@pytest.mark.parametrize(
    ("matrix", "culprit"),
    [
        ([[0, 1]], "square"),
        ([[0, 0.1], [0.2, 0]], "symmetric"),
        ([[0, np.nan], [np.nan, 0]], "NaN"),
        ([[0, -0.1], [-0.1, 0]], "negative"),
        ([[0.5, 0], [0, 0]], "diagonal"),
    ],
)
def test_a_matrix_that_is_no_overlap_matrix_is_refused(matrix: list[list[float]], culprit: str) -> None:
    with pytest.raises(UsageError, match=culprit):
        quantise(np.array(matrix))
