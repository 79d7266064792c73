"""The overlap graph as a matrix: exact weights, the cut, and what a balanced grouping is.

A grouping is an integer array `groups` of shape (V,): `groups[v] = i` means that robot v is in P_(i+1) of the paper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import UsageError

Weights = NDArray[np.float64]
"""(V, V) overlap matrix: symmetric, zero diagonal, each entry a multiple of QUANTUM"""
Groups = NDArray[np.int64]

QUANTUM = 2.0**-20
"""Sums of multiples of it are exact in float64, so that every implementation breaks ties alike."""


def quantise(weights: ArrayLike) -> Weights:
    """(V, V) weights rounded to multiples of QUANTUM.

    Raises UsageError for a matrix that is not square, finite, symmetric, non-negative and zero on its diagonal.
    """
    matrix = np.asarray(weights, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise UsageError(f"overlap matrix: shape {matrix.shape} is not square; give one row and column per robot")
    if not np.isfinite(matrix).all():
        raise UsageError("overlap matrix: holds NaN or infinity; give 0 for pairs that are not known to overlap")
    if (matrix < 0).any():
        raise UsageError("overlap matrix: negative overlap; weights are shares of area, 0 and above")
    exact = np.rint(matrix / QUANTUM) * QUANTUM
    if not np.array_equal(exact, exact.T):
        raise UsageError("overlap matrix: not symmetric; w(u, v) must equal w(v, u)")
    if exact.diagonal().any():
        raise UsageError("overlap matrix: the diagonal must be zero, a robot is no neighbour of itself")
    return exact


def cut(weights: Weights, groups: Groups) -> float:
    """Eq. 5, the fitness f: sum of overlaps across groups, each pair counted once."""
    return float(weights[groups[:, None] != groups[None, :]].sum() / 2)


def balanced_sizes(count: int, groups: int) -> NDArray[np.int64]:
    """(groups,) sizes of a balanced grouping of `count` robots: they differ by at most one, the bigger ones first."""
    sizes = np.full(groups, count // groups, dtype=np.int64)
    sizes[: count % groups] += 1
    return sizes
