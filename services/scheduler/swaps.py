"""What swapping two robots would do to t_c, without doing it.

A swap exchanges both edges of two robots whose maps are fused apart. It leaves every edge's load as it is, so only the
two edge maps arrive at another time; with the two latest robots of each edge known, a swap costs the cells of one map.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from services.scheduler.completion import EVENNESS, ready


@njit(cache=True)
def latest_two(stages, plan):  # type: ignore[no-untyped-def]
    """(E, 2) when an edge's last robot map and the one before it are there, and (E,) whose is the last; -1 for none."""
    edges = stages.speed.size
    latest = np.zeros((edges, 2))
    owner = np.full(edges, -1, dtype=np.int64)
    for v in range(plan.fuse.size):
        edge = plan.fuse[v]
        time = ready(stages, plan, v)
        if owner[edge] < 0 or time > latest[edge, 0]:
            latest[edge, 1] = latest[edge, 0]
            latest[edge, 0] = time
            owner[edge] = v
        else:
            latest[edge, 1] = max(latest[edge, 1], time)
    return latest, owner


@njit(cache=True)
def _others(arrivals, a, b):  # type: ignore[no-untyped-def]
    """(latest, sum, number) of the arrivals of the edges other than a and b that fuse something."""
    last = 0.0
    total = 0.0
    used = 0
    for edge in range(arrivals.size):
        if edge not in (a, b):
            last = max(last, arrivals[edge])
            total += arrivals[edge]
            used += arrivals[edge] > 0.0
    return last, total, used


@njit(cache=True)
def _edge_work(stages, plan, edge):  # type: ignore[no-untyped-def]
    """(seconds of fusion by number of maps, seconds a cell of the edge map takes for fusion and upload)."""
    k, speed = plan.maps[edge], stages.speed[edge]
    fixed = (stages.fusion[0] * k + stages.fusion[1] * k * (k - 1) / 2) / speed
    return fixed, (stages.fusion[2] / speed + stages.upload[edge]) * stages.cell_m2


@njit(cache=True)
def _cells_exchanged(own, mark, u, cover_a, cover_b):  # type: ignore[no-untyped-def]
    """Cells that a robot brings to the map of edge a without u, and cells that edge b's loses that u does not have."""
    brought = 0
    lost = 0
    for cell in own:
        shared = mark[cell] == u
        brought += cover_a[cell] - shared == 0
        lost += cover_b[cell] == 1 and not shared
    return brought, lost


@njit(cache=True)
def best_swap(stages, plan, u, b, alone, added, mark, arrivals, latest, owner, limit):  # type: ignore[no-untyped-def]
    """(score, v) of the best swap of u with a robot fused on edge b, if its score is below `limit`; else v = -1.

    `alone` cells of its edge map only u covers, `added` it would add to that of b; `mark[cell] == u` for its cells.
    """
    a, slam_u = plan.fuse[u], plan.slam[u]
    base, work, crowd, carried, fetched = stages.base, stages.slam, plan.crowd, stages.carried, stages.fetched
    first, cells, reachable, lag = stages.first, stages.cells, stages.reachable, stages.lag
    fixed_a, slope_a = _edge_work(stages, plan, a)
    fixed_b, slope_b = _edge_work(stages, plan, b)
    rest_a = latest[a, 1] if owner[a] == u else latest[a, 0]
    other_last, other_total, other_used = _others(arrivals, a, b)
    used, best = other_used + 2, -1
    for place in range(plan.maps[b]):
        v = plan.member[b, place]
        slam_v = plan.slam[v]
        if not (reachable[u, slam_v] and reachable[v, slam_u] and reachable[v, a]):
            continue
        new_u = base[u, slam_v] + work[u] * crowd[slam_v] + carried[u] * lag[slam_v, b] * fetched[u, b]
        new_v = base[v, slam_u] + work[v] * crowd[slam_u] + carried[v] * lag[slam_u, a] * fetched[v, a]
        rest_b = latest[b, 1] if owner[b] == v else latest[b, 0]
        at_a = max(rest_a, new_v) + fixed_a + slope_a * (plan.covered[a] - alone)
        at_b = max(rest_b, new_u) + fixed_b + slope_b * (plan.covered[b] + added - (first[v + 1] - first[v]))
        least = max(other_last, at_a, at_b) + stages.merge[used]
        if least + EVENNESS * (other_total + at_a + at_b) / used >= limit:
            continue  # however their cells lie
        brought, lost = _cells_exchanged(cells[first[v] : first[v + 1]], mark, u, plan.cover[a], plan.cover[b])
        at_a += slope_a * brought
        at_b += slope_b * (first[v + 1] - first[v] - lost)
        score = max(other_last, at_a, at_b) + stages.merge[used] + EVENNESS * (other_total + at_a + at_b) / used
        if score < limit:
            limit, best = score, v
    return limit, best
