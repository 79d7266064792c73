"""Refinement of a hypothesis to a fraction of a cell: point-to-line Gauss-Newton on the nearest-wall field.

Each wall point of b looks for the nearest wall of a, keeps it when it is within reach and runs the same way, and
pulls across that wall only. The reach shrinks with each step, from the error of a proposal to that of a map.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.fusion.matchmap import REACH_M, MatchMap
from common.fusion.walls import NX, NY, SIDED, STRAIGHTNESS, Walls, X, Y, alike
from common.geometry.se2 import Pose

STEPS = 14
SHRINK = 0.8
FINAL_REACH_M = 0.15
SIGMA_M = 0.05
"""spread of a wall about its mean in a real map, for the information matrix"""
SPACING_M = 0.2
"""walls this close bend together: they count as one measurement"""


DAMPED, TINY = 1.001, 1e-9
"""what a Hessian's diagonal is multiplied by, and gets more, so that a step is small where walls hold nothing"""


class Refined(NamedTuple):
    pose: NDArray[np.float64]
    """(3,) pose of b's frame in a's"""
    information: NDArray[np.float64]
    """(3, 3) inverse covariance of the pose's x, y (m) and theta (rad)"""
    matched: float
    """share of the sampled walls that found one"""


def refine(
    a: MatchMap, sample: Walls, pose: NDArray[np.float64], reach_m: float, steps: int = STEPS, wall_m: float = 0.0
) -> Refined:
    """The best pose near `pose` for b's walls `sample`, which stand for `wall_m` metres of wall."""
    refined, hessian, matched = refine_lines(np.asarray(pose, np.float64), *_arguments(a, sample, reach_m, steps))
    weight = wall_m / SPACING_M / len(sample.points) / SIGMA_M**2
    return Refined(refined, hessian * weight, matched / len(sample.points))


def refine_all(a: MatchMap, sample: Walls, poses: NDArray[np.float64], reach_m: float, steps: int) -> Pose:
    """The poses (n, 3) that `refine` makes of each of `poses`."""
    return _refine_all(np.ascontiguousarray(poses, np.float64), *_arguments(a, sample, reach_m, steps))


def _arguments(a: MatchMap, sample: Walls, reach_m: float, steps: int) -> tuple[Any, ...]:
    """What `refine_lines` takes after the pose that it begins with."""
    return sample.lines, a.walls.lines, a.nearest.wall, a.origin, a.resolution, min(reach_m, REACH_M), steps


@njit(cache=True)
def refine_lines(
    start: NDArray[np.float64],
    sample: NDArray[np.float64],
    walls: NDArray[np.float64],
    nearest: NDArray[np.int32],
    origin: NDArray[np.float64],
    resolution: float,
    reach: float,
    steps: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """(pose, unscaled Hessian at it, number of points that found a wall)."""
    mx, my = sample[:, X].mean(), sample[:, Y].mean()
    c, s = math.cos(start[2]), math.sin(start[2])
    pose = np.array([start[0] + c * mx - s * my, start[1] + s * mx + c * my, start[2]])  # of the sample's middle
    hessian = np.zeros((3, 3))
    matched = 0
    for step in range(steps):
        hxx, hxy, hxt, hyy, hyt, htt, gx, gy, gt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        matched = 0
        x0, y0, c, s = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
        for k in range(len(sample)):
            px, py = sample[k, X] - mx, sample[k, Y] - my
            rx, ry = c * px - s * py, s * px + c * py
            x, y = x0 + rx, y0 + ry
            column = math.floor((x - origin[0]) / resolution)
            row = math.floor((y - origin[1]) / resolution)
            if row < 0 or column < 0 or row >= nearest.shape[0] or column >= nearest.shape[1]:
                continue
            if nearest[row, column] < 0:
                continue
            wall = walls[nearest[row, column]]
            ex, ey = x - wall[X], y - wall[Y]
            square = (ex * ex + ey * ey) / (reach * reach)
            if square >= 1.0:
                continue
            nx, ny = wall[NX], wall[NY]
            cosine = nx * (c * sample[k, NX] - s * sample[k, NY]) + ny * (s * sample[k, NX] + c * sample[k, NY])
            if not alike(cosine, sample[k, STRAIGHTNESS], wall[STRAIGHTNESS], sample[k, SIDED], wall[SIDED]):
                continue
            matched += 1
            weight = (1.0 - square) * (1.0 - square) * wall[STRAIGHTNESS]
            residual = nx * ex + ny * ey
            turning = ny * rx - nx * ry
            wx, wy, wt = weight * nx, weight * ny, weight * turning
            hxx, hxy, hxt = hxx + wx * nx, hxy + wx * ny, hxt + wx * turning
            hyy, hyt, htt = hyy + wy * ny, hyt + wy * turning, htt + wt * turning
            gx, gy, gt = gx + wx * residual, gy + wy * residual, gt + wt * residual
        hessian[0, 0], hessian[1, 1], hessian[2, 2] = hxx, hyy, htt
        hessian[0, 1], hessian[0, 2], hessian[1, 2] = hxy, hxt, hyt
        hessian[1, 0], hessian[2, 0], hessian[2, 1] = hxy, hxt, hyt
        if matched < 8:
            break
        move = _solve(hessian, gx, gy, gt)
        pose -= move
        reach = max(reach * SHRINK, FINAL_REACH_M)
        if step > 4 and reach == FINAL_REACH_M and abs(move[0]) + abs(move[1]) + abs(move[2]) < 1e-5:
            break
    c, s = math.cos(pose[2]), math.sin(pose[2])
    qx, qy = c * mx - s * my, s * mx + c * my
    lever = np.array([[1.0, 0.0, -qy], [0.0, 1.0, qx], [0.0, 0.0, 1.0]])
    theta = (pose[2] + math.pi) % (2 * math.pi) - math.pi
    return np.array([pose[0] - qx, pose[1] - qy, theta]), lever.T @ hessian @ lever, matched


@njit(cache=True)
def _solve(hessian: NDArray[np.float64], gx: float, gy: float, gt: float) -> NDArray[np.float64]:
    """The (damped) Newton step of a positive 3 x 3 Hessian, by its Cholesky factor."""
    a = math.sqrt(hessian[0, 0] * DAMPED + TINY)
    b, c = hessian[0, 1] / a, hessian[0, 2] / a
    d = math.sqrt(hessian[1, 1] * DAMPED + TINY - b * b)
    e = (hessian[1, 2] - b * c) / d
    f = math.sqrt(hessian[2, 2] * DAMPED + TINY - c * c - e * e)
    u = gx / a
    v = (gy - b * u) / d
    w = (gt - c * u - e * v) / f / f
    v = (v - e * w) / d
    return np.array([(u - b * v - c * w) / a, v, w])


@njit(cache=True)
def _refine_all(starts: NDArray[np.float64], *rest: Any) -> NDArray[np.float64]:
    poses = np.empty_like(starts)
    for k in range(len(starts)):
        poses[k] = refine_lines(starts[k], *rest)[0]
    return poses
