"""Simulated annealing over swaps, for graphs too big to look at all swaps.

A random robot is offered the place of a random member of a group that, mostly, one of its neighbours is in. A proposal
costs the bisection for one weight, an accepted one the degrees of both robots.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from services.scheduler.descent import Adjacency, between, exchange, pulls
from services.scheduler.graph import Groups

HOT, COLD = 0.8, 0.02
"""first and last temperature, in mean overlaps of a pair that overlaps"""
NEAR = 0.9
"""share of proposals towards a neighbour's group"""
BATCH = 20_000


def anneal(
    graph: Adjacency,
    groups: Groups,
    count: int,
    proposals: int,
    rng: np.random.Generator,
    spent: Callable[[], float] = lambda: 0.0,
) -> Groups:
    """A grouping of smaller cut from `groups`; the sizes stay.

    It cools over `proposals`, or over the time budget whose used share is `spent()`, whichever is further on.
    """
    found = groups.copy()
    if count < 2 or not len(graph.weights):
        return found
    begin = min(spent(), 1.0)
    pull = pulls(*graph, found, count)
    members = np.argsort(found, kind="stable").astype(np.int64)
    first = np.concatenate([[0], np.cumsum(np.bincount(found, minlength=count))]).astype(np.int64)
    place = np.empty_like(members)
    place[members] = np.arange(members.size)
    unit = float(graph.weights.mean())
    made = 0
    while made < proposals and (now := spent()) < 1.0:
        cooled = max(made / proposals, (now - begin) / max(1.0 - begin, 1e-9))
        temperature = unit * HOT * (COLD / HOT) ** cooled
        _propose(*graph, found, pull, members, first, place, temperature, BATCH, rng)
        made += BATCH
    return found


@njit(cache=True)
def _propose(starts, neighbours, weights, groups, pull, members, first, place, temperature, batch, rng):  # type: ignore[no-untyped-def]
    count = pull.shape[1]
    for _ in range(batch):
        u = int(rng.random() * groups.size)
        a = groups[u]
        degree = starts[u + 1] - starts[u]
        if degree > 0 and rng.random() < NEAR:
            b = groups[neighbours[starts[u] + int(rng.random() * degree)]]
        else:
            b = int(rng.random() * count)
        size = first[b + 1] - first[b]
        if a == b or size == 0:
            continue
        v = members[first[b] + int(rng.random() * size)]
        gain = pull[u, b] - pull[u, a] + pull[v, a] - pull[v, b]
        if gain < 0.0 and rng.random() >= np.exp(gain / temperature):
            continue  # the pair's own overlap only makes it worse
        own = 2.0 * between(starts, neighbours, weights, u, v)
        if own > 0.0 and rng.random() >= np.exp(min(0.0, gain - own) / temperature - min(0.0, gain) / temperature):
            continue
        exchange(starts, neighbours, weights, groups, pull, u, v)
        place[u], place[v] = place[v], place[u]
        members[place[u]] = u
        members[place[v]] = v
