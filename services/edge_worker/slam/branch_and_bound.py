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
    for j in range(size):
        for i in range(size):
            low = max(field[2 * j, 2 * i], field[2 * j, 2 * i + 1])
            out[0, j, i] = max(low, field[2 * j + 1, 2 * i], field[2 * j + 1, 2 * i + 1])
    for level in range(1, LEVELS):
        half = 1 << (level - 1)
        below, here = out[level - 1], out[level]
        for j in range(size):
            lower, upper = below[j], below[(j + half) & (size - 1)]
            for i in range(size):
                k = (i + half) & (size - 1)
                here[j, i] = max(max(lower[i], lower[k]), max(upper[i], upper[k]))
    return out


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
    n, mask = len(points), levels.shape[1] - 1
    turns = int(np.ceil(turn / turn_step))
    blocks = int(np.ceil(reach / COARSE)) >> (LEVELS - 1)
    block = 1 << (LEVELS - 1)
    side = 2 * blocks + 2
    cells = np.empty((2 * turns + 1, n, 2), np.int32)
    for a in range(2 * turns + 1):
        theta = guess[2] + (a - turns) * turn_step
        c, s = np.cos(theta), np.sin(theta)
        for k in range(n):
            cells[a, k, 0] = int(np.floor((guess[0] + c * points[k, 0] - s * points[k, 1]) / COARSE))
            cells[a, k, 1] = int(np.floor((guess[1] + s * points[k, 0] + c * points[k, 1]) / COARSE))
    bounds = np.empty((2 * turns + 1) * side * side)
    for a in range(2 * turns + 1):
        for row in range(side):
            for column in range(side):
                i, j = (column - blocks - 1) * block, (row - blocks - 1) * block
                bounds[(a * side + row) * side + column] = _score(levels[LEVELS - 1], cells[a], i, j, mask)
    best, best_score = guess.copy(), floor
    stack = np.empty((4 * LEVELS + 8, 3), np.int64)
    stack_bounds = np.empty(4 * LEVELS + 8)
    stack_levels = np.empty(4 * LEVELS + 8, np.int64)
    for root in np.argsort(-bounds):
        if bounds[root] <= best_score:
            break
        a, row, column = root // (side * side), (root // side) % side, root % side
        depth = 1
        stack[0, 0], stack[0, 1], stack[0, 2] = a, (column - blocks - 1) * block, (row - blocks - 1) * block
        stack_bounds[0], stack_levels[0] = bounds[root], LEVELS - 1
        while depth > 0:
            depth -= 1
            if stack_bounds[depth] <= best_score:
                continue
            i, j, level = stack[depth, 1], stack[depth, 2], stack_levels[depth]
            if level == 0:
                x, y = guess[0] + COARSE * i, guess[1] + COARSE * j
                outside = max(abs(i), abs(j)) * COARSE > reach
                if outside or np.hypot(x - taken[0], y - taken[1]) < taken_reach:
                    continue
                best_score = stack_bounds[depth]
                best[0], best[1], best[2] = x, y, guess[2] + (a - turns) * turn_step
                continue
            half = 1 << (level - 1)
            first = depth
            for quarter in range(4):
                ci, cj = i + half * (quarter & 1), j + half * (quarter >> 1)
                bound = _score(levels[level - 1], cells[a], ci, cj, mask)
                if bound <= best_score:
                    continue
                at = depth
                while at > first and stack_bounds[at - 1] > bound:
                    stack[at], stack_bounds[at] = stack[at - 1], stack_bounds[at - 1]
                    stack_levels[at] = stack_levels[at - 1]
                    at -= 1
                stack[at, 0], stack[at, 1], stack[at, 2] = a, ci, cj
                stack_bounds[at], stack_levels[at] = bound, level - 1
                depth += 1
    return best, best_score


@njit(cache=True)
def _score(level: NDArray[np.uint8], cells: NDArray[np.int32], i: int, j: int, mask: int) -> float:
    """Mean likelihood (0..1) of the cells moved by (i, j)."""
    total = 0
    for k in range(len(cells)):
        total += level[(cells[k, 1] + j) & mask, (cells[k, 0] + i) & mask]
    return total / (255.0 * len(cells))
