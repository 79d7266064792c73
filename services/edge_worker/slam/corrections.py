"""How often SLAM has moved what the map had shown, and how far: such a correction is declared to all who use the map.

A kernel draws scans again where it has come to know better. Moves too small to see add up until they could be seen.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.scan import Points

TREMBLES_CELLS = 0.5
"""walls that have crept by less, all moves since the last correction added up, have not been corrected"""


class Corrections:
    """Counts the corrections of one map."""

    def __init__(self, resolution: float) -> None:
        """`resolution` in metres per cell."""
        self.times = 0
        self.metres = 0.0
        """of the latest correction: how far it moved what a scan had seen, of the scan that moved farthest"""
        self._limit = TREMBLES_CELLS * resolution
        self._crept = 0.0
        self._farthest = 0.0

    def moves(self, points: Points, old: NDArray[np.float64], new: NDArray[np.float64]) -> None:
        """A scan that met walls at `points` (n, 2) m in its base frame is drawn at `new` (3,) instead of `old` (3,)."""
        if len(points):
            self._farthest = max(self._farthest, median_step(points, old, new))

    def shown(self) -> None:
        """The map is shown with all moves up to now."""
        self._crept += self._farthest
        self._farthest = 0.0
        if self._crept > self._limit:
            self.times, self.metres, self._crept = self.times + 1, self._crept, 0.0


@njit(cache=True)
def median_step(points: Points, old: NDArray[np.float64], new: NDArray[np.float64]) -> float:
    """Metres by which points (n, 2) of the base frame move when it goes from `old` (3,) to `new` (3,): the median."""
    c, s = np.cos(new[2]) - np.cos(old[2]), np.sin(new[2]) - np.sin(old[2])
    steps = np.empty(len(points))
    for k in range(len(points)):
        x = new[0] - old[0] + c * points[k, 0] - s * points[k, 1]
        y = new[1] - old[1] + s * points[k, 0] + c * points[k, 1]
        steps[k] = np.hypot(x, y)
    return float(np.median(steps))
