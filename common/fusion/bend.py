"""Bending: drift leaves a map true in every place but not as a whole, so that no rigid placement fits all of it.

From where a placement fits, it is carried from patch to neighbouring patch, refined a little each time. Where that
explains a contradiction, the maps are bent; where it does not, they show different places. How far the patches'
placements scatter is how well one rigid transform can be known at all.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.fusion.evidence import AGREES, CONTRADICTS, OUTSIDE, Evidence, classify, tally
from common.fusion.matchmap import MatchMap
from common.fusion.refine import refine
from common.fusion.settings import FusionSettings
from common.fusion.walls import Walls
from common.geometry.se2 import apply, inverse, wrap

PATCH_M = 3.0
AROUND_M = 3.5
"""a patch is refined with the walls of its surroundings: one wall alone would slip onto any parallel one"""
REACH_M = 0.3
STEPS = 8
STEP_M, STEP_RAD = 0.25, math.radians(3.0)
"""most that neighbouring patches may differ by: drift is gradual"""
ROOTED = 0.8
"""share of a patch's walls that agree where the rigid placement fits"""
MIN_WALLS = 8
"""sampled walls around a patch that a refinement must rest on"""
INDEPENDENT = 3.0
"""stretches of a map that bend independently of each other, for what the scatter says about the mean"""
STIFF = np.diag([0.02**2, 0.02**2, 0.003**2])
"""covariance (m, rad) at the middle of the overlap that remains for the straightest of real maps"""


class Bend(NamedTuple):
    """How b lies in a, patch by patch of b's frame; at least one patch."""

    middles: NDArray[np.float64]
    """(n, 2) m in b's frame"""
    poses: NDArray[np.float64]
    """(n, 3) pose of b's frame in a's that holds around each middle"""
    walls: NDArray[np.int64]
    """(n,) sampled walls of the patch that lie where a is known"""

    def nearest(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """The patch (m,) that each point (m, 2) of b's frame belongs to."""
        squares = ((points[:, None, :] - self.middles[None, :, :]) ** 2).sum(axis=2)
        return np.asarray(squares.argmin(axis=1), np.int64)


def bend(a: MatchMap, b: MatchMap, pose: NDArray[np.float64], settings: FusionSettings) -> Bend:
    """Carry `pose`, the pose of b's frame in a's, from the patches where it fits to all others."""
    cells = np.floor(b.sample.points / PATCH_M).astype(np.int64)
    places, owner = np.unique(cells, axis=0, return_inverse=True)
    owner = owner.ravel()
    middles = np.array([b.sample.points[owner == k].mean(axis=0) for k in range(len(places))])
    squares = ((b.sample.points[None] - middles[:, None]) ** 2).sum(axis=2)
    around = [b.sample.at(np.flatnonzero(row < AROUND_M**2)) for row in squares]
    index = {(int(x), int(y)): k for k, (x, y) in enumerate(places)}

    poses, settled = np.tile(pose, (len(places), 1)), np.zeros(len(places), np.bool_)
    shares, walls = np.array([_fit(a, each, pose, settings) for each in around]).T
    rooted = np.flatnonzero((shares >= ROOTED) & (walls >= MIN_WALLS))
    queue = [(-float(shares[k]), int(k), tuple(pose)) for k in rooted]
    heapq.heapify(queue)
    while queue:
        _, k, start = heapq.heappop(queue)
        if settled[k]:
            continue
        settled[k] = True
        poses[k] = _step(a, around[k], middles[k], pose, np.array(start), settings)
        x, y = places[k]
        for near in (index.get((x + dx, y + dy)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)):
            if near is not None and not settled[near]:
                share, walls[near] = _fit(a, around[near], poses[k], settings)
                heapq.heappush(queue, (-share, near, tuple(poses[k])))
    return Bend(middles, poses, walls)


def weigh_bent(a: MatchMap, b: MatchMap, bent: Bend, settings: FusionSettings) -> Evidence:
    """The evidence about a bent placement; as `weigh` gives it about a rigid one."""
    rigid = bent.poses[int(bent.walls.argmax())]
    in_a = np.zeros(len(b.sample.points), np.int8)
    in_b = np.zeros(len(a.sample.points), np.int8)
    brought = np.empty_like(b.sample.points)
    patch_b = bent.nearest(b.sample.points)
    patch_a = bent.nearest(apply(inverse(rigid), a.sample.points))
    for k, pose in enumerate(bent.poses):
        mine, theirs = np.flatnonzero(patch_b == k), np.flatnonzero(patch_a == k)
        in_a[mine] = classify(a, b.sample.at(mine), pose, settings)
        in_b[theirs] = classify(b, a.sample.at(theirs), inverse(pose), settings)
        brought[mine] = apply(pose, b.sample.points[mine])
    return tally(a, b, in_a, in_b, brought[in_a == CONTRADICTS], rigid)


def loosened(
    information: NDArray[np.float64], b: MatchMap, pose: NDArray[np.float64], bent: Bend | None
) -> NDArray[np.float64]:
    """The information (3, 3) about `pose` less what bending takes from it: no pair is surer than maps are straight.

    Where patches are known, their scatter about the rigid pose counts; x, y in m and theta in rad.
    """
    covariance = STIFF
    middle = b.sample.points.mean(axis=0)
    if bent is not None and bent.walls.any():
        weights = bent.walls / bent.walls.sum()
        middle = weights @ bent.middles
        gaps = np.stack([_gap(p, pose, m) for p, m in zip(bent.poses, bent.middles, strict=True)])
        covariance = STIFF + np.diag(weights @ gaps**2 / INDEPENDENT)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = c * middle[0] - s * middle[1], s * middle[0] + c * middle[1]
    lever = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
    bending = lever @ covariance @ lever.T
    return np.asarray(np.linalg.inv(np.linalg.inv(information + 1e-9 * np.eye(3)) + bending))


def _fit(a: MatchMap, around: Walls, pose: NDArray[np.float64], settings: FusionSettings) -> tuple[float, int]:
    """(share of walls that agree, number of walls) of those that lie where a is known."""
    labels = classify(a, around, pose, settings)
    known = int((labels != OUTSIDE).sum())
    return (float((labels == AGREES).sum()) / known if known else 0.0), known


def _step(
    a: MatchMap,
    around: Walls,
    middle: NDArray[np.float64],
    rigid: NDArray[np.float64],
    start: NDArray[np.float64],
    settings: FusionSettings,
) -> NDArray[np.float64]:
    """The placement of a patch, refined from its neighbour's; the neighbour's when refining leads too far."""
    if len(around.points) < MIN_WALLS:
        return start
    found = refine(a, around, start, REACH_M, STEPS)
    step, total = _gap(found.pose, start, middle), _gap(found.pose, rigid, middle)
    small = math.hypot(step[0], step[1]) <= STEP_M and abs(step[2]) <= STEP_RAD
    bounded = math.hypot(total[0], total[1]) <= settings.max_bend_m and abs(total[2]) <= settings.max_bend_rad
    return found.pose if small and bounded else start


def _gap(pose: NDArray[np.float64], other: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) how far two poses move the point `middle` of their frame apart, in the target's axes."""
    x, y = middle
    c, s = math.cos(pose[2]) - math.cos(other[2]), math.sin(pose[2]) - math.sin(other[2])
    away = pose - other
    return np.array([away[0] + c * x - s * y, away[1] + s * x + c * y, float(wrap(away[2]))])
