"""Straightening a bent map: a field of shifts over its own frame, by which its cells and its trajectory move alike.

The field is what a joint correction of trajectories leaves of itself for the map (common.fusion.joint). It is linear
between the nodes of a lattice, and rendering looks it up in whole numbers, so every machine renders the same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from common.geometry.se2 import wrap
from common.wire.cloud import Warp

SHIFT = 36
"""fractional bits of a cell coordinate"""
WEIGHT = 12
"""bits of a weight between two nodes"""
SWING_M = 0.5
"""half the distance over which the field's turning is measured"""


class Lattice(NamedTuple):
    """A warp as rendering uses it; lengths in 2^-36 cells of the map."""

    first: NDArray[np.int64]
    """(2,) x and y of the first node"""
    spacing: int
    shifts: NDArray[np.int64]
    """(rows, columns, 2) along x and y; no rows: nothing is shifted"""


STRAIGHT = Lattice(np.zeros(2, np.int64), 1 << SHIFT, np.zeros((0, 0, 2), np.int64))


def lattice(warp: Warp, resolution: float) -> Lattice:
    """The warp of a map of `resolution` m a cell."""
    spacing = round(warp.spacing_m / resolution * (1 << SHIFT))
    um = np.array(warp.shifts_um, np.int64).reshape(-1, warp.columns, 2)
    cell = round((1 << SHIFT) / (resolution * 1e6))
    return Lattice(np.array([warp.x, warp.y], np.int64) * spacing, spacing, um * cell)


def shifts(warp: Warp, points: ArrayLike) -> NDArray[np.float64]:
    """(n, 2) m by which points (n, 2) m of the map's frame are moved, in that frame."""
    field = np.array(warp.shifts_um, np.float64).reshape(-1, warp.columns, 2) * 1e-6
    at = np.asarray(points, np.float64) / warp.spacing_m - (warp.x, warp.y)
    at = np.clip(at, 0, (field.shape[1] - 1, field.shape[0] - 1))
    i, j = np.minimum(np.floor(at).astype(np.int64), (field.shape[1] - 2, field.shape[0] - 2)).T
    u, v = (at[:, 0] - i)[:, None], (at[:, 1] - j)[:, None]
    low = field[j, i] * (1 - u) + field[j, i + 1] * u
    high = field[j + 1, i] * (1 - u) + field[j + 1, i + 1] * u
    return np.asarray(low * (1 - v) + high * v)


def straightened(warp: Warp | None, poses: ArrayLike) -> NDArray[np.float64]:
    """Poses (n, 3) of the map's frame where they lie once it is straightened, turned as the field turns there."""
    poses = np.asarray(poses, np.float64)
    if warp is None or not len(poses):
        return poses
    x, y = np.array([SWING_M, 0.0]), np.array([0.0, SWING_M])
    at = poses[:, :2]
    swing = (shifts(warp, at + x) - shifts(warp, at - x))[:, 1] - (shifts(warp, at + y) - shifts(warp, at - y))[:, 0]
    return np.column_stack([at + shifts(warp, at), wrap(poses[:, 2] + swing / (4 * SWING_M))])


@njit(cache=True)
def shift_at(x: int, y: int, first: NDArray[np.int64], spacing: int, shifts: NDArray[np.int64]) -> tuple[int, int]:
    """The shift at a point, all in 2^-36 cells; beyond the lattice that of its border."""
    i, u = _between(x - first[0], spacing, shifts.shape[1])
    j, v = _between(y - first[1], spacing, shifts.shape[0])
    full = np.int64(1) << WEIGHT
    ax = (shifts[j, i, 0] * (full - u) + shifts[j, i + 1, 0] * u) >> WEIGHT
    ay = (shifts[j, i, 1] * (full - u) + shifts[j, i + 1, 1] * u) >> WEIGHT
    bx = (shifts[j + 1, i, 0] * (full - u) + shifts[j + 1, i + 1, 0] * u) >> WEIGHT
    by = (shifts[j + 1, i, 1] * (full - u) + shifts[j + 1, i + 1, 1] * u) >> WEIGHT
    return (ax * (full - v) + bx * v) >> WEIGHT, (ay * (full - v) + by * v) >> WEIGHT


@njit(cache=True)
def _between(away: int, spacing: int, nodes: int) -> tuple[int, int]:
    """The node before a place `away` from the first one, and the weight of the one after it."""
    node: int = min(max(away // spacing, 0), nodes - 2)
    rest: int = min(max(away - node * spacing, 0), spacing)
    return node, min(rest // (spacing >> WEIGHT), 1 << WEIGHT)
