"""Robust tabu search over swaps, for graphs small enough to look at all of them in each iteration.

A swap is tabu while one of its robots would return to a group that it left a random, short time ago, unless it leads to
the best grouping yet. When nothing better turned up for a while, a few random swaps kick the search elsewhere; that
matters more than the tenure.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from services.scheduler.graph import Groups, Weights
from services.scheduler.tabu import group_attraction, swap

KICK = 3


def robust_tabu(weights: Weights, groups: Groups, count: int, iterations: int, rng: np.random.Generator) -> Groups:
    """The best grouping seen in so many iterations from `groups`; the sizes stay. O(V²) an iteration."""
    best = np.array(groups, dtype=np.int64)
    if count > 1 and best.size > 1:
        _search(np.ascontiguousarray(weights), best, count, iterations, rng)
    return best


@njit(cache=True)
def _pick(weights, groups, pull, barred, now, enough):  # type: ignore[no-untyped-def]
    """The swap of most gain that is not tabu, or that gains more than `enough`; (-1, -1) for none."""
    best_u = -1
    best_v = -1
    best_gain = -np.inf
    for u in range(groups.size):
        a = groups[u]
        for v in range(u + 1, groups.size):
            b = groups[v]
            if a != b:
                gain = pull[b, u] - pull[a, u] + pull[a, v] - pull[b, v] - 2.0 * weights[u, v]
                if gain > best_gain and (gain > enough or (barred[b, u] <= now and barred[a, v] <= now)):
                    best_gain = gain
                    best_u = u
                    best_v = v
    return best_u, best_v, best_gain


@njit(cache=True)
def _kick(weights, groups, pull, rng):  # type: ignore[no-untyped-def]
    """A few random swaps; returns by how much they lower the cut."""
    gained = 0.0
    for _ in range(KICK):
        u = int(rng.random() * groups.size)
        v = int(rng.random() * groups.size)
        a = groups[u]
        b = groups[v]
        if a != b:
            gained += pull[b, u] - pull[a, u] + pull[a, v] - pull[b, v] - 2.0 * weights[u, v]
            swap(weights, groups, pull, u, v)
    return gained


@njit(cache=True)
def _search(weights, best, count, iterations, rng):  # type: ignore[no-untyped-def]
    groups = best.copy()
    pull = group_attraction(weights, groups, count)
    barred = np.zeros((count, groups.size), dtype=np.int64)
    tenure = max(3, groups.size // 10)
    patience = max(50, 2 * groups.size)
    above = 0.0  # cut over that of the best
    idle = 0
    for now in range(1, iterations + 1):
        u, v, gain = _pick(weights, groups, pull, barred, now, above)
        if u < 0 or idle > patience:
            above -= _kick(weights, groups, pull, rng)
            idle = 0
        else:
            barred[groups[u], u] = now + 2 + int(rng.random() * tenure)
            barred[groups[v], v] = now + 2 + int(rng.random() * tenure)
            swap(weights, groups, pull, u, v)
            above -= gain
            idle += 1
        if above < 0.0:
            above = 0.0
            idle = 0
            best[:] = groups
