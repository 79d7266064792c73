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
def best_swap(stages, plan, u, b, alone, added, mark, arrivals, latest, owner, limit):  # type: ignore[no-untyped-def]
    """(score, v) of the best swap of u with a robot fused on edge b, if its score is below `limit`; else v = -1.

    `alone` cells of its edge map only u covers, `added` it would add to that of b; `mark[cell] == u` for its cells.
    """
    a, slam_u = plan.fuse[u], plan.slam[u]
    slams, crowd, member, cover = plan.slam, plan.crowd, plan.member, plan.cover
    base, work, carried, lag, fetched = stages.base, stages.slam, stages.carried, stages.lag, stages.fetched
    first, cells, reachable, cell_m2 = stages.first, stages.cells, stages.reachable, stages.cell_m2
    per_map, per_pair, per_m2 = stages.fusion
    k_a, k_b = plan.maps[a], plan.maps[b]
    fixed_a = (per_map * k_a + per_pair * k_a * (k_a - 1) / 2) / stages.speed[a]
    fixed_b = (per_map * k_b + per_pair * k_b * (k_b - 1) / 2) / stages.speed[b]
    slope_a = (per_m2 / stages.speed[a] + stages.upload[a]) * cell_m2
    slope_b = (per_m2 / stages.speed[b] + stages.upload[b]) * cell_m2
    rest_a = latest[a, 1] if owner[a] == u else latest[a, 0]
    other_last, other_total, other_used = _others(arrivals, a, b)
    used = other_used + 2
    best = -1
    for place in range(k_b):
        v = member[b, place]
        slam_v = slams[v]
        if not (reachable[u, slam_v] and reachable[v, slam_u] and reachable[v, a]):
            continue
        new_u = base[u, slam_v] + work[u] * crowd[slam_v]
        if slam_v != b:
            new_u += carried[u] * lag[slam_v, b] * fetched[u, b]
        new_v = base[v, slam_u] + work[v] * crowd[slam_u]
        if slam_u != a:
            new_v += carried[v] * lag[slam_u, a] * fetched[v, a]
        rest_b = latest[b, 1] if owner[b] == v else latest[b, 0]
        least_a = max(rest_a, new_v) + fixed_a + slope_a * (plan.covered[a] - alone)
        least_b = max(rest_b, new_u) + fixed_b + slope_b * (plan.covered[b] + added - first[v + 1] + first[v])
        finish = max(other_last, least_a, least_b) + stages.merge[used]
        if finish + EVENNESS * (other_total + least_a + least_b) / used >= limit:
            continue
        brought = 0
        lost = 0
        for at in range(first[v], first[v + 1]):
            cell = cells[at]
            shared = mark[cell] == u
            brought += cover[a, cell] - shared == 0
            lost += cover[b, cell] == 1 and not shared
        at_a = least_a + slope_a * brought
        at_b = least_b + slope_b * (first[v + 1] - first[v] - lost)
        finish = max(other_last, at_a, at_b) + stages.merge[used]
        score = finish + EVENNESS * (other_total + at_a + at_b) / used
        if score < limit:
            limit = score
            best = v
    return limit, best
