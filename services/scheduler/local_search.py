"""Local search on the predicted t_c itself: changes that involve the slowest edge, and kicks out of local optima.

A move sends a robot's SLAM, its map, or both elsewhere; a swap exchanges two robots' edges. No robot goes out of reach.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from services.scheduler.completion import (
    Plan,
    Stages,
    cells_alone,
    cells_new,
    cells_swapped,
    evaluate,
    plan_of,
    ready,
    relocate,
    set_edges,
)
from services.scheduler.costs import Ints

STEP_WORK = 200_000
"""robots x robots x edges of work between two looks at the clock"""
KICK = 3
LEAST = 1e-9
"""seconds; smaller gains are rounding"""


class Found(NamedTuple):
    slam: Ints
    fuse: Ints
    total: float
    """t_c"""


def descend(stages: Stages, slam: Ints, fuse: Ints, spent: Callable[[], float]) -> Found:
    """Best improving change after best improving change, to a local optimum or until `spent()` reaches 1."""
    plan = plan_of(stages, slam, fuse)
    total, _ = _to_optimum(stages, plan, spent)
    return Found(plan.slam, plan.fuse, total)


def kicked_search(
    stages: Stages, start: Found, kicks: int, rng: np.random.Generator, spent: Callable[[], float]
) -> Found:
    """Iterated local search: a few random changes, a descent, back to the best if it was no better."""
    best = start
    plan = plan_of(stages, best.slam, best.fuse)
    _, best_score = evaluate(stages, plan, np.empty(stages.speed.size))
    for _ in range(kicks):
        if spent() >= 1 or best.slam.size < 2 or stages.speed.size < 2:
            break
        _kick(stages, plan, rng)
        total, score = _to_optimum(stages, plan, spent)
        if score < best_score - LEAST:
            best_score = score
            if total <= best.total:
                best = Found(plan.slam.copy(), plan.fuse.copy(), total)
        else:
            for v in np.flatnonzero((plan.slam != best.slam) | (plan.fuse != best.fuse)):
                relocate(stages, plan, v, best.slam[v], best.fuse[v])
    return best


def _to_optimum(stages: Stages, plan: Plan, spent: Callable[[], float]) -> tuple[float, float]:
    robots, edges = stages.base.shape
    steps = max(1, STEP_WORK // max(1, robots * robots * edges))
    total, score, at_optimum = _steps(stages, plan, steps)
    while not at_optimum and spent() < 1:
        total, score, at_optimum = _steps(stages, plan, steps)
    return total, score


def _kick(stages: Stages, plan: Plan, rng: np.random.Generator) -> None:
    for v in rng.integers(plan.slam.size, size=KICK):
        edge = int(rng.choice(np.flatnonzero(stages.reachable[v])))
        relocate(stages, plan, v, edge, edge)


@njit(cache=True)
def _steps(stages, plan, limit):  # type: ignore[no-untyped-def]
    """Up to `limit` improving changes; returns (t_c, score, no change improves)."""
    arrivals = np.zeros(stages.speed.size)
    mark = np.full(plan.cover.shape[1], -1, dtype=np.int64)
    total, score = evaluate(stages, plan, arrivals)
    for _ in range(limit):
        hot = np.argmax(arrivals)
        best_score, u, v, slam, fuse = _best_change(stages, plan, hot, mark, score)
        if u < 0 or best_score >= score - LEAST:
            return total, score, True
        if v >= 0:
            slam, fuse = plan.slam[v], plan.fuse[v]
            relocate(stages, plan, v, plan.slam[u], plan.fuse[u])
        relocate(stages, plan, u, slam, fuse)
        total, score = evaluate(stages, plan, arrivals)
    return total, score, False


@njit(cache=True)
def _crowded(stages, plan, hot):  # type: ignore[no-untyped-def]
    """The SLAM edge of the robot that the hot edge waits for."""
    last = -1
    latest = -1.0
    for v in range(plan.slam.size):
        if plan.fuse[v] == hot:
            at = ready(stages, plan, v)
            if at > latest:
                latest = at
                last = v
    return plan.slam[last] if last >= 0 else hot


@njit(cache=True)
def _best_change(stages, plan, hot, mark, score):  # type: ignore[no-untyped-def]
    """(score, u, v, slam, fuse): robot u swaps with v, or with v = -1 goes to these edges; u = -1 for none."""
    scratch = np.zeros(stages.speed.size)
    best = (score, -1, -1, -1, -1)
    crowded = _crowded(stages, plan, hot)
    for u in range(plan.slam.size):
        if plan.fuse[u] != hot and plan.slam[u] != crowded:
            continue
        for at in range(stages.first[u], stages.first[u + 1]):
            mark[stages.cells[at]] = u
        alone = cells_alone(stages, plan, u)
        for edge in range(stages.speed.size):
            if not stages.reachable[u, edge]:
                continue
            added = alone if edge == plan.fuse[u] else cells_new(stages, plan, u, edge)
            best = _try_moves(stages, plan, u, edge, alone, added, scratch, best)
            for v in range(plan.slam.size):
                if plan.fuse[v] == edge and edge != plan.fuse[u] and _may_swap(stages, plan, u, v):
                    best = _try_swap(stages, plan, u, v, alone, added, mark, scratch, best)
    return best


@njit(cache=True)
def _may_swap(stages, plan, u, v):  # type: ignore[no-untyped-def]
    return stages.reachable[u, plan.slam[v]] and stages.reachable[v, plan.slam[u]] and stages.reachable[v, plan.fuse[u]]


@njit(cache=True)
def _try_moves(stages, plan, u, edge, alone, added, scratch, best):  # type: ignore[no-untyped-def]
    """Robot u's SLAM, its map, or both to `edge`."""
    slam = plan.slam[u]
    fuse = plan.fuse[u]
    for kind in range(3):
        to_slam = slam if kind == 1 else edge
        to_fuse = fuse if kind == 2 else edge
        if to_slam == slam and to_fuse == fuse:
            continue
        plan.covered[fuse] -= alone
        plan.covered[to_fuse] += added if to_fuse != fuse else alone
        set_edges(plan, u, to_slam, to_fuse)
        _, score = evaluate(stages, plan, scratch)
        set_edges(plan, u, slam, fuse)
        plan.covered[to_fuse] -= added if to_fuse != fuse else alone
        plan.covered[fuse] += alone
        if score < best[0]:
            best = (score, u, -1, to_slam, to_fuse)
    return best


@njit(cache=True)
def _try_swap(stages, plan, u, v, alone, added, mark, scratch, best):  # type: ignore[no-untyped-def]
    """Exchange the edges of u and v, whose maps are fused on different edges."""
    a_slam, a_fuse = plan.slam[u], plan.fuse[u]
    b_slam, b_fuse = plan.slam[v], plan.fuse[v]
    brought, lost = cells_swapped(stages, plan, mark, u, v)
    plan.covered[a_fuse] += brought - alone
    plan.covered[b_fuse] += added - lost
    set_edges(plan, u, b_slam, b_fuse)
    set_edges(plan, v, a_slam, a_fuse)
    _, score = evaluate(stages, plan, scratch)
    set_edges(plan, u, a_slam, a_fuse)
    set_edges(plan, v, b_slam, b_fuse)
    plan.covered[a_fuse] -= brought - alone
    plan.covered[b_fuse] -= added - lost
    if score < best[0]:
        best = (score, u, v, -1, -1)
    return best
