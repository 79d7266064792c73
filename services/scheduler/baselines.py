"""What the paper compares itself with, and what happens without a scheduler. Each gives (V,) labels or edges."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.scheduler.graph import Groups, Weights, balanced_sizes
from services.scheduler.tabu import group_attraction, swap


def random_grouping(count: int, groups: int, rng: np.random.Generator) -> Groups:
    """Each robot to any group: sizes are not balanced. The paper's "random algorithm"."""
    return rng.integers(0, groups, count, dtype=np.int64)


def random_balanced_grouping(count: int, groups: int, rng: np.random.Generator) -> Groups:
    """A random grouping whose sizes differ by at most one."""
    return rng.permutation(np.repeat(np.arange(groups, dtype=np.int64), balanced_sizes(count, groups)))


def greedy_grouping(weights: Weights, groups: int, rng: np.random.Generator) -> Groups:
    """The paper's "greedy algorithm": from a random balanced grouping, robots in order, each swaps once with the robot
    of another group that raises the overlap within both groups most, if any does."""
    labels = random_balanced_grouping(len(weights), groups, rng)
    _one_pass(np.ascontiguousarray(weights), labels, groups)
    return labels


def within_reach(reachable: NDArray[np.bool_], edges: Groups) -> Groups:
    """`edges` (V,) with each robot that names no edge within its reach, or -1, sent to the emptiest edge that is."""
    chosen = np.asarray(edges, dtype=np.int64).copy()
    robots, count = reachable.shape
    lost = (chosen < 0) | ~reachable[np.arange(robots), chosen]
    load = np.bincount(chosen[~lost], minlength=count)
    for robot in np.flatnonzero(lost):
        candidates = np.flatnonzero(reachable[robot])
        chosen[robot] = candidates[np.argmin(load[candidates])]
        load[chosen[robot]] += 1
    return chosen


@njit(cache=True)
def _one_pass(weights, labels, groups):  # type: ignore[no-untyped-def]
    attraction = group_attraction(weights, labels, groups)
    for v in range(labels.size):
        a = labels[v]
        best = -1
        best_gain = 0.0
        for u in range(labels.size):
            b = labels[u]
            if a != b:
                gain = attraction[b, v] - attraction[a, v] + attraction[a, u] - attraction[b, u] - 2.0 * weights[v, u]
                if gain > best_gain:
                    best = u
                    best_gain = gain
        if best >= 0:
            swap(weights, labels, attraction, v, best)
