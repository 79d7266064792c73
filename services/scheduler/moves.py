"""What sending one robot's SLAM, its map, or both to another edge would do to t_c, without doing it."""

from __future__ import annotations

from numba import njit

from services.scheduler.completion import EVENNESS


@njit(cache=True)
def best_move(stages, plan, u, to, alone, added, arrivals, limit):  # type: ignore[no-untyped-def]
    """(score, slam, fuse) of the best way to send robot u to edge `to`, if below `limit`; else slam = -1.

    `alone` cells of its edge map only u covers, `added` it would add to that of `to`.
    """
    old_slam, old_fuse = plan.slam[u], plan.fuse[u]
    slams, crowd, member, maps, running = plan.slam, plan.crowd, plan.member, plan.maps, plan.running
    base, work, carried, lag, fetched = stages.base, stages.slam, stages.carried, stages.lag, stages.fetched
    speed, upload, cores, linked, covered = stages.speed, stages.upload, stages.cores, plan.linked, plan.covered
    per_map, per_pair, per_m2 = stages.fusion
    best_slam, best_fuse = -1, -1
    for kind in range(3):
        slam = old_slam if kind == 1 else to
        fuse = old_fuse if kind == 2 else to
        if slam == old_slam and fuse == old_fuse:
            continue
        emptier, fuller = crowd[old_slam], crowd[slam]
        if slam != old_slam:
            emptier = max(1.0, (running[old_slam] - 1) / cores[old_slam]) / speed[old_slam]
            fuller = max(1.0, (running[slam] + 1) / cores[slam]) / speed[slam]
        stretched = emptier != crowd[old_slam] or fuller != crowd[slam]
        own = base[u, slam] + work[u] * fuller
        if slam != fuse:
            own += carried[u] * lag[slam, fuse] * fetched[u, fuse]
        latest, total, used = 0.0, 0.0, 0
        for edge in range(arrivals.size):
            time = arrivals[edge]
            moved = edge in (old_fuse, fuse)
            if moved or (stretched and (linked[old_slam, edge] > 0 or linked[slam, edge] > 0)):
                last = own if edge == fuse else 0.0
                for place in range(maps[edge]):
                    v = member[edge, place]
                    if v == u:
                        continue
                    at = slams[v]
                    stretch = emptier if at == old_slam else fuller if at == slam else crowd[at]
                    done = base[v, at] + work[v] * stretch
                    if at != edge:
                        done += carried[v] * lag[at, edge] * fetched[v, edge]
                    last = max(last, done)
                k, cells = maps[edge], covered[edge]
                if old_fuse != fuse and edge == old_fuse:
                    k, cells = k - 1, cells - alone
                elif old_fuse != fuse and edge == fuse:
                    k, cells = k + 1, cells + added
                area = cells * stages.cell_m2
                time = 0.0
                if k > 0:
                    fusing = per_map * k + per_pair * k * (k - 1) / 2 + per_m2 * area
                    time = last + fusing / speed[edge] + area * upload[edge]
            latest = max(latest, time)
            total += time
            used += time > 0.0
        score = latest + stages.merge[used] + EVENNESS * total / max(used, 1)
        if score < limit:
            limit, best_slam, best_fuse = score, slam, fuse
    return limit, best_slam, best_fuse
