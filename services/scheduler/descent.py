"""Swaps on a sparse overlap graph: the adjacency in rows, the table of attractions, and the descent to a local optimum.

A swap exchanges the groups of two robots, so it keeps every group's size. Kernels take the adjacency as three arrays
(`starts`, `neighbours`, `weights`, compressed rows) and keep `pull[v, g]`, the sum of w(u, v) over u in group g.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.scheduler.graph import Groups, Weights


class Adjacency(NamedTuple):
    """The overlap graph by rows: robot v's neighbours are `neighbours[starts[v]:starts[v + 1]]`, ascending."""

    starts: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    weights: NDArray[np.float64]


def adjacency(weights: Weights) -> Adjacency:
    """The positive entries of a (V, V) overlap matrix."""
    rows, columns = np.nonzero(weights)
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=len(weights)))]).astype(np.int64)
    return Adjacency(starts, columns.astype(np.int64), weights[rows, columns])


def swap_descent(graph: Adjacency, groups: Groups, count: int) -> Groups:
    """A grouping into `count` groups from which no swap of two robots lowers the cut any more."""
    found = groups.copy()
    descend(*graph, found, pulls(*graph, found, count))
    return found


@njit(cache=True)
def pulls(starts, neighbours, weights, groups, count):  # type: ignore[no-untyped-def]
    """(V, count): sum of w(u, v) over u in group g, for every v and g."""
    pull = np.zeros((groups.size, count))
    for v in range(groups.size):
        for at in range(starts[v], starts[v + 1]):
            pull[v, groups[neighbours[at]]] += weights[at]
    return pull


@njit(cache=True)
def between(starts, neighbours, weights, u, v):  # type: ignore[no-untyped-def]
    """w(u, v), by bisection."""
    low = starts[u]
    high = starts[u + 1]
    while low < high:
        middle = (low + high) // 2
        if neighbours[middle] < v:
            low = middle + 1
        else:
            high = middle
    return weights[low] if low < starts[u + 1] and neighbours[low] == v else 0.0


@njit(cache=True)
def exchange(starts, neighbours, weights, groups, pull, u, v):  # type: ignore[no-untyped-def]
    """Swap the groups of u and v and keep `pull`."""
    a = groups[u]
    b = groups[v]
    groups[u] = b
    groups[v] = a
    for at in range(starts[u], starts[u + 1]):
        pull[neighbours[at], a] -= weights[at]
        pull[neighbours[at], b] += weights[at]
    for at in range(starts[v], starts[v + 1]):
        pull[neighbours[at], b] -= weights[at]
        pull[neighbours[at], a] += weights[at]


@njit(cache=True)
def descend(starts, neighbours, weights, groups, pull):  # type: ignore[no-untyped-def]
    """In place. An improving swap has a robot that would gain by moving alone, so only those are tried as u."""
    count = pull.shape[1]
    size = np.zeros(count, dtype=np.int64)
    members = np.empty((count, groups.size), dtype=np.int64)
    place = np.empty(groups.size, dtype=np.int64)
    for v in range(groups.size):
        place[v] = size[groups[v]]
        members[groups[v], place[v]] = v
        size[groups[v]] += 1
    improved = True
    while improved:
        improved = False
        for u in range(groups.size):
            a = groups[u]
            best = -1
            best_gain = 0.0
            for b in range(count):
                alone = pull[u, b] - pull[u, a]
                if b == a or alone <= 0.0:
                    continue
                for at in range(size[b]):
                    v = members[b, at]
                    gain = alone + pull[v, a] - pull[v, b]
                    if gain > best_gain:
                        gain -= 2.0 * between(starts, neighbours, weights, u, v)
                        if gain > best_gain:
                            best = v
                            best_gain = gain
            if best >= 0:
                b = groups[best]
                exchange(starts, neighbours, weights, groups, pull, u, best)
                members[a, place[u]] = best
                members[b, place[best]] = u
                place[u], place[best] = place[best], place[u]
                improved = True
