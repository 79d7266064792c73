"""Correlative matching on a lattice of poses (Olson 2009): robust against a poor prediction, exact to a step."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.graph.surfels import FINE
from services.edge_worker.slam.scan import Points

STEP = 2
"""fine cells between lattice positions"""
PRIOR_WEIGHT = 0.08
"""share of the score that is lost at the border of the window: among equals the prediction wins"""


@njit(cache=True)
def correlate(
    field: NDArray[np.uint8],
    points: Points,
    predicted: NDArray[np.float64],
    reach: float,
    turn: float,
    turn_step: float,
) -> tuple[NDArray[np.float64], float]:
    """The lattice pose (3,) of the best mean likelihood within `reach` m and `turn` rad, and that mean (0..1).

    `field` is a torus of fine cells, `points` (n, 2) in the base frame.
    """
    mask, n = len(field) - 1, len(points)
    shifts = int(np.ceil(reach / (STEP * FINE)))
    turns = int(np.ceil(turn / turn_step))
    cells = np.empty((n, 2), np.int64)
    best, best_score = predicted.copy(), -1.0
    for a in range(-turns, turns + 1):
        theta = predicted[2] + a * turn_step
        c, s = np.cos(theta), np.sin(theta)
        for k in range(n):
            cells[k, 0] = int(np.floor((predicted[0] + c * points[k, 0] - s * points[k, 1]) / FINE))
            cells[k, 1] = int(np.floor((predicted[1] + s * points[k, 0] + c * points[k, 1]) / FINE))
        for j in range(-shifts, shifts + 1):
            for i in range(-shifts, shifts + 1):
                total = 0
                for k in range(n):
                    total += field[(cells[k, 1] + STEP * j) & mask, (cells[k, 0] + STEP * i) & mask]
                away = (i * i + j * j) / max(shifts * shifts, 1) + a * a / max(turns * turns, 1)
                score = total / (255.0 * n) * (1.0 - PRIOR_WEIGHT * away)
                if score > best_score:
                    best_score = score
                    best[0] = predicted[0] + STEP * FINE * i
                    best[1] = predicted[1] + STEP * FINE * j
                    best[2] = theta
    return best, best_score
