"""What sending one robot's SLAM, its map, or both to another edge would do to t_c, without doing it."""

from __future__ import annotations

from numba import njit

from services.scheduler.completion import EVENNESS


@njit(cache=True)
def best_move(stages, plan, u, to, alone, added, arrivals, limit):  # type: ignore[no-untyped-def]
    """(score, slam, fuse) of the best way to send robot u to edge `to`, if below `limit`; else slam = -1.

    `alone` cells of its edge map only u covers, `added` it would add to that of `to`.
    """
    a, b = plan.slam[u], plan.fuse[u]
    best_slam, best_fuse = -1, -1
    for kind in range(3):
        slam = a if kind == 1 else to
        fuse = b if kind == 2 else to
        if slam == a and fuse == b:
            continue
        stretch_a, stretch = _stretches(plan.running, plan.crowd, stages.cores, stages.speed, a, slam)
        crowded = stretch_a != plan.crowd[a] or stretch != plan.crowd[slam]
        latest, total, used = 0.0, 0.0, 0
        for edge in range(arrivals.size):
            time = arrivals[edge]
            if edge in (b, fuse) or (crowded and (plan.linked[a, edge] > 0 or plan.linked[slam, edge] > 0)):
                time = _arrival_after(stages, plan, edge, u, slam, fuse, alone, added, stretch_a, stretch)
            latest = max(latest, time)
            total += time
            used += time > 0.0
        score = latest + stages.merge[used] + EVENNESS * total / max(used, 1)
        if score < limit:
            limit, best_slam, best_fuse = score, slam, fuse
    return limit, best_slam, best_fuse


@njit(cache=True)
def _stretches(running, crowd, cores, speed, old, new):  # type: ignore[no-untyped-def]
    """By how much two edges stretch SLAM once one instance has gone from the one to the other."""
    if old == new:
        return crowd[old], crowd[new]
    emptier = max(1.0, (running[old] - 1) / cores[old]) / speed[old]
    fuller = max(1.0, (running[new] + 1) / cores[new]) / speed[new]
    return emptier, fuller


@njit(cache=True)
def _arrival_after(stages, plan, edge, u, slam, fuse, alone, added, stretch_a, stretch):  # type: ignore[no-untyped-def]
    """When this edge's map is at the cloud once robot u has gone to `slam` and `fuse`."""
    a, k, cells = plan.slam[u], plan.maps[edge], plan.covered[edge]
    last = 0.0
    slams, crowd, member, base, work = plan.slam, plan.crowd, plan.member, stages.base, stages.slam
    for place in range(k):
        v = member[edge, place]
        if v != u:
            at = slams[v]
            done = base[v, at] + work[v] * (stretch_a if at == a else stretch if at == slam else crowd[at])
            if at != edge:
                done += stages.carried[v] * stages.lag[at, edge] * stages.fetched[v, edge]
            last = max(last, done)
    if edge == fuse:
        own = base[u, slam] + work[u] * stretch
        if slam != fuse:
            own += stages.carried[u] * stages.lag[slam, fuse] * stages.fetched[u, fuse]
        last = max(last, own)
    if plan.fuse[u] != fuse and edge in (plan.fuse[u], fuse):
        k, cells = (k + 1, cells + added) if edge == fuse else (k - 1, cells - alone)
    if k == 0:
        return 0.0
    area = cells * stages.cell_m2
    fusing = stages.fusion[0] * k + stages.fusion[1] * k * (k - 1) / 2 + stages.fusion[2] * area
    return last + fusing / stages.speed[edge] + area * stages.upload[edge]
