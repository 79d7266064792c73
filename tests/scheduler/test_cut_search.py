"""Policy `cut`: exact sizes, and the least cut where it can be proven."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scheduling_problems import graph

from services.scheduler.anneal import anneal
from services.scheduler.bisection import bisect, recursive_bisection
from services.scheduler.cut import least_cut
from services.scheduler.descent import adjacency, between, exchange, pulls, swap_descent
from services.scheduler.exact import exact_grouping
from services.scheduler.graph import balanced_sizes, cut
from services.scheduler.grouping import balanced_grouping
from services.scheduler.robust_tabu import robust_tabu

KINDS = ["dense", "sparse", "edgeless", "disconnected", "ties"]


def best_by_enumeration(weights: np.ndarray, count: int) -> float:
    sizes = sorted(balanced_sizes(len(weights), count))
    every = (np.array(labels, dtype=np.int64) for labels in itertools.product(range(count), repeat=len(weights)))
    return min(cut(weights, groups) for groups in every if sorted(np.bincount(groups, minlength=count)) == sizes)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("robots", "count"), [(0, 2), (1, 3), (3, 5), (6, 1), (7, 2), (8, 3)])
def test_small_groupings_are_proven_to_be_the_best_of_all(kind: str, robots: int, count: int) -> None:
    weights = graph(kind, robots, seed=robots)
    found = least_cut(weights, count, np.random.default_rng(0), spent=lambda: 2.0)
    assert found.proven
    assert sorted(np.bincount(found.groups, minlength=count)) == sorted(balanced_sizes(robots, count))
    assert cut(weights, found.groups) == best_by_enumeration(weights, count)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("robots", "count"), [(20, 4), (31, 7), (140, 6)])
def test_the_cut_is_never_above_algorithms_1_and_2_at_equal_balance(kind: str, robots: int, count: int) -> None:
    weights = graph(kind, robots, seed=1)
    steps = iter(np.linspace(0, 1.5, 12).tolist() + [2.0] * 1000)
    groups = least_cut(weights, count, np.random.default_rng(0), spent=lambda: next(steps)).groups
    assert sorted(np.bincount(groups, minlength=count)) == sorted(balanced_sizes(robots, count))
    assert cut(weights, groups) <= cut(weights, balanced_grouping(weights, count, 100, 10))


def test_a_stopped_proof_says_that_nothing_is_proven() -> None:
    weights = graph("dense", 20)
    start = balanced_grouping(weights, 4, 100, 10)
    stopped = exact_grouping(weights, start, 4, max_nodes=100)
    assert not stopped.proven
    assert cut(weights, stopped.groups) <= cut(weights, start)


@pytest.mark.parametrize("kind", KINDS)
def test_recursive_bisection_keeps_the_sizes_that_are_asked_for(kind: str) -> None:
    weights = graph(kind, 90, seed=2)
    for sizes in ([90], [45, 45], [1, 80, 9], [0, 30, 0, 60], [13] * 6 + [12], [1] * 90):
        groups = recursive_bisection(adjacency(weights), np.array(sizes), np.random.default_rng(0))
        assert np.bincount(groups, minlength=len(sizes)).tolist() == sizes


def test_bisection_separates_two_communities() -> None:
    weights = graph("dense", 200, seed=3)
    apart = np.arange(200) % 2
    weights[apart[:, None] != apart[None, :]] /= 1024
    side = bisect(adjacency(weights), 100, np.random.default_rng(0))
    assert np.array_equal(side, apart) or np.array_equal(side, 1 - apart)


@pytest.mark.parametrize("kind", KINDS)
def test_no_swap_improves_on_a_descent(kind: str) -> None:
    weights = graph(kind, 24, seed=4)
    groups = swap_descent(adjacency(weights), np.arange(24) % 5, 5)
    least = cut(weights, groups)
    for u, v in itertools.combinations(range(24), 2):
        swapped = groups.copy()
        swapped[u], swapped[v] = groups[v], groups[u]
        assert cut(weights, swapped) >= least


def test_the_running_table_of_attractions_equals_a_fresh_one() -> None:
    weights = graph("sparse", 30, seed=5)
    rows, groups = adjacency(weights), np.arange(30) % 4
    pull = pulls(*rows, groups, 4)
    for u, v in ((0, 1), (5, 10), (1, 8), (29, 0)):
        assert between(*rows, u, v) == weights[u, v]
        exchange(*rows, groups, pull, u, v)
    assert np.array_equal(pull, pulls(*rows, groups, 4))
    assert np.array_equal(pull, weights @ (groups[:, None] == np.arange(4)))


@pytest.mark.parametrize("kind", KINDS)
def test_tabu_search_and_annealing_keep_sizes_and_lower_the_cut(kind: str) -> None:
    weights, rng = graph(kind, 60, seed=6), np.random.default_rng(0)
    start = np.arange(60) % 7
    rows = adjacency(weights)
    for found in (robust_tabu(weights, start, 7, 300, rng), anneal(rows, start, 7, 100_000, rng)):
        assert np.array_equal(np.bincount(found), np.bincount(start))
        assert cut(weights, found) <= cut(weights, start)
