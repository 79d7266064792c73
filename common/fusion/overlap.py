"""How much maps know in common: pairwise overlapping degrees and the union of many, by coarse footprints.

The overlapping degree is the paper's w = |A∩B| / (|A| + |B|) over known cells, 0 to 0.5; IoU = w / (1 - w).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from common.fusion.matchmap import MatchMap
from common.geometry.se2 import apply
from common.grid.grid import UNKNOWN

FOOTPRINT_M = 0.4
"""cell of a footprint"""


def overlap(a: MatchMap, b: MatchMap, transform: ArrayLike) -> float:
    """w of two maps when `transform` is the pose of b's frame in a's."""
    total = a.known_m2 + b.known_m2
    return min(0.5, shared_area(a, b, transform) / total) if total else 0.0


def shared_area(a: MatchMap, b: MatchMap, transform: ArrayLike, step: int = 2) -> float:
    """m^2 known to both maps, by the cells of b in every `step`-th row and column."""
    return shared_cells(a, b, transform, step) * b.resolution**2


def shared_cells(a: MatchMap, b: MatchMap, transform: ArrayLike, step: int = 2) -> int:
    """b's known cells whose centre falls in a known cell of a; every `step`-th row and column is looked at."""
    pose = np.asarray(transform, np.float64)
    count = _shared(pose, a.occupancy, a.origin, a.resolution, b.occupancy, b.origin, b.resolution, step)
    return step**2 * int(count)


@dataclass(frozen=True)
class Footprints:
    """Where k maps are known: coarse rasters on one lattice of the frame that they were placed in."""

    known: NDArray[np.bool_]
    """(k, h, w) cells of FOOTPRINT_M"""

    @classmethod
    def of(cls, maps: Sequence[MatchMap], transforms: Sequence[ArrayLike]) -> Footprints:
        """Footprints of maps placed by their poses (3,) in a common frame."""
        cells = [
            _footprint_cells(map_, np.asarray(pose, np.float64)) for map_, pose in zip(maps, transforms, strict=True)
        ]
        filled = [c for c in cells if len(c)]
        if not filled:
            return cls(np.zeros((len(maps), 1, 1), np.bool_))
        low = np.min([c.min(axis=0) for c in filled], axis=0)
        width, height = np.max([c.max(axis=0) for c in filled], axis=0) + 1 - low
        known = np.zeros((len(maps), height, width), np.bool_)
        for k, places in enumerate(cells):
            x, y = (places - low).T
            known[k, y, x] = True
        return cls(known)

    def union_m2(self, of: Sequence[int] | None = None) -> float:
        """Area known to any of the maps with the given indices (all by default)."""
        chosen = self.known if of is None else self.known[list(of)]
        return float(chosen.any(axis=0).sum()) * FOOTPRINT_M**2

    def weights(self) -> NDArray[np.float64]:
        """(k, k) overlapping degrees w, 0 on the diagonal."""
        flat = self.known.reshape(len(self.known), -1).astype(np.float32)
        shared = (flat @ flat.T).astype(np.float64)
        areas = np.diag(shared)
        total = areas[:, None] + areas[None, :]
        w = np.divide(shared, total, out=np.zeros_like(shared), where=total > 0)
        np.fill_diagonal(w, 0.0)
        return w


def _footprint_cells(map_: MatchMap, pose: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n, 2) footprint cells (x, y) in which the placed map knows at least a quarter."""
    rows, columns = np.nonzero(map_.occupancy != UNKNOWN)
    points = map_.origin + (np.stack([columns, rows], axis=1) + 0.5) * map_.resolution
    cells, counts = np.unique(np.floor(apply(pose, points) / FOOTPRINT_M).astype(np.int64), axis=0, return_counts=True)
    return cells[counts * map_.resolution**2 >= 0.25 * FOOTPRINT_M**2]


@njit(cache=True)
def _shared(
    pose: NDArray[np.float64],
    known_a: NDArray[np.int8],
    origin_a: NDArray[np.float64],
    resolution_a: float,
    known_b: NDArray[np.int8],
    origin_b: NDArray[np.float64],
    resolution_b: float,
    step: int,
) -> int:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    height, width = known_a.shape
    count = 0
    for row in range(0, known_b.shape[0], step):
        y = origin_b[1] + (row + 0.5) * resolution_b
        # of this row only the columns from first to end can fall into a; the test in the loop is exact
        first, end = 0.0, float(known_b.shape[1])
        for start, along, size in (
            (pose[0] - s * y - origin_a[0], c, width * resolution_a),
            (pose[1] + c * y - origin_a[1], s, height * resolution_a),
        ):
            if abs(along) > 1e-9:
                one, other = -start / along, (size - start) / along
                first = max(first, (min(one, other) - origin_b[0]) / resolution_b - 1.5)
                end = min(end, (max(one, other) - origin_b[0]) / resolution_b + 1.5)
        begin = (math.floor(first) // step) * step if first < end else 0
        for column in range(begin, math.ceil(end) if first < end else 0, step):
            if known_b[row, column] == -1:
                continue
            x = origin_b[0] + (column + 0.5) * resolution_b
            i = math.floor((pose[0] + c * x - s * y - origin_a[0]) / resolution_a)
            j = math.floor((pose[1] + s * x + c * y - origin_a[1]) / resolution_a)
            if 0 <= i < width and 0 <= j < height and known_a[j, i] != -1:
                count += 1
    return count
