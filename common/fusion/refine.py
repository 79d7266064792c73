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
from common.fusion.walls import Walls, alike
from common.geometry.se2 import Pose

STEPS = 14
SHRINK = 0.8
FINAL_REACH_M = 0.15
SIGMA_M = 0.05
"""spread of a wall about its mean in a real map, for the information matrix"""
SPACING_M = 0.2
"""walls this close bend together: they count as one measurement"""


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
    refined, hessian, matched = _refine(np.asarray(pose, np.float64), *_arguments(a, sample, reach_m, steps))
    weight = wall_m / SPACING_M / len(sample.points) / SIGMA_M**2
    return Refined(refined, hessian * weight, matched / len(sample.points))


def refine_all(a: MatchMap, sample: Walls, poses: NDArray[np.float64], reach_m: float, steps: int) -> Pose:
    """The poses (n, 3) that `refine` makes of each of `poses`."""
    return _refine_all(np.ascontiguousarray(poses, np.float64), *_arguments(a, sample, reach_m, steps))


def _arguments(a: MatchMap, sample: Walls, reach_m: float, steps: int) -> tuple[Any, ...]:
    """What `_refine` takes after the pose that it begins with."""
    return (
        sample.points,
        sample.normals,
        sample.straightness,
        sample.sided,
        a.walls.points,
        a.walls.normals,
        a.walls.straightness,
        a.walls.sided,
        a.nearest.wall,
        a.origin,
        a.resolution,
        min(reach_m, REACH_M),
        steps,
    )


@njit(cache=True)
def _refine(
    start: NDArray[np.float64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    straightness: NDArray[np.float64],
    sided: NDArray[np.bool_],
    wall_points: NDArray[np.float64],
    wall_normals: NDArray[np.float64],
    wall_straightness: NDArray[np.float64],
    wall_sided: NDArray[np.bool_],
    nearest: NDArray[np.int32],
    origin: NDArray[np.float64],
    resolution: float,
    reach: float,
    steps: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """(pose, unscaled Hessian at it, number of points that found a wall)."""
    mx, my = points[:, 0].mean(), points[:, 1].mean()
    c, s = math.cos(start[2]), math.sin(start[2])
    pose = np.array([start[0] + c * mx - s * my, start[1] + s * mx + c * my, start[2]])  # of the points' middle
    hessian, gradient = np.zeros((3, 3)), np.zeros(3)
    matched = 0
    for step in range(steps):
        hessian[:], gradient[:] = 0.0, 0.0
        matched = 0
        c, s = math.cos(pose[2]), math.sin(pose[2])
        for k in range(len(points)):
            px, py = points[k, 0] - mx, points[k, 1] - my
            rx, ry = c * px - s * py, s * px + c * py
            x, y = pose[0] + rx, pose[1] + ry
            column = math.floor((x - origin[0]) / resolution)
            row = math.floor((y - origin[1]) / resolution)
            if row < 0 or column < 0 or row >= nearest.shape[0] or column >= nearest.shape[1]:
                continue
            wall = nearest[row, column]
            if wall < 0:
                continue
            ex, ey = x - wall_points[wall, 0], y - wall_points[wall, 1]
            square = (ex * ex + ey * ey) / (reach * reach)
            if square >= 1.0:
                continue
            nx, ny = wall_normals[wall, 0], wall_normals[wall, 1]
            cosine = nx * (c * normals[k, 0] - s * normals[k, 1]) + ny * (s * normals[k, 0] + c * normals[k, 1])
            if not alike(cosine, straightness[k], wall_straightness[wall], sided[k], wall_sided[wall]):
                continue
            matched += 1
            weight = (1.0 - square) * (1.0 - square) * wall_straightness[wall]
            residual = nx * ex + ny * ey
            j2 = ny * rx - nx * ry
            hessian[0, 0] += weight * nx * nx
            hessian[0, 1] += weight * nx * ny
            hessian[0, 2] += weight * nx * j2
            hessian[1, 1] += weight * ny * ny
            hessian[1, 2] += weight * ny * j2
            hessian[2, 2] += weight * j2 * j2
            gradient[0] += weight * nx * residual
            gradient[1] += weight * ny * residual
            gradient[2] += weight * j2 * residual
        hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
        if matched < 8:
            break
        damped = hessian.copy()
        for i in range(3):
            damped[i, i] += 1e-3 * hessian[i, i] + 1e-9
        move = np.linalg.solve(damped, gradient)
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
def _refine_all(starts: NDArray[np.float64], *rest: Any) -> NDArray[np.float64]:
    poses = np.empty_like(starts)
    for k in range(len(starts)):
        poses[k] = _refine(starts[k], *rest)[0]
    return poses
