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
from numba import njit
from numpy.typing import NDArray

from common.fusion.evidence import AGREES, CONTRADICTS, OUTSIDE, Evidence, Target, classify_lines, tally, target
from common.fusion.matchmap import MatchMap
from common.fusion.refine import refine_lines
from common.fusion.settings import FusionSettings
from common.geometry.se2 import apply, inverse

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
        return np.asarray(_closest(np.ascontiguousarray(points), self.middles))


def bend(a: MatchMap, b: MatchMap, pose: NDArray[np.float64], settings: FusionSettings) -> Bend:
    """Carry `pose`, the pose of b's frame in a's, from the patches where it fits to all others."""
    points = np.ascontiguousarray(b.sample.points)
    places, owner = np.unique(np.floor(points / PATCH_M).astype(np.int64), axis=0, return_inverse=True)
    middles = _means(points, owner.ravel(), len(places))
    index = {(int(x), int(y)): k for k, (x, y) in enumerate(places)}
    near = [[index.get((x + dx, y + dy), -1) for dy in (-1, 0, 1) for dx in (-1, 0, 1)] for x, y in places.tolist()]
    start, limits = np.asarray(pose, np.float64), (settings.max_bend_m, settings.max_bend_rad)
    surroundings = _around(points, middles)
    poses, walls = _carry(start, limits, middles, np.array(near), surroundings, b.sample.lines, target(a, settings))
    return Bend(middles, poses, walls)


def weigh_bent(a: MatchMap, b: MatchMap, bent: Bend, settings: FusionSettings) -> Evidence:
    """The evidence about a bent placement; as `weigh` gives it about a rigid one."""
    rigid = bent.poses[int(bent.walls.argmax())]
    patch_b = bent.nearest(b.sample.points)
    patch_a = bent.nearest(apply(inverse(rigid), a.sample.points))
    in_a = _classify_each(patch_b, bent.poses, b.sample.lines, target(a, settings))
    in_b = _classify_each(patch_a, inverse(bent.poses), a.sample.lines, target(b, settings))
    clashing = [apply(bent.poses[patch_b[k]], b.sample.points[k : k + 1]) for k in np.flatnonzero(in_a == CONTRADICTS)]
    return tally(a, b, in_a, in_b, np.concatenate([np.zeros((0, 2)), *clashing]), rigid)


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


def _means(points: NDArray[np.float64], owner: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """(count, 2) mean of each owner's points."""
    sums = np.stack([np.bincount(owner, weights, count) for weights in points.T], axis=1)
    return np.asarray(sums / np.bincount(owner, minlength=count)[:, None])


def _gap(pose: NDArray[np.float64], other: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) how far two poses move the point `middle` of their frame apart, in the target's axes."""
    return np.array(_moved(pose, other, middle[0], middle[1]))


@njit(cache=True)
def _moved(pose: NDArray[np.float64], other: NDArray[np.float64], x: float, y: float) -> tuple[float, float, float]:
    c, s = math.cos(pose[2]) - math.cos(other[2]), math.sin(pose[2]) - math.sin(other[2])
    turn = (pose[2] - other[2] + math.pi) % (2 * math.pi) - math.pi
    return pose[0] - other[0] + c * x - s * y, pose[1] - other[1] + s * x + c * y, turn


@njit(cache=True)
def _closest(points: NDArray[np.float64], middles: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) index of the middle that is nearest to each point."""
    found = np.zeros(len(points), np.int64)
    for k in range(len(points)):
        least = math.inf
        for m in range(len(middles)):
            square = (points[k, 0] - middles[m, 0]) ** 2 + (points[k, 1] - middles[m, 1]) ** 2
            if square < least:
                least, found[k] = square, m
    return found


@njit(cache=True)
def _around(points: NDArray[np.float64], middles: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(indices, ends): points of the surroundings of each middle, one after the other, and where each one's end."""
    indices, ends, count = np.empty(len(points) * len(middles), np.int64), np.zeros(len(middles) + 1, np.int64), 0
    for m in range(len(middles)):
        for k in range(len(points)):
            square = (points[k, 0] - middles[m, 0]) ** 2 + (points[k, 1] - middles[m, 1]) ** 2
            if square < AROUND_M * AROUND_M:
                indices[count] = k
                count += 1
        ends[m + 1] = count
    return indices[:count], ends


@njit(cache=True)
def _carry(
    rigid: NDArray[np.float64],
    limits: tuple[float, float],
    middles: NDArray[np.float64],
    near: NDArray[np.int64],
    surroundings: tuple[NDArray[np.int64], NDArray[np.int64]],
    lines: NDArray[np.float64],
    into: Target,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(poses (n, 3), known walls (n,)) of the patches, those settled first that fit best where they are put."""
    count, (indices, ends) = len(middles), surroundings
    walls, _, nearest, _, origin, resolution, _, _ = into
    poses, known, settled = np.empty((count, 3)), np.zeros(count, np.int64), np.zeros(count, np.bool_)
    queue = [(0.0, 0, 0.0, 0.0, 0.0) for _ in range(0)]
    for k in range(count):
        poses[k] = rigid
        around = lines[indices[ends[k] : ends[k + 1]]]
        labels = classify_lines(rigid, around, into)
        share, known[k] = _share(labels)
        if share >= ROOTED and known[k] >= MIN_WALLS:
            heapq.heappush(queue, (-share, k, rigid[0], rigid[1], rigid[2]))
    while len(queue):
        _, k, x, y, theta = heapq.heappop(queue)
        if settled[k]:
            continue
        settled[k] = True
        start, around = np.array([x, y, theta]), lines[indices[ends[k] : ends[k + 1]]]
        poses[k] = start
        if len(around) >= MIN_WALLS:
            found, _, _ = refine_lines(start, around, walls, nearest, origin, resolution, REACH_M, STEPS)
            step = _moved(found, start, middles[k, 0], middles[k, 1])
            total = _moved(found, rigid, middles[k, 0], middles[k, 1])
            small = math.hypot(step[0], step[1]) <= STEP_M and abs(step[2]) <= STEP_RAD
            if small and math.hypot(total[0], total[1]) <= limits[0] and abs(total[2]) <= limits[1]:
                poses[k] = found
        at = poses[k].copy()
        for other in near[k]:
            if other >= 0 and not settled[other]:
                around = lines[indices[ends[other] : ends[other + 1]]]
                labels = classify_lines(at, around, into)
                share, known[other] = _share(labels)
                heapq.heappush(queue, (-share, other, at[0], at[1], at[2]))
    return poses, known


@njit(cache=True)
def _share(labels: NDArray[np.int8]) -> tuple[float, int]:
    """(share that agree, number) of the walls that lie where the other map is known."""
    agreeing, known = 0, 0
    for label in labels:
        agreeing += label == AGREES
        known += label != OUTSIDE
    return (agreeing / known if known else 0.0), known


@njit(cache=True)
def _classify_each(
    patch: NDArray[np.int64],
    poses: NDArray[np.float64],
    lines: NDArray[np.float64],
    into: Target,
) -> NDArray[np.int8]:
    """Labels of walls each of which lies at the pose of its patch."""
    labels = np.zeros(len(lines), np.int8)
    for k in range(len(poses)):
        mine = np.flatnonzero(patch == k)
        labels[mine] = classify_lines(poses[k], lines[mine], into)
    return labels
