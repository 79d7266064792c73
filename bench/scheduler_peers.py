"""Other people's graph partitioning, brought to exact balance, to compare policy `cut` with."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pymetis
from networkx.algorithms.community import kernighan_lin_bisection

from services.scheduler.descent import Adjacency, adjacency, pulls, swap_descent
from services.scheduler.graph import Groups, Weights, balanced_sizes

METIS_UNIT = 10_000
"""METIS takes whole weights"""


def metis(weights: Weights, count: int) -> Groups:
    """METIS recursive bisection, repaired to exact balance, then swap descent: the strongest quick peer."""
    graph = adjacency(weights)
    rows = pymetis.CSRAdjacency(graph.starts.tolist(), graph.neighbours.tolist())
    whole = np.maximum(1, np.rint(graph.weights * METIS_UNIT)).astype(int).tolist()
    _, membership = pymetis.part_graph(count, adjacency=rows, eweights=whole, recursive=True)
    return swap_descent(graph, repaired(graph, np.array(membership, dtype=np.int64), count), count)


def repaired(graph: Adjacency, groups: Groups, count: int) -> Groups:
    """Robots leave groups that are too big for groups that are too small, least loss first."""
    groups = groups.copy()
    target = np.empty(count, dtype=np.int64)
    target[np.argsort(-np.bincount(groups, minlength=count), kind="stable")] = balanced_sizes(groups.size, count)
    pull = pulls(*graph, groups, count)
    while True:
        size = np.bincount(groups, minlength=count)
        movable = np.flatnonzero(size[groups] > target[groups])
        small = np.flatnonzero(size < target)
        if not movable.size:
            return groups
        gain = pull[np.ix_(movable, small)] - pull[movable, groups[movable]][:, None]
        at, to = np.unravel_index(np.argmax(gain), gain.shape)
        robot, new = movable[at], small[to]
        rows = slice(graph.starts[robot], graph.starts[robot + 1])
        pull[graph.neighbours[rows], groups[robot]] -= graph.weights[rows]
        pull[graph.neighbours[rows], new] += graph.weights[rows]
        groups[robot] = new


def kernighan_lin(weights: Weights, count: int) -> Groups:
    """networkx' Kernighan-Lin by recursive bisection, sides filled to exact sizes with its own start partition."""
    whole = nx.from_numpy_array(weights)
    groups = np.zeros(len(weights), dtype=np.int64)
    pending = [(list(range(len(weights))), balanced_sizes(len(weights), count).tolist(), 0)]
    while pending:
        members, sizes, first = pending.pop()
        if len(sizes) == 1:
            groups[members] = first
            continue
        left = sum(sizes[: len(sizes) // 2])
        start = (set(members[:left]), set(members[left:]))
        part = whole.subgraph(members)
        one, two = start if 0 in (left, len(members) - left) else _bisection(part, start)
        pending.append((sorted(one), sizes[: len(sizes) // 2], first))
        pending.append((sorted(two), sizes[len(sizes) // 2 :], first + len(sizes) // 2))
    return groups


def _bisection(part: nx.Graph, start: tuple[set[int], set[int]]) -> tuple[set[int], set[int]]:
    """networkx asks for halves of equal size (±1); others are padded with robots that overlap nobody."""
    padded = nx.Graph(part)
    short, long = sorted(start, key=len)
    extra = {("pad", index) for index in range(len(long) - len(short))}
    padded.add_nodes_from(extra)
    one, two = kernighan_lin_bisection(padded, (short | extra, set(long)), weight="weight", seed=0)
    return _unpadded(one, two, {len(start[0]), len(start[1])}, len(start[0]))


def _unpadded(one: set, two: set, sizes: set[int], left: int) -> tuple[set[int], set[int]]:
    """Without the padding; robots are handed over where it was spread over both sides."""
    sides = sorted(({x for x in side if not isinstance(x, tuple)} for side in (one, two)), key=len)
    small, big = sides
    while len(small) > min(sizes):
        big.add(small.pop())
    return (small, big) if left == min(sizes) else (big, small)
