"""A sparse graph of keyframe poses, corrected by robust Gauss-Newton.

Edges measure one keyframe in the frame of another. Loop edges are scaled down when they disagree with the rest
(dynamic covariance scaling, Agarwal et al. 2013); the first keyframe is held, so the map's frame never moves.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

ROBUST_CHI2 = 6.0
"""squared error, in standard deviations, up to which a loop edge counts in full"""
ANNEALING = 10.0
"""factor by which that limit falls to `ROBUST_CHI2` from the worst new loop's error"""
REFUTED_CHI2 = 50.0
"""squared error, in standard deviations, beyond which a new loop counts for less than a twentieth: it is refuted"""
CONVERGED = 5e-4
"""m or rad; smaller steps end the optimisation"""
MAX_ITERATIONS = 40


class PoseGraph:
    """Poses of keyframes and the edges between them."""

    def __init__(self) -> None:
        self.poses = np.zeros((0, 3))
        """(n, 3) m, m, rad"""
        self.pairs = np.zeros((0, 2), np.int64)
        """(e, 2) keyframes i and j of each edge"""
        self.measured = np.zeros((0, 3))
        """(e, 3) pose of j in the frame of i"""
        self.information = np.zeros((0, 3, 3))
        """(e, 3, 3) of the measurement, in the frame of j"""
        self.loops = np.zeros(0, np.uint8)
        """(e,) 1 for loop edges"""

    def add_node(self, pose: NDArray[np.float64]) -> int:
        self.poses = np.vstack([self.poses, pose])
        return len(self.poses) - 1

    def add_edge(
        self, i: int, j: int, measured: NDArray[np.float64], information: NDArray[np.float64], loop: bool
    ) -> None:
        """`measured` is the pose (3,) of j in the frame of i, `information` (3, 3) its, in the frame of j."""
        self.pairs = np.vstack([self.pairs, np.array([[i, j]])])
        self.measured = np.vstack([self.measured, measured])
        self.information = np.concatenate([self.information, information[None]])
        self.loops = np.append(self.loops, np.uint8(loop))

    def optimise(self, iterations: int, fresh: int) -> float:
        """Correct the poses, `iterations` times at the final limit of robustness; returns the largest shift in m.

        The latest `fresh` loop edges are new: robustness gives way to them first, as they may have far to pull.
        """
        if len(self.poses) < 2 or not self.loops.any():
            return 0.0
        before = self.poses.copy()
        system = _System(self.pairs, len(self.poses))
        limit = max(ROBUST_CHI2, float(self.chi2()[self.loops == 1][-fresh:].max()))
        for _ in range(MAX_ITERATIONS):
            blocks, gradient = linearise(self.poses, self.pairs, self.measured, self.information, self.loops, limit)
            step = system.solve(blocks, gradient)
            self.poses = self.poses + step
            self.poses[:, 2] = (self.poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
            iterations -= limit <= ROBUST_CHI2
            if iterations <= 0 or (limit <= ROBUST_CHI2 and np.abs(step).max() < CONVERGED):
                break
            limit = max(ROBUST_CHI2, limit / ANNEALING)
        return float(np.hypot(*(self.poses - before)[:, :2].T).max())

    def drop_refuted(self, fresh: int) -> int:
        """Drop those of the latest `fresh` loop edges that the rest still contradicts once optimised; how many."""
        latest = np.flatnonzero(self.loops)[-fresh:]
        gone = latest[self.chi2()[latest] > REFUTED_CHI2]
        for name in ("pairs", "measured", "information", "loops"):
            setattr(self, name, np.delete(getattr(self, name), gone, axis=0))
        return len(gone)

    def chi2(self) -> NDArray[np.float64]:
        """Squared error (e,) of each edge in standard deviations."""
        return squared_errors(self.poses, self.pairs, self.measured, self.information)


class _System:
    """The sparse normal equations of one set of edges: the pattern is found once, the numbers often."""

    def __init__(self, pairs: NDArray[np.int64], nodes: int) -> None:
        self.size = 3 * (nodes - 1)
        i, j = pairs[:, 0], pairs[:, 1]
        blocks = np.stack([np.stack([i, i]), np.stack([i, j]), np.stack([j, i]), np.stack([j, j])]).transpose(2, 0, 1)
        rows = 3 * (blocks[:, :, 0] - 1)[:, :, None, None] + np.arange(3)[:, None]
        columns = 3 * (blocks[:, :, 1] - 1)[:, :, None, None] + np.arange(3)[None, :]
        rows, columns = np.broadcast_arrays(rows, columns)
        self.free = ((rows >= 0) & (columns >= 0)).ravel()
        keys = columns.ravel()[self.free] * self.size + rows.ravel()[self.free]
        unique, self.place = np.unique(keys, return_inverse=True)
        self.rows = (unique % self.size).astype(np.int32)
        self.starts = np.searchsorted(unique, np.arange(self.size + 1) * self.size).astype(np.int32)

    def solve(self, blocks: NDArray[np.float64], gradient: NDArray[np.float64]) -> NDArray[np.float64]:
        """The Gauss-Newton step (n, 3); the first pose keeps still."""
        data = np.bincount(self.place, blocks.ravel()[self.free], len(self.rows))
        matrix = csc_matrix((data, self.rows, self.starts), shape=(self.size, self.size))
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        step = np.zeros_like(gradient)
        step[1:] = -factors.solve(gradient[1:].ravel()).reshape(-1, 3)
        return step


@njit(cache=True)
def _error(
    a: NDArray[np.float64], b: NDArray[np.float64], measured: NDArray[np.float64]
) -> tuple[float, float, float, float, float]:
    """The pose of b in a, seen from where it was measured: x, y, theta; and cosine and sine of that frame's heading."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    x, y = c * dx + s * dy - measured[0], -s * dx + c * dy - measured[1]
    cm, sm = np.cos(measured[2]), np.sin(measured[2])
    theta = (b[2] - a[2] - measured[2] + np.pi) % (2 * np.pi) - np.pi
    heading = a[2] + measured[2]
    return cm * x + sm * y, -sm * x + cm * y, theta, np.cos(heading), np.sin(heading)


@njit(cache=True)
def squared_errors(
    poses: NDArray[np.float64],
    pairs: NDArray[np.int64],
    measured: NDArray[np.float64],
    information: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Mahalanobis distance squared (e,) of each edge."""
    out = np.empty(len(pairs))
    e = np.empty(3)
    for k in range(len(pairs)):
        e[0], e[1], e[2], _, _ = _error(poses[pairs[k, 0]], poses[pairs[k, 1]], measured[k])
        total = 0.0
        for r in range(3):
            for q in range(3):
                total += e[r] * information[k, r, q] * e[q]
        out[k] = total
    return out


@njit(cache=True)
def linearise(
    poses: NDArray[np.float64],
    pairs: NDArray[np.int64],
    measured: NDArray[np.float64],
    information: NDArray[np.float64],
    loops: NDArray[np.uint8],
    limit: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Hessian blocks (e, 4, 3, 3) in the order ii, ij, ji, jj, and the gradient (n, 3)."""
    blocks = np.empty((len(pairs), 4, 3, 3))
    gradient = np.zeros_like(poses)
    chi2 = squared_errors(poses, pairs, measured, information)
    e, jacobian, weighted = np.empty(3), np.zeros((2, 3, 3)), np.empty((2, 3, 3))
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        e[0], e[1], e[2], c, s = _error(poses[i], poses[j], measured[k])
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        jacobian[1, 0, 0], jacobian[1, 0, 1] = c, s
        jacobian[1, 1, 0], jacobian[1, 1, 1] = -s, c
        jacobian[1, 2, 2] = 1.0
        jacobian[0] = -jacobian[1]
        jacobian[0, 0, 2] = c * dy - s * dx
        jacobian[0, 1, 2] = -c * dx - s * dy
        scale = 1.0
        if loops[k] and chi2[k] > limit:
            scale = (2 * limit / (limit + chi2[k])) ** 2
        _multiply(jacobian, information[k], scale, weighted)
        for r in range(3):
            for q in range(3):
                gradient[i, r] += weighted[0, r, q] * e[q]
                gradient[j, r] += weighted[1, r, q] * e[q]
                for a in range(2):
                    for b in range(2):
                        total = 0.0
                        for m in range(3):
                            total += weighted[a, r, m] * jacobian[b, m, q]
                        blocks[k, 2 * a + b, r, q] = total
    return blocks, gradient


@njit(cache=True)
def _multiply(
    jacobian: NDArray[np.float64], information: NDArray[np.float64], scale: float, out: NDArray[np.float64]
) -> None:
    """scale * transposed jacobian times information, for both ends of an edge."""
    for a in range(2):
        for r in range(3):
            for q in range(3):
                total = 0.0
                for m in range(3):
                    total += jacobian[a, m, r] * information[m, q]
                out[a, r, q] = scale * total
