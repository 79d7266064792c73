"""Algorithm 2 of the paper, "Tabu-searching-based optimization", in two readings.

As printed, G and S are never emptied and T forbids nothing: line 24 takes G_k whatever T says. With G and S emptied
in each iteration (otherwise line 11 finds the best of all history for ever) that is a steepest swap descent which ends
in a cycle of two groupings. Mode "printed" stops there: when a swap is chosen twice in a row, the grouping before the
last two has come back, and P* cannot change any more. Mode "intended", the default, does what the text promises: a
swap in T is passed over unless it gives a better grouping than any before (the amnesty rule).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit

from services.scheduler.graph import Groups, Weights

TabuMode = Literal["printed", "intended"]


def tabu_search(weights: Weights, groups: Groups, kappa: int, tau: int, mode: TabuMode = "intended") -> Groups:
    """Algorithm 2: the best grouping P* seen in κ iterations of swapping two robots of different groups.

    `weights` (V, V) is G, `groups` (V,) the initial ⟨P_1, ..., P_N⟩, `kappa` κ the iterations, `tau` τ the length of
    the tabu list T of unordered pairs. The fitness is Eq. 5. Pairs are visited in the order of lines 4-9, v outermost;
    the first of equals is k. Deterministic; O(V²) an iteration.
    """
    start = np.asarray(groups, dtype=np.int64)
    if start.size < 2:
        return start.copy()
    best: Groups = _search(np.ascontiguousarray(weights), start, kappa, tau, mode == "intended")
    return best


@njit(cache=True)
def group_attraction(weights, groups, count):  # type: ignore[no-untyped-def]
    """(count, V): sum of w(u, v) over u in group g, for every g and v."""
    attraction = np.zeros((count, weights.shape[0]))
    for u in range(weights.shape[0]):
        for v in range(weights.shape[0]):
            attraction[groups[u], v] += weights[u, v]
    return attraction


@njit(cache=True)
def swap(weights, groups, attraction, u, v):  # type: ignore[no-untyped-def]
    """Exchange the groups of u and v and keep the attractions."""
    a = groups[u]
    b = groups[v]
    groups[u] = b
    groups[v] = a
    for x in range(groups.size):
        moved = weights[u, x] - weights[v, x]
        attraction[a, x] -= moved
        attraction[b, x] += moved


@njit(cache=True)
def _best_swap(weights, groups, attraction, in_t, enough):  # type: ignore[no-untyped-def]
    """Lines 4-11: the pair v < u whose swap lowers the fitness most, and by how much; (-1, -1) for none.

    A pair in T counts only if its swap lowers the fitness by more than `enough`.
    """
    best_v = -1
    best_u = -1
    best_gain = -np.inf
    for v in range(groups.size):
        a = groups[v]
        for u in range(v + 1, groups.size):
            b = groups[u]
            if a != b:
                gain = attraction[b, v] - attraction[a, v] + attraction[a, u] - attraction[b, u] - 2.0 * weights[v, u]
                if gain > best_gain and (gain > enough or not in_t[v, u]):
                    best_gain = gain
                    best_v = v
                    best_u = u
    return best_v, best_u, best_gain


@njit(cache=True)
def _search(weights, start, kappa, tau, intended):  # type: ignore[no-untyped-def]
    groups = start.copy()
    best = start.copy()
    above = 0.0  # f(P) - f(P*)
    attraction = group_attraction(weights, groups, groups.max() + 1)
    in_t = np.zeros(weights.shape, dtype=np.bool_)
    queue = [(-1, -1)]
    queue.pop()
    last_v = -1
    last_u = -1
    for _ in range(kappa):
        v, u, gain = _best_swap(weights, groups, attraction, in_t, above)
        if v < 0 or (not intended and v == last_v and u == last_u):
            break
        last_v = v
        last_u = u
        swap(weights, groups, attraction, v, u)
        above -= gain
        if above < 0.0:  # lines 12-17
            if in_t[v, u]:
                in_t[v, u] = False
                queue.remove((v, u))
            above = 0.0
            best[:] = groups
        if intended and not in_t[v, u]:  # lines 18-20
            in_t[v, u] = True
            queue.append((v, u))
        if len(queue) > tau:  # lines 21-23
            in_t[queue.pop(0)] = False
    return best
