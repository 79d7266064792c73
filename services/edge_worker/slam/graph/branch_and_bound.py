"""The best pose of a point set on a large lattice, without looking at most of it (Hess et al. 2016, Algorithm 3).

A pyramid level holds at each cell the largest likelihood of the 2^level cells each way from it: a bound from
above for all positions of a block. Blocks are visited best bound first and dropped when they cannot win.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.scan import Points

LEVELS = 5
COARSE = 0.1
"""m per cell"""


@njit(cache=True)
def pyramid(field: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(LEVELS, size, size) of a torus field of half the cell size, (2 size, 2 size)."""
    size = len(field) // 2
    out = np.empty((LEVELS, size, size), np.uint8)
    row = np.empty(2 * size, np.uint8)
    for j in range(size):
        _larger(field[2 * j], field[2 * j + 1], row)
        for i in range(size):
            out[0, j, i] = max(row[2 * i], row[2 * i + 1])
    row = row[:size]
    for level in range(1, LEVELS):
        half = 1 << (level - 1)
        below, here = out[level - 1], out[level]
        for j in range(size):
            _larger(below[j], below[(j + half) & (size - 1)], row)
            _larger(row[:-half], row[half:], here[j])
            _larger(row[-half:], row[:half], here[j, -half:])
    return out


@njit(cache=True)
def _larger(a: NDArray[np.uint8], b: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """The larger ones of `a` and `b` (n,), into the first n of `out`: a loop that compiles to vector instructions."""
    for k in range(len(a)):
        out[k] = a[k] if a[k] > b[k] else b[k]


@njit(cache=True)
def search(
    levels: NDArray[np.uint8],
    points: Points,
    guess: NDArray[np.float64],
    reach: float,
    turn: float,
    turn_step: float,
    floor: float,
    taken: NDArray[np.float64],
    taken_reach: float,
) -> tuple[NDArray[np.float64], float]:
    """The lattice pose (3,) with the best mean likelihood over `floor`, within `reach` m and `turn` rad of `guess`.

    Poses less than `taken_reach` m from the point `taken` (2,) do not count (0: all do). Returns the guess and
    `floor` when nothing is better.
    """
    turns = int(np.ceil(turn / turn_step))
    blocks = int(np.ceil(reach / COARSE)) >> (LEVELS - 1)
    side = 2 * blocks + 2
    cells = _turned(points, guess, turns, turn_step)
    bounds = np.empty(len(cells) * side * side)
    for root in range(len(bounds)):
        a, i, j = _block(root, side)
        bounds[root] = _score(levels[LEVELS - 1], cells[a], i, j)
    best, best_score = guess.copy(), floor
    for root in np.argsort(-bounds):
        if bounds[root] <= best_score:
            break
        a, i, j = _block(root, side)
        found_i, found_j, score = _descend(
            levels, cells[a], i, j, bounds[root], best_score, guess, reach, taken, taken_reach
        )
        if score > best_score:
            best_score = score
            best[0], best[1] = guess[0] + COARSE * found_i, guess[1] + COARSE * found_j
            best[2] = guess[2] + (a - turns) * turn_step
    return best, best_score


@njit(cache=True)
def _turned(points: Points, guess: NDArray[np.float64], turns: int, turn_step: float) -> NDArray[np.int32]:
    """Cells (2 turns + 1, n, 2) of the points at the guess, turned by each step of the lattice."""
    cells = np.empty((2 * turns + 1, len(points), 2), np.int32)
    for a in range(2 * turns + 1):
        theta = guess[2] + (a - turns) * turn_step
        c, s = np.cos(theta), np.sin(theta)
        for k in range(len(points)):
            cells[a, k, 0] = int(np.floor((guess[0] + c * points[k, 0] - s * points[k, 1]) / COARSE))
            cells[a, k, 1] = int(np.floor((guess[1] + s * points[k, 0] + c * points[k, 1]) / COARSE))
    return cells


@njit(cache=True)
def _block(root: int, side: int) -> tuple[int, int, int]:
    """Turn, and first cell (i, j) off the guess, of a block of the coarsest level; there are `side` each way."""
    size, half = 1 << (LEVELS - 1), side // 2
    return root // (side * side), (root % side - half) * size, ((root // side) % side - half) * size


@njit(cache=True)
def _descend(
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    i: int,
    j: int,
    bound: float,
    floor: float,
    guess: NDArray[np.float64],
    reach: float,
    taken: NDArray[np.float64],
    taken_reach: float,
) -> tuple[int, int, float]:
    """The best cell of one block, best quarters first, and its score; `floor` when none is better."""
    best_i, best_j, best = i, j, floor
    stack, bounds = np.empty((4 * LEVELS, 3), np.int64), np.empty(4 * LEVELS)
    stack[0, 0], stack[0, 1], stack[0, 2], bounds[0] = i, j, LEVELS - 1, bound
    depth = 1
    while depth > 0:
        depth -= 1
        i, j, level = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if bounds[depth] <= best:
            continue
        if level == 0:
            x, y = guess[0] + COARSE * i - taken[0], guess[1] + COARSE * j - taken[1]
            if max(abs(i), abs(j)) * COARSE <= reach and np.hypot(x, y) >= taken_reach:
                best_i, best_j, best = i, j, bounds[depth]
            continue
        first, half = depth, 1 << (level - 1)
        for quarter in range(4):
            ci, cj = i + half * (quarter & 1), j + half * (quarter >> 1)
            score = _score(levels[level - 1], cells, ci, cj)
            at = depth
            while at > first and bounds[at - 1] > score:
                stack[at], bounds[at] = stack[at - 1], bounds[at - 1]
                at -= 1
            stack[at, 0], stack[at, 1], stack[at, 2], bounds[at] = ci, cj, level - 1, score
            depth += 1
    return best_i, best_j, best


@njit(cache=True)
def _score(level: NDArray[np.uint8], cells: NDArray[np.int32], i: int, j: int) -> float:
    """Mean likelihood (0..1) of the cells moved by (i, j)."""
    total, mask = 0, len(level) - 1
    for k in range(len(cells)):
        total += level[(cells[k, 1] + j) & mask, (cells[k, 0] + i) & mask]
    return total / (255.0 * len(cells))
