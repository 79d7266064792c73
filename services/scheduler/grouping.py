"""Algorithm 1 of the paper, "Balanced robot data grouping algorithm".

How its pseudo-code is read, where it leaves a choice:

* line 7, "least number of neighbors": unweighted, within the shrinking candidate set C; lowest robot first on ties;
* lines 10 and 20, R + C ∩ N_C(v) − {v}: (R ∪ (C ∩ N_C(v))) \\ {v}, so R is the frontier of what is assigned and
  runs empty exactly when a component of the graph is used up;
* line 17 takes its candidate from C, as printed, not from R; lowest robot first on ties;
* lines 11 and 21 divide in the rationals: N |C| <= V;
* N = 1, for which the loops of lines 6 and 16 are empty and line 25 is never reached, gives one group.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from services.scheduler.graph import Groups, Weights
from services.scheduler.tabu import TabuMode, tabu_search


def balanced_grouping(weights: Weights, groups: int, kappa: int, tau: int, mode: TabuMode = "intended") -> Groups:
    """Algorithm 1 with its line 27: a grouping into `groups` balanced groups, improved by Algorithm 2.

    `weights` (V, V) is the overlapping graph G, `groups` is N, `kappa` and `tau` are κ and τ of Algorithm 2.
    Returns (V,) labels in 0..N-1; group sizes differ by at most one.
    """
    return tabu_search(weights, initial_grouping(weights, groups), kappa, tau, mode)


def initial_grouping(weights: Weights, groups: int) -> Groups:
    """Lines 1-26 of Algorithm 1: the feasible grouping ⟨P_1, ..., P_N⟩ that Algorithm 2 starts from. O(V²)."""
    labels: Groups = _grow(np.ascontiguousarray(weights), groups)
    return labels


@njit(cache=True)
def _least_neighbours(in_c, neighbours):  # type: ignore[no-untyped-def]
    """Line 7: v_min^neigh."""
    best = -1
    for v in range(in_c.size):
        if in_c[v] and (best < 0 or neighbours[v] < neighbours[best]):
            best = v
    return best


@njit(cache=True)
def _most_gain(in_c, attraction, outside):  # type: ignore[no-untyped-def]
    """Line 17 with Eq. 4: v_max^gain."""
    best = -1
    best_gain = 0.0
    for v in range(in_c.size):
        if in_c[v]:
            gain = attraction[v] - outside[v]
            if best < 0 or gain > best_gain:
                best = v
                best_gain = gain
    return best


@njit(cache=True)
def _grow(weights, groups):  # type: ignore[no-untyped-def]
    count = weights.shape[0]
    labels = np.full(count, groups - 1, dtype=np.int64)  # line 26: what stays in C is P_N
    if groups == 1 or count == 0:
        return labels
    in_c = np.ones(count, dtype=np.bool_)
    in_r = np.zeros(count, dtype=np.bool_)
    attraction = np.zeros((groups, count))  # sum of w(u, v) over u in P_i
    outside = np.zeros(count)  # sum of w(u, v) over u in C
    neighbours = np.zeros(count, dtype=np.int64)  # |N_C(v)|
    for v in range(count):
        for u in range(count):
            outside[v] += weights[v, u]
            neighbours[v] += weights[v, u] > 0
    remaining = count
    frontier = 0  # |R|
    while True:
        seeding = frontier == 0  # line 5: asked once a round, so a seeding round seeds all groups
        for i in range(groups - 1):
            v = _least_neighbours(in_c, neighbours) if seeding else _most_gain(in_c, attraction[i], outside)
            labels[v] = i
            in_c[v] = False
            remaining -= 1
            for u in range(count):
                w = weights[v, u]
                if w > 0:
                    attraction[i, u] += w
                    outside[u] -= w
                    neighbours[u] -= 1
                    if in_c[u] and not in_r[u]:
                        in_r[u] = True
                        frontier += 1
            if in_r[v]:
                in_r[v] = False
                frontier -= 1
            if groups * remaining <= count:
                return labels
