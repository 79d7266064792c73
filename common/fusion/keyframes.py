"""A robot's way as an elastic chain: poses every half metre, and how stiffly they hold together.

Taken from a trajectory alone, so it serves every SLAM kernel. What the kernel has corrected stands as it is: the chain
says how far it may give way, which is what scan matching drifts by, and that places met again stay together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.geometry.se2 import between, wrap

EVERY_M = 0.5
TURN_M = 0.3
"""a turn of one radian counts as this many metres of way"""
DRIFT_M, DRIFT_RAD = 0.01, 0.004
"""standard deviation per square root of a metre: matched scans err by about 5 mm and 2 mrad every 0.3 m"""
AGAIN_M, AGAIN_AFTER_M = 1.5, 6.0
"""a keyframe this near to one that lies this far back on the way sees the same walls ..."""
AGAIN_SIGMA = (0.02, 0.01)
"""... and they are held together by them, m and rad"""


class Keyframes(NamedTuple):
    """Some poses of a robot in its map's frame and what holds them together."""

    poses: NDArray[np.float64]
    """(k, 3) m, m, rad"""
    pairs: NDArray[np.int64]
    """(e, 2) keyframes that hold each other as they lie now"""
    information: NDArray[np.float64]
    """(e, 3, 3) how firmly: 1/m^2, 1/rad^2"""

    @property
    def measured(self) -> NDArray[np.float64]:
        """(e, 3) pose of each pair's second in the frame of its first."""
        return between(self.poses[self.pairs[:, 0]], self.poses[self.pairs[:, 1]])

    def nearest(self, point: NDArray[np.float64]) -> int:
        """The keyframe nearest to a point (2,) of the map's frame, of equals the first."""
        return int(np.argmin(np.square(self.poses[:, :2] - point).sum(axis=1)))


def keyframes(trajectory: NDArray[np.float64]) -> Keyframes:
    """Keyframes of a trajectory (n, 4): stamp s, x m, y m, theta rad in the map's frame; n > 0."""
    poses = trajectory[:, 1:]
    step = np.diff(poses, axis=0)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]) + TURN_M * np.abs(wrap(step[:, 2])))])
    chosen = np.unique(np.searchsorted(way, np.arange(0.0, way[-1] + EVERY_M, EVERY_M)).clip(max=len(way) - 1))
    kept, at = poses[chosen], way[chosen]
    chain = np.stack([np.arange(len(kept) - 1), np.arange(1, len(kept))], axis=1)
    length = np.maximum(np.diff(at), EVERY_M)[:, None]
    sigma = np.sqrt(length) * (DRIFT_M, DRIFT_M, DRIFT_RAD)
    again = _met_again(kept, at)
    sigma = np.concatenate([sigma, np.tile((AGAIN_SIGMA[0], *AGAIN_SIGMA), (len(again), 1))])
    return Keyframes(kept, np.concatenate([chain, again]), sigma[:, :, None] ** -2.0 * np.eye(3))


def _met_again(poses: NDArray[np.float64], way: NDArray[np.float64]) -> NDArray[np.int64]:
    """(m, 2) the keyframe nearest to each later one that has come back to it."""
    found = []
    for k in range(len(poses)):
        before = int(np.searchsorted(way, way[k] - AGAIN_AFTER_M))
        if before:
            squares = np.square(poses[:before, :2] - poses[k, :2]).sum(axis=1)
            nearest = int(np.argmin(squares))
            if squares[nearest] < AGAIN_M**2:
                found.append((nearest, k))
    return np.array(found, np.int64).reshape(-1, 2)
