"""Where the robot was at each frame: frames between two registered scans are hung on both, by the motion tracked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose

COLUMNS = 6
FIRST_ROWS = 1024
RADIAN_M = 1.0
"""a turn of one radian wears dead reckoning like this many metres"""


class ParticleTrack:
    """A row for every frame taken: stamp, number of the registered scan before, motion since it, way since it.

    `ends` holds for each gap between registered scans the motion (3,) and way tracked over the whole gap.
    """

    def __init__(self) -> None:
        self._rows = np.empty((FIRST_ROWS, COLUMNS))
        self._count = 0
        self.ends: list[NDArray[np.float64]] = []

    def append(self, stamp: float, scan: int, motion: NDArray[np.float64], way: float) -> None:
        """`motion` (3,) since registered scan `scan`, in its base; `way` m travelled since, turns included."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = (stamp, scan, *motion, way)
        self._count += 1

    def close(self, motion: NDArray[np.float64], way: float) -> None:
        """The next scan is registered: `motion` (3,) and `way` tracked since the one before."""
        self.ends.append(np.array([*motion, way]))

    def poses(self, registered: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 4): stamp s, x m, y m, theta rad, with registered scans at (k, 3) poses, k = len(ends) + 1.

        A frame's pose is reckoned forward from the scan before and back from the scan after, blended by the way.
        """
        rows = self._rows[: self._count]
        scan, motion, way = rows[:, 1].astype(np.int64), rows[:, 2:5], rows[:, 5]
        out = compose(registered[scan], motion)
        inner = np.flatnonzero((scan < len(self.ends)) & (way > 0.0))
        if len(inner):
            gap = scan[inner]
            ends = np.array(self.ends)[gap]
            back = compose(registered[gap + 1], between(ends[:, :3], motion[inner]))
            share = np.clip(way[inner] / np.maximum(ends[:, 3], 1e-9), 0.0, 1.0)[:, None]
            out[inner] = compose(out[inner], share * between(out[inner], back))
        return np.column_stack([rows[:, 0], out])

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Everything, as arrays."""
        return {"rows": self._rows[: self._count].copy(), "ends": np.array(self.ends).reshape(-1, 4)}

    @classmethod
    def of(cls, state: dict[str, NDArray[np.float64]]) -> ParticleTrack:
        """The inverse of `state`."""
        self = cls()
        self._count = len(state["rows"])
        self._rows = np.concatenate([state["rows"], np.empty((FIRST_ROWS, COLUMNS))])
        self.ends = [end.copy() for end in state["ends"]]
        return self


def way_of(motion: NDArray[np.float64]) -> float:
    """Length of a motion (3,) as dead reckoning feels it, m."""
    return float(np.hypot(motion[0], motion[1]) + RADIAN_M * abs(motion[2]))
