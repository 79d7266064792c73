"""Buildings on a lattice of aisles: what fills the blocks between them, and long ways along them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.sim.world import Point

Crossing = tuple[int, int]


@dataclass(frozen=True)
class Lattice:
    """Aisles whose middle lines run at these x (northward) and y (eastward), metres."""

    xs: Sequence[float]
    ys: Sequence[float]

    def point(self, crossing: Crossing) -> Point:
        return self.xs[crossing[0]], self.ys[crossing[1]]

    def way(self, told: str) -> NDArray[np.float64]:
        """Waypoints (n, 2) over crossings told as "column-row column-row", say "0-0 3-0 3-2"."""
        crossings = [(int(a), int(b)) for a, b in (name.split("-") for name in told.split())]
        return np.array([self.point(crossing) for crossing in crossings])

    def neighbours(self, crossing: Crossing) -> list[Crossing]:
        column, row = crossing
        near = [(column + 1, row), (column, row + 1), (column - 1, row), (column, row - 1)]
        return [(c, r) for c, r in near if 0 <= c < len(self.xs) and 0 <= r < len(self.ys)]

    def stroll(self, start: Crossing, length: float, rng: np.random.Generator) -> NDArray[np.float64]:
        """Waypoints (n, 2) of a way of `length` metres or more that prefers the aisles driven least."""
        driven: Counter[frozenset[Crossing]] = Counter()
        here, before, way, total = start, start, [start], 0.0
        while total < length:
            near = self.neighbours(here)
            cost = [
                driven[frozenset((here, n))] + 5 * (n == before) + 0.5 * rng.random() + 0.2 * self._visits(driven, n)
                for n in near
            ]
            ahead = near[int(np.argmin(cost))]
            driven[frozenset((here, ahead))] += 1
            total += float(np.hypot(*np.subtract(self.point(ahead), self.point(here))))
            here, before = ahead, here
            way.append(ahead)
        return np.array([self.point(crossing) for crossing in way])

    def _visits(self, driven: Counter[frozenset[Crossing]], crossing: Crossing) -> int:
        return sum(driven[frozenset((crossing, n))] for n in self.neighbours(crossing))
