"""Balanced grouping of least cut, proven: depth-first branch and bound.

Robots are placed in the order of their ties to those placed before. The bound adds, for every robot not yet placed, the
overlap with placed robots that it must lose even in the group with room that keeps most of it. Empty groups are
alike, so only the first of them is tried.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from services.scheduler.graph import Groups, Weights, cut

QUANTUM_NODES = 20_000  # some 10 ms between two looks at the clock


class Optimum(NamedTuple):
    groups: Groups
    proven: bool
    """no balanced grouping has a smaller cut"""
    nodes: int


def exact_grouping(
    weights: Weights,
    start: Groups,
    count: int,
    max_nodes: int | None = None,
    spent: Callable[[], float] = lambda: 0.0,
) -> Optimum:
    """The best balanced grouping into `count` groups, or the best found within `max_nodes` nodes or until `spent()`
    reaches 1. `start` (V,) is a balanced grouping to beat. `weights` must be quantised."""
    robots = len(weights)
    if robots == 0 or count == 1:
        return Optimum(start.copy(), True, 0)
    order = _by_ties(np.ascontiguousarray(weights))
    ordered = np.ascontiguousarray(weights[np.ix_(order, order)])
    best = start[order].astype(np.int64)
    limit = np.array([cut(weights, start)])
    tree = _Tree(robots, count)
    nodes, proven = 0, False
    while not proven and (max_nodes is None or nodes < max_nodes) and (nodes == 0 or spent() < 1):
        quota = QUANTUM_NODES if max_nodes is None else min(QUANTUM_NODES, max_nodes - nodes)
        done = _search(ordered, count, quota, best, limit, *tree.arrays())
        nodes += done
        proven = tree.depth[0] < 0
    groups = np.empty_like(best)
    groups[order] = best
    return Optimum(groups, proven, nodes)


class _Tree:
    """Where the depth-first search stands, so that it can pause."""

    def __init__(self, robots: int, count: int) -> None:
        self.depth = np.zeros(1, dtype=np.int64)
        self.group = np.full(robots, -1, dtype=np.int64)
        self.tried = np.zeros((robots, count), dtype=np.bool_)
        self.lost = np.zeros(robots + 1)
        self.size = np.zeros(count, dtype=np.int64)
        self.pull = np.zeros((count, robots))

    def arrays(self) -> tuple[np.ndarray, ...]:
        return self.depth, self.group, self.tried, self.lost, self.size, self.pull


@njit(cache=True)
def _by_ties(weights):  # type: ignore[no-untyped-def]
    """Robots in maximum adjacency order, the one with the most overlap first."""
    count = weights.shape[0]
    order = np.empty(count, dtype=np.int64)
    ties = weights.sum(axis=1) * 1e-9
    for place in range(count):
        v = np.argmax(ties)
        order[place] = v
        ties[v] = -np.inf
        for u in range(count):
            ties[u] += weights[v, u]
    return order


@njit(cache=True)
def _bound(pull, size, room, bigger_left, depth):  # type: ignore[no-untyped-def]
    """Overlap that the robots from `depth` on must lose to those placed."""
    loss = 0.0
    for v in range(depth, pull.shape[1]):
        total = 0.0
        kept = 0.0
        for g in range(size.size):
            total += pull[g, v]
            if pull[g, v] > kept and (size[g] < room or (size[g] == room and bigger_left > 0)):
                kept = pull[g, v]
        loss += total - kept
    return loss


@njit(cache=True)
def _next_group(pull, size, tried, room, bigger_left, v):  # type: ignore[no-untyped-def]
    """The untried group with room that v is most drawn to; of the empty groups only the first counts; -1 for none."""
    best = -1
    empty_seen = False
    for g in range(size.size):
        if size[g] == 0:
            if empty_seen:
                continue
            empty_seen = True
        open_group = size[g] < room or (size[g] == room and bigger_left > 0)
        if open_group and not tried[g] and (best < 0 or pull[g, v] > pull[best, v]):
            best = g
    return best


@njit(cache=True)
def _put(weights, pull, size, v, g, sign):  # type: ignore[no-untyped-def]
    size[g] += sign
    for u in range(v + 1, pull.shape[1]):
        pull[g, u] += sign * weights[v, u]


@njit(cache=True)
def _search(weights, count, quota, best, limit, depth, group, tried, lost, size, pull):  # type: ignore[no-untyped-def]
    """Visit up to `quota` nodes. `depth[0]` is the robot to place next, -1 when the whole tree is done.

    Sizes are at most V // N, and one more for V mod N groups.
    """
    robots = weights.shape[0]
    room = robots // count
    bigger_left = robots % count - np.sum(size > room)
    v = depth[0]
    nodes = 0
    while v >= 0 and nodes < quota:
        if group[v] >= 0:  # back from the subtree below
            bigger_left += size[group[v]] > room
            _put(weights, pull, size, v, group[v], -1)
            group[v] = -1
        g = _next_group(pull, size, tried[v], room, bigger_left, v)
        if g < 0:
            tried[v, :] = False
            v -= 1
            continue
        tried[v, g] = True
        nodes += 1
        total = 0.0
        for other in range(count):
            total += pull[other, v]
        lost[v + 1] = lost[v] + total - pull[g, v]
        if lost[v + 1] >= limit[0]:
            continue
        group[v] = g
        _put(weights, pull, size, v, g, 1)
        bigger_left -= size[g] > room
        if v + 1 == robots:
            limit[0] = lost[robots]
            best[:] = group
        elif lost[v + 1] + _bound(pull, size, room, bigger_left, v + 1) < limit[0]:
            v += 1
    depth[0] = v
    return nodes
