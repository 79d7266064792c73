"""Point-to-line alignment of a scan with a surfel map (Censi 2008's metric, robust weights, a motion prior).

A scan whose motion within the sweep was only guessed is aligned together with what that guess was off by: each
point then moves by the correction to the velocity times the point's own time, and both are solved for at once. The
velocity is tethered to the motion since the scan before, or a map skewed by a wrong one would keep it going wrong.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.geometry import between, compose
from services.edge_worker.slam.graph.certainty import believed, owed
from services.edge_worker.slam.graph.surfels import SurfelMap, met
from services.edge_worker.slam.scan import Points

ITERATIONS = 15
STEP_M = 2e-4
STEP_RAD = 4e-5
"""steps smaller than these end the iteration"""
WIDE_M, NARROW_M = 0.12, 0.04
"""scale of the robust weight in the first iterations and after"""
WIDE_ITERATIONS = 3
INLIER_M = 0.06
"""off its line by less than this, a point agrees with the map"""
SCATTER = 0.003
"""rad^2, variance of the direction of a surfel's normal"""
NOISE_M = 0.02
"""standard deviation of a point off its line: beam noise, and that neighbours err alike"""
NOTHING = 1e-6 * np.eye(3)
"""information that changes nothing and can be inverted"""


class Sweep(NamedTuple):
    """A guessed motion within a sweep."""

    times: NDArray[np.float32]
    """(n,) of the points, s from the stamp on; empty: the motion is known"""
    velocity: NDArray[np.float64]
    """(3,) guessed, that the points were compensated with: m/s, m/s, rad/s"""
    before: NDArray[np.float64]
    """(3,) pose at the scan before"""
    rates: NDArray[np.float64]
    """(3,) 1/s between the scans for each part of the velocity, 0 where the guess is better than that"""
    sigma: tuple[float, float]
    """m/s, rad/s: standard deviation of the velocity about the motion between the scans"""


KNOWN = Sweep(np.empty(0, np.float32), np.zeros(3), np.zeros(3), np.zeros(3), (1.0, 1.0))


class Alignment(NamedTuple):
    """What ICP found."""

    pose: NDArray[np.float64]
    """(3,) in the map's frame"""
    information: NDArray[np.float64]
    """(3, 3) of the scan alone about `pose`, in its own frame: 1/m^2, 1/(m rad), 1/rad^2"""
    inliers: float
    """share of the points that agree with the map"""
    slip: NDArray[np.float64]
    """(3,) correction to the velocity in the sweep, m/s, m/s, rad/s in the base frame"""


def align(
    surfels: SurfelMap,
    points: Points,
    normals: Points,
    start: NDArray[np.float64],
    prior: NDArray[np.float64],
    sigma: tuple[float, float],
    sweep: Sweep = KNOWN,
    scatter: float = SCATTER,
) -> Alignment:
    """Pose of points (n, 2) with normals (n, 2), sought from `start`, near `prior` within `sigma` (m, rad)."""
    spread = np.array([sigma[0], sigma[0], sigma[1], sweep.sigma[0], sweep.sigma[0], sweep.sigma[1]])
    pose, slip, hessian, inliers = solve(
        surfels.index,
        surfels.sums,
        surfels.chain,
        points,
        normals,
        sweep.times,
        sweep.velocity,
        sweep.before,
        sweep.rates,
        start,
        prior,
        spread**-2.0,
        ITERATIONS,
    )
    information = hessian[:3, :3]
    if len(sweep.times):
        cross, rest = hessian[:3, 3:], hessian[3:, 3:] + np.diag(spread[3:] ** -2.0)
        information = information - cross @ np.linalg.solve(rest, cross.T)
    trusted = believed(information, scatter)
    pose = compose(pose, owed(information + NOTHING, trusted, spread[:3] ** -2.0, between(pose, prior)))
    return Alignment(pose, trusted, inliers, slip)


@njit(cache=True)
def solve(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    points: Points,
    normals: Points,
    times: NDArray[np.float32],
    velocity: NDArray[np.float64],
    before: NDArray[np.float64],
    rates: NDArray[np.float64],
    start: NDArray[np.float64],
    prior: NDArray[np.float64],
    weights: NDArray[np.float64],
    iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Gauss-Newton over correspondences found anew in each iteration: pose, slip, Hessian (6, 6), share of inliers."""
    pose, slip = start.copy(), np.zeros(3)
    size = 6 if len(times) else 3
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    inliers = 0
    for iteration in range(iterations):
        scale = WIDE_M if iteration < WIDE_ITERATIONS else NARROW_M
        inliers = _normal_equations(index, sums, chain, points, normals, times, pose, slip, scale, hessian, gradient)
        _pull(gradient, weights, pose, prior)
        _tether(gradient, weights, slip, velocity, before, rates, pose)
        system = hessian.copy()
        for k in range(6):
            system[k, k] += weights[k]
        step = _solve(system, gradient, size)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose[0] -= c * step[0] - s * step[1]
        pose[1] -= s * step[0] + c * step[1]
        pose[2] -= step[2]
        for k in range(size - 3):
            slip[k] -= step[3 + k]
        small = abs(step[0]) < STEP_M and abs(step[1]) < STEP_M and abs(step[2]) < STEP_RAD
        if small and iteration >= WIDE_ITERATIONS:
            break
    pose[2] = (pose[2] + np.pi) % (2 * np.pi) - np.pi
    return pose, slip, hessian, inliers / max(len(points), 1)


@njit(cache=True)
def _pull(
    gradient: NDArray[np.float64], weights: NDArray[np.float64], pose: NDArray[np.float64], prior: NDArray[np.float64]
) -> None:
    """Pull the pose to the prior."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = pose[0] - prior[0], pose[1] - prior[1]
    gradient[0] += weights[0] * (c * dx + s * dy)
    gradient[1] += weights[1] * (-s * dx + c * dy)
    gradient[2] += weights[2] * ((pose[2] - prior[2] + np.pi) % (2 * np.pi) - np.pi)


@njit(cache=True)
def _tether(
    gradient: NDArray[np.float64],
    weights: NDArray[np.float64],
    slip: NDArray[np.float64],
    velocity: NDArray[np.float64],
    before: NDArray[np.float64],
    rates: NDArray[np.float64],
    pose: NDArray[np.float64],
) -> None:
    """Pull the velocity to the motion between the scans, or for want of it to the guess."""
    c, s = np.cos(before[2]), np.sin(before[2])
    dx, dy = pose[0] - before[0], pose[1] - before[1]
    turn = (pose[2] - before[2] + np.pi) % (2 * np.pi) - np.pi
    motion = (c * dx + s * dy, -s * dx + c * dy, turn)
    for k in range(3):
        off = slip[k] + velocity[k] - rates[k] * motion[k] if rates[k] > 0.0 else slip[k]
        gradient[3 + k] += weights[3 + k] * off


@njit(cache=True)
def _normal_equations(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    points: Points,
    normals: Points,
    times: NDArray[np.float32],
    pose: NDArray[np.float64],
    slip: NDArray[np.float64],
    scale: float,
    hessian: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> int:
    """Fill Hessian (6, 6) and gradient (6,) of pose and slip, in the base frame; returns the number of inliers."""
    hessian[:] = 0.0
    gradient[:] = 0.0
    row = np.zeros(6)
    size = 6 if len(times) else 3
    inliers = 0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for k in range(len(points)):
        px, py, bx, by = points[k, 0], points[k, 1], normals[k, 0], normals[k, 1]
        if size == 6:
            px, py, bx, by = _slipped(px, py, bx, by, slip, times[k])
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        slot, nx, ny, off = met(index, sums, chain, x, y, c * bx - s * by, s * bx + c * by)
        if slot < 0:
            continue
        if abs(off) < INLIER_M:
            inliers += 1
        weight = likely(off, scale) / NOISE_M**2
        row[0], row[1] = c * nx + s * ny, -s * nx + c * ny
        row[2] = row[1] * px - row[0] * py
        if size == 6:
            for m in range(3):
                row[3 + m] = times[k] * row[m]
        _accumulate(hessian, gradient, row, off, weight, size)
    for m in range(size):
        for n in range(m):
            hessian[n, m] = hessian[m, n]
    return inliers


@njit(cache=True)
def _slipped(
    x: float, y: float, nx: float, ny: float, slip: NDArray[np.float64], time: float
) -> tuple[float, float, float, float]:
    """A point and its normal moved by a correction to the velocity over `time` s."""
    c, s = np.cos(time * slip[2]), np.sin(time * slip[2])
    return time * slip[0] + c * x - s * y, time * slip[1] + s * x + c * y, c * nx - s * ny, s * nx + c * ny


@njit(cache=True)
def _accumulate(
    hessian: NDArray[np.float64],
    gradient: NDArray[np.float64],
    row: NDArray[np.float64],
    off: float,
    weight: float,
    size: int,
) -> None:
    """Add one point's share to the gradient and the lower half of the Hessian."""
    for m in range(size):
        gradient[m] += weight * row[m] * off
        for n in range(m + 1):
            hessian[m, n] += weight * row[m] * row[n]


@njit(cache=True)
def likely(off: float, scale: float) -> float:
    """Robust weight, 0 to 1, of a point that lies `off` its line; `scale` in the same unit."""
    return (scale * scale / (scale * scale + off * off)) ** 2


@njit(cache=True)
def _solve(a: NDArray[np.float64], b: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """x with `a` x = `b` for the first `size` rows of a positive definite matrix, by Cholesky; `a` is used up."""
    x = b.copy()
    for j in range(size):
        for k in range(j):
            a[j, j] -= a[j, k] * a[j, k]
        a[j, j] = np.sqrt(a[j, j])
        for i in range(j + 1, size):
            for k in range(j):
                a[i, j] -= a[i, k] * a[j, k]
            a[i, j] /= a[j, j]
    for i in range(size):
        for k in range(i):
            x[i] -= a[i, k] * x[k]
        x[i] /= a[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            x[i] -= a[k, i] * x[k]
        x[i] /= a[i, i]
    return x
