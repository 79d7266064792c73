"""Multilevel recursive bisection with exact group sizes.

The graph is coarsened by matching heavy pairs, split at its coarsest by greedy growing, and refined on the way back by
Fiduccia-Mattheyses passes. Coarse levels may be out of balance by their heaviest vertex, the finest by nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.scheduler.descent import Adjacency
from services.scheduler.graph import Groups

COARSEST = 40
GROWINGS = 8
PASSES = 6
STALE = 60
"""moves without a better split after which a pass ends"""

Side = NDArray[np.int64]


class Level(NamedTuple):
    """A graph with vertex masses, and where its vertices went in the next coarser one."""

    graph: Adjacency
    mass: NDArray[np.int64]
    parent: NDArray[np.int64] | None


def recursive_bisection(graph: Adjacency, sizes: NDArray[np.int64], rng: np.random.Generator) -> Groups:
    """(V,) labels of a grouping with exactly `sizes[g]` robots in group g and a small cut."""
    groups = np.zeros(len(graph.starts) - 1, dtype=np.int64)
    pending = [(np.arange(groups.size), 0, len(sizes))]
    while pending:
        members, first, last = pending.pop()
        if last - first < 2 or not members.size:
            groups[members] = first
            continue
        middle = (first + last) // 2
        part = Adjacency(*_subgraph(*graph, members, groups.size))
        side = bisect(part, int(sizes[first:middle].sum()), rng)
        pending.append((members[side == 0], first, middle))
        pending.append((members[side == 1], middle, last))
    return groups


def bisect(graph: Adjacency, target: int, rng: np.random.Generator) -> Side:
    """(V,) 0 or 1 with exactly `target` zeros."""
    levels = _coarsen(graph, rng)
    side = _first_split(levels[-1], target, rng)
    for finer in reversed(levels[:-1]):
        side = side[finer.parent]
        slack = int(finer.mass.max(initial=1)) - 1
        _refine(*finer.graph, finer.mass, side, target, slack, PASSES)
    if len(levels) == 1:
        _refine(*graph, levels[0].mass, side, target, 0, PASSES)
    return side


def _coarsen(graph: Adjacency, rng: np.random.Generator) -> list[Level]:
    mass = np.ones(len(graph.starts) - 1, dtype=np.int64)
    heaviest = max(2, int(1.5 * mass.size / COARSEST))
    levels = []
    while mass.size > COARSEST:
        parent, count = _match(*graph, mass, heaviest, rng.permutation(mass.size))
        if count > 0.95 * mass.size:
            break
        levels.append(Level(graph, mass, parent))
        *rows, mass = _contract(*graph, mass, parent, count)
        graph = Adjacency(*rows)
    return [*levels, Level(graph, mass, None)]


def _first_split(level: Level, target: int, rng: np.random.Generator) -> Side:
    """The best of several greedy growings, each refined."""
    slack = int(level.mass.max(initial=1)) - 1
    best, best_score = np.zeros(level.mass.size, dtype=np.int64), (np.inf, np.inf)
    for _ in range(GROWINGS):
        side = _grow(*level.graph, level.mass, target, int(rng.integers(level.mass.size)))
        score = _refine(*level.graph, level.mass, side, target, slack, PASSES)
        if score < best_score:
            best, best_score = side, score
    return best


@njit(cache=True)
def _subgraph(starts, neighbours, weights, members, count):  # type: ignore[no-untyped-def]
    index = np.full(count, -1, dtype=np.int64)
    index[members] = np.arange(members.size)
    room = 0
    for v in members:
        room += starts[v + 1] - starts[v]
    out_starts = np.zeros(members.size + 1, dtype=np.int64)
    out_neighbours = np.empty(room, dtype=np.int64)
    out_weights = np.empty(room)
    used = 0
    for at in range(members.size):
        for edge in range(starts[members[at]], starts[members[at] + 1]):
            if index[neighbours[edge]] >= 0:
                out_neighbours[used] = index[neighbours[edge]]
                out_weights[used] = weights[edge]
                used += 1
        out_starts[at + 1] = used
    return out_starts, out_neighbours[:used].copy(), out_weights[:used].copy()


@njit(cache=True)
def _match(starts, neighbours, weights, mass, heaviest, order):  # type: ignore[no-untyped-def]
    """Heavy-edge matching: each free vertex with its free neighbour of most overlap."""
    parent = np.full(mass.size, -1, dtype=np.int64)
    count = 0
    for v in order:
        if parent[v] >= 0:
            continue
        mate = -1
        best = 0.0
        for edge in range(starts[v], starts[v + 1]):
            u = neighbours[edge]
            if parent[u] < 0 and weights[edge] > best and mass[u] + mass[v] <= heaviest:
                mate = u
                best = weights[edge]
        parent[v] = count
        if mate >= 0:
            parent[mate] = count
        count += 1
    return parent, count


@njit(cache=True)
def _contract(starts, neighbours, weights, mass, parent, count):  # type: ignore[no-untyped-def]
    first = np.full(count, -1, dtype=np.int64)
    second = np.full(count, -1, dtype=np.int64)
    new_mass = np.zeros(count, dtype=np.int64)
    for v in range(mass.size):
        new_mass[parent[v]] += mass[v]
        if first[parent[v]] < 0:
            first[parent[v]] = v
        else:
            second[parent[v]] = v
    out_starts = np.zeros(count + 1, dtype=np.int64)
    out_neighbours = np.empty(neighbours.size, dtype=np.int64)
    out_weights = np.empty(neighbours.size)
    where = np.full(count, -1, dtype=np.int64)
    used = 0
    for coarse in range(count):
        begin = used
        for v in (first[coarse], second[coarse]):
            if v < 0:
                continue
            for edge in range(starts[v], starts[v + 1]):
                u = parent[neighbours[edge]]
                if u == coarse:
                    continue
                if where[u] < begin:
                    where[u] = used
                    out_neighbours[used] = u
                    out_weights[used] = 0.0
                    used += 1
                out_weights[where[u]] += weights[edge]
        out_starts[coarse + 1] = used
    return out_starts, out_neighbours[:used].copy(), out_weights[:used].copy(), new_mass


@njit(cache=True)
def _grow(starts, neighbours, weights, mass, target, seed):  # type: ignore[no-untyped-def]
    """Side 0 grows from `seed` by what it is most drawn to until it has the target mass."""
    side = np.ones(mass.size, dtype=np.int64)
    drawn = np.zeros(mass.size)
    v = seed
    grown = 0
    while v >= 0 and grown + mass[v] // 2 < target:
        side[v] = 0
        grown += mass[v]
        for edge in range(starts[v], starts[v + 1]):
            drawn[neighbours[edge]] += 2.0 * weights[edge]
        v = -1
        best = -np.inf
        for u in range(mass.size):
            if side[u] == 1:
                degree = 0.0
                for edge in range(starts[u], starts[u + 1]):
                    degree += weights[edge]
                if drawn[u] - degree > best:
                    best = drawn[u] - degree
                    v = u
    return side


@njit(cache=True)
def _best_move(gain, mass, side, locked, excess, reach):  # type: ignore[no-untyped-def]
    """The free vertex of most gain whose move keeps the split within `reach` of balance, or mends it; -1 for none."""
    best = -1
    for v in range(mass.size):
        if locked[v]:
            continue
        after = excess - mass[v] if side[v] == 0 else excess + mass[v]
        if (abs(after) <= reach or abs(after) < abs(excess)) and (best < 0 or gain[v] > gain[best]):
            best = v
    return best


@njit(cache=True)
def _flip(starts, neighbours, weights, side, gain, v):  # type: ignore[no-untyped-def]
    side[v] = 1 - side[v]
    gain[v] = -gain[v]
    for edge in range(starts[v], starts[v + 1]):
        u = neighbours[edge]
        gain[u] += -2.0 * weights[edge] if side[u] == side[v] else 2.0 * weights[edge]


@njit(cache=True)
def _gains(starts, neighbours, weights, side):  # type: ignore[no-untyped-def]
    """(V,) by how much each vertex would lower the cut on the other side, and the cut."""
    gain = np.zeros(side.size)
    cut = 0.0
    for v in range(side.size):
        for edge in range(starts[v], starts[v + 1]):
            if side[neighbours[edge]] == side[v]:
                gain[v] -= weights[edge]
            else:
                gain[v] += weights[edge]
                cut += weights[edge] / 2
    return gain, cut


@njit(cache=True)
def _refine(starts, neighbours, weights, mass, side, target, slack, passes):  # type: ignore[no-untyped-def]
    """Fiduccia-Mattheyses in place; returns (mass out of balance beyond `slack`, cut)."""
    count = mass.size
    gain, cut = _gains(starts, neighbours, weights, side)
    excess = mass[side == 0].sum() - target
    reach = slack + mass.max()
    moves = np.empty(count, dtype=np.int64)
    for _ in range(passes):
        locked = np.zeros(count, dtype=np.bool_)
        best_over, best_cut, best_at, begin_cut = max(0, abs(excess) - slack), cut, 0, cut
        begin_over = best_over
        made = 0
        while made < count and made - best_at < STALE:
            v = _best_move(gain, mass, side, locked, excess, reach)
            if v < 0:
                break
            cut -= gain[v]
            excess += -mass[v] if side[v] == 0 else mass[v]
            _flip(starts, neighbours, weights, side, gain, v)
            locked[v] = True
            moves[made] = v
            made += 1
            over = max(0, abs(excess) - slack)
            if over < best_over or (over == best_over and cut < best_cut):
                best_over, best_cut, best_at = over, cut, made
        while made > best_at:
            made -= 1
            v = moves[made]
            cut -= gain[v]
            excess += -mass[v] if side[v] == 0 else mass[v]
            _flip(starts, neighbours, weights, side, gain, v)
        if best_over == begin_over and best_cut == begin_cut:
            break
    return max(0, abs(excess) - slack), cut
