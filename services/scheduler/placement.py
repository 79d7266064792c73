"""Which group goes to which edge server: Algorithm 3 of the paper, and the exact bottleneck assignment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

Latencies = NDArray[np.float64]
"""(N, N) s: row i, column j is L_j(P_i) + D(P_i) / B_j; infinite where group i cannot go to edge j"""
Offloading = NDArray[np.int64]
"""(N,) θ: group i goes to edge θ_i, each edge taken once"""


def edge_offloading(latencies: Latencies) -> Offloading:
    """Algorithm 3, "Resource-aware edge offloading algorithm": each group in turn takes the best edge left.

    Line 2 takes the lowest edge on ties, also when all that is left is infinite.
    """
    left = latencies.copy()
    theta = np.empty(len(left), dtype=np.int64)
    taken = np.zeros(len(left), dtype=bool)
    for i, row in enumerate(left):  # lines 1-5
        free = np.flatnonzero(~taken)
        theta[i] = free[np.argmin(row[free])]
        taken[theta[i]] = True
    return theta


def bottleneck_assignment(latencies: Latencies) -> Offloading:
    """The placement whose slowest group is as fast as any placement can make it; of these, the least sum.

    Exact: bisection over the distinct latencies with a maximum matching for each. Where no placement is finite, as few
    groups as possible are placed at an infinite latency.
    """
    size = len(latencies)
    if size == 0:
        return np.empty(0, dtype=np.int64)
    levels = np.unique(latencies[np.isfinite(latencies)])
    low, high = 0, len(levels)  # levels[high] is enough, unless nothing is
    while low < high:
        middle = (low + high) // 2
        if _perfect(latencies <= levels[middle]):
            high = middle
        else:
            low = middle + 1
    limit = levels[high] if high < len(levels) else np.inf
    finite = np.isfinite(latencies) & (latencies <= limit)
    forbidden = 1.0 + size * float(np.abs(levels).max(initial=1.0))
    _, theta = linear_sum_assignment(np.where(finite, latencies, forbidden))
    return np.asarray(theta, dtype=np.int64)


def _perfect(allowed: NDArray[np.bool_]) -> bool:
    return bool((maximum_bipartite_matching(csr_array(allowed), perm_type="column") >= 0).all())
