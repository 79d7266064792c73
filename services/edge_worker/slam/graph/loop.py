"""A loop: a keyframe seen from another one of another time, and what it takes for two of them to agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose, wrap
from common.geometry.pose_graph import PoseGraph

SMALL_M, SMALL_RAD = 0.3, 0.08
"""corrections up to these are taken on one loop's word"""
FIRM_M = 0.1
"""standard deviation up to which a loop holds a direction"""
AGREE_M, AGREE_RAD, AGREE_SHARE = 0.1, 0.025, 0.01
"""how well two loops must agree: m, rad, and m per metre travelled between them"""
APART_KEYFRAMES = 4
"""loops agree only if they were found by queries at least this far apart"""


@dataclass(frozen=True)
class Loop:
    """A keyframe seen from another one, of long ago."""

    anchor: int
    """the keyframe of the submap that holds it"""
    keyframe: int
    """the keyframe of the query that holds it"""
    latest: int
    """the latest keyframe of the query"""
    measured: NDArray[np.float64]
    """(3,) pose of the keyframe in the anchor's frame"""
    information: NDArray[np.float64]
    """(3, 3) in the keyframe's frame"""
    correction: tuple[float, float]
    """m and rad by which it would move the query"""

    @property
    def firm(self) -> bool:
        """It holds the keyframe in all directions."""
        covariance = np.linalg.inv(self.information)[:2, :2]
        return bool(np.linalg.eigvalsh(covariance)[1] < FIRM_M**2)

    @property
    def small(self) -> bool:
        return self.correction[0] <= SMALL_M and self.correction[1] <= SMALL_RAD


def consistent(graph: PoseGraph, a: Loop, b: Loop) -> bool:
    """Do two loops from keyframes apart say the same? They close a cycle with dead reckoning on both sides."""
    if abs(b.latest - a.latest) < APART_KEYFRAMES:
        return False
    poses = graph.poses
    there = compose(between(poses[a.anchor], poses[b.anchor]), b.measured)
    here = compose(a.measured, between(poses[a.keyframe], poses[b.keyframe]))
    off = between(here, there)
    length = np.hypot(*(poses[b.keyframe] - poses[a.keyframe])[:2]) + np.hypot(*(poses[b.anchor] - poses[a.anchor])[:2])
    return bool(np.hypot(off[0], off[1]) < AGREE_M + AGREE_SHARE * length and abs(wrap(off[2])) < AGREE_RAD)
