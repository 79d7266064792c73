"""Among plans of about one completion time, the one that fuses together what overlaps.

The completion time says little about who is fused with whom when links are fast, but an edge can only match maps that
share something, and the cloud gets what edges have not matched.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from services.scheduler.costs import Ints, Problem, predict
from services.scheduler.graph import Groups, Weights, cut


def closest(
    problem: Problem,
    weights: Weights,
    slam: Ints,
    fuse: Ints,
    groups: Groups,
    bound: float,
    spent: Callable[[], float],
    most: Ints | None = None,
) -> Ints:
    """(V,) fusing edges of the smallest cut that is reached from `fuse` or from these groups within the bound.

    `most`: (E,) robots that a move may bring an edge to; swaps leave sizes as they are.
    """
    every, named = np.arange(len(fuse)), relabelled(groups, fuse, problem.reachable)
    starts = [fuse, np.where(problem.reachable[every, named], named, fuse)]
    within = [each for each in starts if predict(problem, slam, each).total <= bound]
    found = [closer(problem, weights, slam, each, bound, spent, most) for each in within]
    return min(found, key=lambda each: cut(weights, each))


def closer(
    problem: Problem,
    weights: Weights,
    slam: Ints,
    fuse: Ints,
    bound: float,
    spent: Callable[[], float],
    most: Ints | None = None,
) -> Ints:
    """(V,) fusing edges of a smaller cut (Eq. 5) with a predicted t_c of at most `bound`; `slam` stays.

    Steepest descent over moves of one robot and swaps of two, while `spent()` is below 1.
    """
    fuse = fuse.copy()
    while spent() < 1 and (better := _step(problem, weights, slam, fuse, bound, spent, most)) is not None:
        fuse = better
    return fuse


def _step(
    problem: Problem,
    weights: Weights,
    slam: Ints,
    fuse: Ints,
    bound: float,
    spent: Callable[[], float],
    most: Ints | None,
) -> Ints | None:
    """The change that lowers the cut the most within the bound."""
    robots, edges = len(fuse), len(problem.edges)
    every = np.arange(robots)
    member = np.zeros((robots, edges))
    member[every, fuse] = 1
    pull = weights @ member
    gain = np.where(problem.reachable, pull - pull[every, fuse][:, None], -np.inf)
    gain[every, fuse] = 0.0
    swap = gain[:, fuse] + gain[:, fuse].T - 2 * weights
    swap = np.where(np.isfinite(swap) & (fuse[:, None] < fuse[None, :]), swap, 0.0)
    moving = gain > 0 if most is None else (gain > 0) & (member.sum(axis=0) < most)
    moves = np.stack([*np.nonzero(moving), np.full(moving.sum(), -1)], axis=1)
    firsts, seconds = np.nonzero(swap > 0)
    swaps = np.stack([firsts, fuse[seconds], seconds], axis=1)
    gains = np.concatenate([gain[moving], swap[firsts, seconds]])
    changes = np.concatenate([moves, swaps])
    for robot, edge, other in changes[np.argsort(-gains, kind="stable")]:
        if spent() >= 1:
            return None
        tried = fuse.copy()
        tried[robot] = edge
        if other >= 0:
            tried[other] = fuse[robot]
        if predict(problem, slam, tried).total <= bound:
            return tried
    return None


def relabelled(groups: Groups, present: Ints, reachable: NDArray[np.bool_]) -> Ints:
    """The same groups on such edges that most robots stay where they are fused now; reachability is kept."""
    count = reachable.shape[1]
    stay = np.zeros((count, count))
    for group in range(count):
        members = groups == group
        for edge in range(count):
            stay[group, edge] = (members & (present == edge)).sum()
            if not reachable[members, edge].all():
                stay[group, edge] = -1e6
    _, edge_of = linear_sum_assignment(stay, maximize=True)
    mapped = edge_of[groups]
    reached = reachable[np.arange(len(mapped)), mapped]
    return np.where(reached, mapped, groups)
