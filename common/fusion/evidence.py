"""What two maps say about a transform: walls that find a wall, walls in free space, and area known to both.

Each wall of one map, brought into the other, either agrees (a wall within the tolerance), contradicts (open free
space around it), is neither, or falls outside of what the other knows. Contradictions of a right transform are
scattered (clutter, people, a bent map); those of a wrong one join into blobs as long as walls.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.fusion.matchmap import MatchMap
from common.fusion.overlap import shared_area
from common.fusion.settings import FusionSettings
from common.fusion.walls import Walls, alike
from common.geometry.se2 import apply, inverse

BLOB_CELL_M = 0.2
AREA_M = 0.25
"""lattice on which the area known to both is counted"""
OUTSIDE, AGREES, CONTRADICTS, NEITHER = 0, 1, 2, 3


class Evidence(NamedTuple):
    """Lengths in metres of wall, summed over both directions and halved."""

    agreeing_m: float
    conflicting_m: float
    judged_m: float
    """all walls within the overlap"""
    clashing: NDArray[np.float64]
    """(n, 2) m in a's frame: sampled walls of both maps that contradict"""
    overlap_m2: float
    """area known to both"""

    @property
    def blob_m(self) -> float:
        """Length of the largest coherent contradiction."""
        return longest_blob(self.clashing)

    @property
    def agreement(self) -> float:
        return self.agreeing_m / self.judged_m if self.judged_m else 0.0

    @property
    def conflict(self) -> float:
        return self.conflicting_m / self.judged_m if self.judged_m else 0.0


def weigh(a: MatchMap, b: MatchMap, pose: NDArray[np.float64], settings: FusionSettings) -> Evidence:
    """The evidence about `pose`, the pose of b's frame in a's."""
    in_a = classify(a, b.sample, pose, settings)
    in_b = classify(b, a.sample, inverse(pose), settings)
    clashing = apply(pose, b.sample.points[in_a == CONTRADICTS])
    return tally(a, b, in_a, in_b, clashing, pose)


def tally(
    a: MatchMap,
    b: MatchMap,
    in_a: NDArray[np.int8],
    in_b: NDArray[np.int8],
    clashing: NDArray[np.float64],
    pose: NDArray[np.float64],
) -> Evidence:
    """The evidence from the labels of b's sampled walls in a, where the `clashing` points are of them, and a's in b."""
    lengths = np.zeros(4)
    for labels, map_ in ((in_a, b), (in_b, a)):
        if len(labels):
            lengths += np.bincount(labels, minlength=4) * (map_.wall_m / len(labels) / 2)
    return Evidence(
        agreeing_m=float(lengths[AGREES]),
        conflicting_m=float(lengths[CONTRADICTS]),
        judged_m=float(lengths[1:].sum()),
        clashing=np.concatenate([clashing, a.sample.points[in_b == CONTRADICTS]]),
        overlap_m2=shared_area(a, b, pose, max(1, round(AREA_M / b.resolution))),
    )


def classify(target: MatchMap, sample: Walls, pose: NDArray[np.float64], settings: FusionSettings) -> NDArray[np.int8]:
    """OUTSIDE, AGREES, CONTRADICTS or NEITHER for each wall of a sample when its map lies at `pose` in the target."""
    return _classify(
        np.asarray(pose, np.float64),
        sample.points,
        sample.normals,
        sample.straightness,
        sample.sided,
        target.occupancy,
        target.nearest.distance,
        target.nearest.wall,
        target.walls.normals,
        target.walls.straightness,
        target.walls.sided,
        target.origin,
        target.resolution,
        settings.tolerance_m,
        settings.contradiction_m,
    )


def longest_blob(points: NDArray[np.float64]) -> float:
    """Length in m (0.2 m cells passed) of the largest connected group of points (n, 2)."""
    if not len(points):
        return 0.0
    cells = np.floor(points / BLOB_CELL_M).astype(np.int64)
    cells -= cells.min(axis=0)
    raster = np.zeros(cells.max(axis=0) + 1, np.uint8)
    raster[cells[:, 0], cells[:, 1]] = 1
    count, labels = cv2.connectedComponents(raster, connectivity=8)
    return BLOB_CELL_M * int(np.bincount(labels.ravel())[1:].max()) if count > 1 else 0.0


@njit(cache=True)
def _classify(
    pose: NDArray[np.float64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    straightness: NDArray[np.float64],
    sided: NDArray[np.bool_],
    occupancy: NDArray[np.int8],
    distance: NDArray[np.float32],
    nearest: NDArray[np.int32],
    wall_normals: NDArray[np.float64],
    wall_straightness: NDArray[np.float64],
    wall_sided: NDArray[np.bool_],
    origin: NDArray[np.float64],
    resolution: float,
    tolerance: float,
    contradiction: float,
) -> NDArray[np.int8]:
    labels = np.zeros(len(points), np.int8)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    height, width = occupancy.shape
    for k in range(len(points)):
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        column = math.floor((x - origin[0]) / resolution)
        row = math.floor((y - origin[1]) / resolution)
        if row < 1 or column < 1 or row >= height - 1 or column >= width - 1:
            continue
        if distance[row, column] <= tolerance:
            wall = nearest[row, column]
            nx, ny = wall_normals[wall, 0], wall_normals[wall, 1]
            cosine = nx * (c * normals[k, 0] - s * normals[k, 1]) + ny * (s * normals[k, 0] + c * normals[k, 1])
            same = alike(cosine, straightness[k], wall_straightness[wall], sided[k], wall_sided[wall])
            labels[k] = 1 if same else 3
            continue
        if occupancy[row, column] == -1:
            continue
        labels[k] = 3
        if distance[row, column] > contradiction:
            frontier = False
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    frontier |= occupancy[row + dy, column + dx] != 0
            if not frontier:
                labels[k] = 2
    return labels
