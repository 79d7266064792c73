"""The best balanced grouping by cut alone: several starts, a search by size of graph, a proof where one is cheap."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.scheduler.anneal import anneal
from services.scheduler.bisection import recursive_bisection
from services.scheduler.descent import Adjacency, adjacency, swap_descent
from services.scheduler.exact import exact_grouping
from services.scheduler.graph import Groups, Weights, balanced_sizes, cut
from services.scheduler.grouping import balanced_grouping
from services.scheduler.robust_tabu import robust_tabu

Spent = Callable[[], float]
"""used share of the time budget: at 1 the search ends with the best it has"""

SURE = 12
"""up to so many robots only the exact search runs, to its end"""
SMALL = 128
"""up to so many robots tabu search, beyond it annealing"""
PROVABLE = 100
PROOF_NODES = 400_000
BISECTIONS = 4
ROUNDS = 12
PROPOSALS = 100_000
"""of the annealing, a robot"""


class LeastCut(NamedTuple):
    groups: Groups
    proven: bool
    """no balanced grouping has a smaller cut"""


def least_cut(weights: Weights, count: int, rng: np.random.Generator, spent: Spent = lambda: 0.0) -> LeastCut:
    """The balanced grouping of `weights` (V, V), quantised, into `count` groups with the smallest cut found.

    Proven up to SURE robots whatever the budget. Deterministic for a seed as long as the budget does not end it.
    """
    start = balanced_grouping(weights, count, kappa=100, tau=10)
    if len(weights) <= SURE:
        optimum = exact_grouping(weights, start, count)
        return LeastCut(optimum.groups, optimum.proven)
    graph = adjacency(weights)
    groups = sized_cut(weights, graph, balanced_sizes(len(weights), count), start, rng, spent)
    density = len(graph.weights) / (len(weights) * (len(weights) - 1))
    if len(weights) <= PROVABLE and density < 0.5 and spent() < 1:
        optimum = exact_grouping(weights, groups, count, PROOF_NODES, spent)
        return LeastCut(optimum.groups, optimum.proven)
    return LeastCut(groups, False)


def sized_cut(
    weights: Weights,
    graph: Adjacency,
    sizes: NDArray[np.int64],
    start: Groups | None,
    rng: np.random.Generator,
    spent: Spent = lambda: 0.0,
) -> Groups:
    """A grouping with `sizes[g]` robots in group g and a small cut; `start`, if given, has these sizes up to order."""
    count = len(sizes)
    seeds = [] if start is None else [swap_descent(graph, start, count)]
    for _ in range(BISECTIONS):
        seeds.append(swap_descent(graph, recursive_bisection(graph, sizes, rng), count))
        if spent() >= 0.5:
            break
    seeds.sort(key=lambda groups: cut(weights, groups))
    if len(weights) <= SMALL:
        return _tabu_rounds(weights, seeds, count, rng, spent)
    proposals = PROPOSALS * len(weights)
    cooled = swap_descent(graph, anneal(graph, seeds[0], count, proposals, rng, spent), count)
    return min(seeds[0], cooled, key=lambda groups: cut(weights, groups))


def _tabu_rounds(weights: Weights, seeds: list[Groups], count: int, rng: np.random.Generator, spent: Spent) -> Groups:
    """Tabu search from each seed in turn, the later rounds from the best of all."""
    iterations = int(min(1000, 2.5e6 / len(weights) ** 2))
    best = seeds[0]
    for turn in range(ROUNDS):
        if spent() >= 0.8:
            break
        found = robust_tabu(weights, seeds[turn] if turn < len(seeds) else best, count, iterations, rng)
        best = min(best, found, key=lambda groups: cut(weights, groups))
    return best
