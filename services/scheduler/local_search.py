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
    evaluate,
    plan_of,
    relocate,
)
from services.scheduler.costs import Ints
from services.scheduler.moves import best_move
from services.scheduler.swaps import best_swap, latest_two

STEP_WORK = 200_000
"""robots x robots x edges of work between two looks at the clock"""
KICK = 3
ROUND = 30
"""kicks of the first round of a tournament"""
PATIENCE = 100
TOLERANCE = 0.02
"""kicks in vain before they take a robot more"""
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
    """Iterated local search: a few random changes, a descent, back to the best if it was no better.

    Kicks grow, from KICK robots to a third of them and over again, as long as nothing better is found.
    """
    best = start
    plan = plan_of(stages, best.slam, best.fuse)
    _, best_score = evaluate(stages, plan, np.empty(stages.speed.size))
    base, base_score, idle = best, best_score, 0
    for _ in range(kicks):
        if spent() >= 1 or best.slam.size < 2 or stages.speed.size < 2:
            break
        _kick(stages, plan, rng)
        total, score = _to_optimum(stages, plan, spent)
        idle += 1
        if score < best_score - LEAST:
            best_score, idle = score, 0
            best = Found(plan.slam.copy(), plan.fuse.copy(), total)
        if score < base_score * (1.0 + TOLERANCE):
            base, base_score = Found(plan.slam.copy(), plan.fuse.copy(), total), score
        elif idle % PATIENCE == 0:
            base, base_score = best, best_score
        for v in np.flatnonzero((plan.slam != base.slam) | (plan.fuse != base.fuse)):
            relocate(stages, plan, v, base.slam[v], base.fuse[v])
    return best


def tournament(
    stages: Stages, starts: list[Found], kicks: int, rng: np.random.Generator, spent: Callable[[], float]
) -> Found:
    """The best of several local optima after a kicked search from each; the better half goes on, for twice as long.

    Which of them leads to the best is not to be seen from where they stand. `kicks` are those of the last one.
    """
    pool = sorted(starts, key=lambda found: found.total)
    turn = ROUND
    while len(pool) > 1 and spent() < 1:
        pool = sorted((kicked_search(stages, each, turn, rng, spent) for each in pool), key=lambda found: found.total)
        pool, turn = pool[: (len(pool) + 1) // 2], 2 * turn
    return kicked_search(stages, pool[0], kicks, rng, spent)


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
        best_score, u, v, slam, fuse = _best_change(stages, plan, arrivals, mark, score)
        if u < 0 or best_score >= score - LEAST:
            return total, score, True
        if v >= 0:
            slam, fuse = plan.slam[v], plan.fuse[v]
            relocate(stages, plan, v, plan.slam[u], plan.fuse[u])
        relocate(stages, plan, u, slam, fuse)
        total, score = evaluate(stages, plan, arrivals)
    return total, score, False


@njit(cache=True)
def _best_change(stages, plan, arrivals, mark, score):  # type: ignore[no-untyped-def]
    """(score, u, v, slam, fuse): robot u swaps with v, or with v = -1 goes to these edges; u = -1 for none."""
    best = (score, -1, -1, -1, -1)
    hot = np.argmax(arrivals)
    latest, owner = latest_two(stages, plan)
    crowded = plan.slam[owner[hot]] if owner[hot] >= 0 else hot
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
            moved, slam, fuse = best_move(stages, plan, u, edge, alone, added, arrivals, best[0])
            if slam >= 0:
                best = (moved, u, -1, slam, fuse)
            if edge != plan.fuse[u]:
                swapped, v = best_swap(stages, plan, u, edge, alone, added, mark, arrivals, latest, owner, best[0])
                if v >= 0:
                    best = (swapped, u, v, -1, -1)
    return best
