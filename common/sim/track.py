"""A track is a robot's true motion: its base pose in the world as a function of time alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.geometry import wrap


@dataclass(frozen=True)
class Track:
    """Poses at rising stamps, linear in between, standing still before the first and after the last."""

    stamps: NDArray[np.float64]
    """(n,) s"""
    poses: NDArray[np.float64]
    """(n, 3): x m, y m, theta rad; theta is not wrapped"""

    @property
    def duration(self) -> float:
        return float(self.stamps[-1])

    def turned(self, at: ArrayLike) -> NDArray[np.float64]:
        """Poses (m, 3) at times `at` (m,), theta counted through full turns."""
        at = np.asarray(at, dtype=np.float64)
        return np.stack([np.interp(at, self.stamps, self.poses[:, axis]) for axis in range(3)], axis=-1)

    def at(self, at: ArrayLike) -> NDArray[np.float64]:
        """Poses (m, 3) at times `at` (m,), theta in [-pi, pi)."""
        poses = self.turned(at)
        poses[..., 2] = wrap(poses[..., 2])
        return poses
