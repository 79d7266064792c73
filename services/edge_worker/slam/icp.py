"""Point-to-line alignment of a scan with a surfel map (Censi 2008's metric, robust weights, a motion prior)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.scan import Points
from services.edge_worker.slam.surfels import CELL, SAME_SIDE, SurfelMap

ITERATIONS = 15
STEP_M = 2e-4
STEP_RAD = 4e-5
"""steps smaller than these end the iteration"""
WIDE_M, NARROW_M = 0.12, 0.04
"""scale of the robust weight in the first iterations and after"""
WIDE_ITERATIONS = 3
INLIER_M = 0.06
"""off its line by less than this, a point agrees with the map"""
NOISE_M = 0.02
"""standard deviation of a point off its line: beam noise, and that neighbours err alike"""


class Alignment(NamedTuple):
    """What ICP found."""

    pose: NDArray[np.float64]
    """(3,) in the map's frame"""
    information: NDArray[np.float64]
    """(3, 3) of the scan alone about `pose`, in world axes: 1/m^2, 1/(m rad), 1/rad^2"""
    inliers: float
    """share of the points that agree with the map"""


def align(
    surfels: SurfelMap,
    points: Points,
    normals: Points,
    start: NDArray[np.float64],
    prior: NDArray[np.float64],
    sigma: tuple[float, float],
) -> Alignment:
    """Pose of points (n, 2) with normals (n, 2), sought from `start`, near `prior` within `sigma` (m, rad)."""
    weights = np.array([sigma[0] ** -2, sigma[0] ** -2, sigma[1] ** -2])
    return Alignment(
        *solve(surfels.index, surfels.sums, surfels.chain, points, normals, start, prior, weights, ITERATIONS)
    )


@njit(cache=True)
def solve(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    points: Points,
    normals: Points,
    start: NDArray[np.float64],
    prior: NDArray[np.float64],
    weights: NDArray[np.float64],
    iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Gauss-Newton over correspondences found anew in each iteration; see `Alignment` for what it returns."""
    pose = start.copy()
    information = np.zeros((3, 3))
    inliers = 0
    for iteration in range(iterations):
        scale = WIDE_M if iteration < WIDE_ITERATIONS else NARROW_M
        information, gradient, inliers = _normal_equations(index, sums, chain, points, normals, pose, scale)
        system = information.copy()
        for k in range(3):
            off = pose[k] - prior[k]
            if k == 2:
                off = (off + np.pi) % (2 * np.pi) - np.pi
            system[k, k] += weights[k]
            gradient[k] += weights[k] * off
        step = _solve3(system, gradient)
        pose -= step
        small = abs(step[0]) < STEP_M and abs(step[1]) < STEP_M and abs(step[2]) < STEP_RAD
        if small and iteration >= WIDE_ITERATIONS:
            break
    pose[2] = (pose[2] + np.pi) % (2 * np.pi) - np.pi
    return pose, information, inliers / max(len(points), 1)


@njit(cache=True)
def _normal_equations(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    points: Points,
    normals: Points,
    pose: NDArray[np.float64],
    scale: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    hessian, gradient = np.zeros((3, 3)), np.zeros(3)
    inliers = 0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for k in range(len(points)):
        rx, ry = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        x, y = pose[0] + rx, pose[1] + ry
        nx, ny = c * normals[k, 0] - s * normals[k, 1], s * normals[k, 0] + c * normals[k, 1]
        slot = nearest(index, sums, chain, x, y, nx, ny)
        if slot < 0:
            continue
        count, norm = sums[slot, 0], np.hypot(sums[slot, 3], sums[slot, 4])
        mx, my = sums[slot, 3] / norm, sums[slot, 4] / norm
        off = mx * (x - sums[slot, 1] / count) + my * (y - sums[slot, 2] / count)
        if abs(off) < INLIER_M:
            inliers += 1
        weight = (scale * scale / (scale * scale + off * off)) ** 2 / NOISE_M**2
        turn = my * rx - mx * ry
        hessian[0, 0] += weight * mx * mx
        hessian[0, 1] += weight * mx * my
        hessian[1, 1] += weight * my * my
        hessian[0, 2] += weight * mx * turn
        hessian[1, 2] += weight * my * turn
        hessian[2, 2] += weight * turn * turn
        gradient[0] += weight * mx * off
        gradient[1] += weight * my * off
        gradient[2] += weight * turn * off
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
    return hessian, gradient, inliers


@njit(cache=True)
def nearest(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    x: float,
    y: float,
    nx: float,
    ny: float,
) -> int:
    """The surfel with the nearest mean in the 3 x 3 cells around (x, y) that faces as (nx, ny) does; -1 for none."""
    mask = len(index) - 1
    i, j = int(np.floor(x / CELL)), int(np.floor(y / CELL))
    found, best = -1, np.inf
    for row in range(j - 1, j + 2):
        for column in range(i - 1, i + 2):
            slot = index[row & mask, column & mask]
            while slot >= 0:
                if nx * sums[slot, 3] + ny * sums[slot, 4] > SAME_SIDE * np.hypot(sums[slot, 3], sums[slot, 4]):
                    dx, dy = x - sums[slot, 1] / sums[slot, 0], y - sums[slot, 2] / sums[slot, 0]
                    square = dx * dx + dy * dy
                    if square < best:
                        found, best = slot, square
                slot = chain[slot]
    return found


@njit(cache=True)
def _solve3(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """x with `a` x = `b` for a positive definite 3 x 3 matrix, by LDL^T."""
    d0 = a[0, 0]
    l10, l20 = a[1, 0] / d0, a[2, 0] / d0
    d1 = a[1, 1] - l10 * l10 * d0
    l21 = (a[2, 1] - l20 * l10 * d0) / d1
    d2 = a[2, 2] - l20 * l20 * d0 - l21 * l21 * d1
    y0 = b[0]
    y1 = b[1] - l10 * y0
    y2 = b[2] - l20 * y0 - l21 * y1
    x2 = y2 / d2
    x1 = y1 / d1 - l21 * x2
    x0 = y0 / d0 - l10 * x1 - l20 * x2
    return np.array([x0, x1, x2])
