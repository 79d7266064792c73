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
from common.fusion.walls import NX, NY, SIDED, STRAIGHTNESS, Walls, X, Y, alike
from common.geometry.se2 import IDENTITY, inverse
from common.grid.grid import FREE, STOOD, UNKNOWN

BLOB_CELL_M = 0.2
AREA_M = 0.25
"""lattice on which the area known to both is counted"""
SLACK = 1e-9
"""cells squared; a limit that is a whole number of cells is kept to whatever the rounding"""
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
        return float(pieces_m(self.clashing).max(initial=0.0))

    @property
    def agreement(self) -> float:
        return self.agreeing_m / self.judged_m if self.judged_m else 0.0

    @property
    def conflict(self) -> float:
        return self.conflicting_m / self.judged_m if self.judged_m else 0.0


Target = tuple[
    NDArray[np.float64],
    NDArray[np.int64],
    NDArray[np.int32],
    NDArray[np.int8],
    NDArray[np.float64],
    float,
    float,
    float,
]
"""A map that walls of another are judged in (a plain tuple, which compiled code takes quickest): lines (n, 6) and cells
(n, 2) of its walls, index (h, w) of the nearest wall, ground (h, w), origin and resolution (see MatchMap), and in cells
squared up to which distance a wall agrees with one of its walls, and from above which it contradicts"""


def weigh(a: MatchMap, b: MatchMap, pose: NDArray[np.float64], settings: FusionSettings) -> Evidence:
    """The evidence about `pose`, the pose of b's frame in a's."""
    in_a = classify(a, b.sample, pose, settings)
    in_b = classify(b, a.sample, inverse(pose), settings)
    return tally(a, b, in_a, in_b, _clashing(in_a, b.sample.lines, pose), pose)


def tally(
    a: MatchMap,
    b: MatchMap,
    in_a: NDArray[np.int8],
    in_b: NDArray[np.int8],
    clashing: NDArray[np.float64],
    pose: NDArray[np.float64],
) -> Evidence:
    """The evidence from the labels of b's sampled walls in a, where the `clashing` points are of them, and a's in b."""
    metres = [map_.wall_m / max(len(labels), 1) / 2 for labels, map_ in ((in_a, b), (in_b, a))]
    lengths = _counts(in_a) * metres[0] + _counts(in_b) * metres[1]
    return Evidence(
        agreeing_m=float(lengths[AGREES]),
        conflicting_m=float(lengths[CONTRADICTS]),
        judged_m=float(lengths[1:].sum()),
        clashing=np.concatenate([clashing, _clashing(in_b, a.sample.lines, IDENTITY)]),
        overlap_m2=shared_area(a, b, pose, max(1, round(AREA_M / b.resolution))),
    )


def classify(into: MatchMap, sample: Walls, pose: NDArray[np.float64], settings: FusionSettings) -> NDArray[np.int8]:
    """OUTSIDE, AGREES, CONTRADICTS or NEITHER for each wall of a sample when its map lies at `pose` in `into`."""
    return np.asarray(classify_lines(np.asarray(pose, np.float64), sample.lines, target(into, settings)))


def target(into: MatchMap, settings: FusionSettings) -> Target:
    """The map `into` as `classify_lines` takes it."""
    return (
        into.walls.lines,
        into.walls.cells,
        into.nearest.wall,
        into.ground,
        into.origin,
        into.resolution,
        (settings.tolerance_m / into.resolution) ** 2 + SLACK,
        (settings.contradiction_m / into.resolution) ** 2 + SLACK,
    )


def pieces_m(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k,) lengths in m (0.2 m cells passed) of the connected groups of points (n, 2)."""
    if not len(points):
        return np.zeros(0)
    cells = np.floor(points / BLOB_CELL_M).astype(np.int64)
    cells -= cells.min(axis=0)
    raster = np.zeros(cells.max(axis=0) + 1, np.uint8)
    raster[cells[:, 0], cells[:, 1]] = 1
    _, labels = cv2.connectedComponents(raster, connectivity=8)
    return np.asarray(BLOB_CELL_M * np.bincount(labels.ravel())[1:], np.float64)


@njit(cache=True)
def _counts(labels: NDArray[np.int8]) -> NDArray[np.int64]:
    """(4,) how often each label occurs."""
    counts = np.zeros(4, np.int64)
    for label in labels:
        counts[label] += 1
    return counts


@njit(cache=True)
def _clashing(labels: NDArray[np.int8], lines: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) the points of the contradicting walls, brought to where `pose` puts their frame."""
    count = 0
    for label in labels:
        count += label == CONTRADICTS
    points, i = np.empty((count, 2)), 0
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(labels)):
        if labels[k] == CONTRADICTS:
            points[i, 0] = pose[0] + c * lines[k, X] - s * lines[k, Y]
            points[i, 1] = pose[1] + s * lines[k, X] + c * lines[k, Y]
            i += 1
    return points


@njit(cache=True)
def classify_lines(pose: NDArray[np.float64], lines: NDArray[np.float64], into: Target) -> NDArray[np.int8]:
    """Labels of the walls `lines`. Where the own robot of `into` stood, a wall is this robot and says nothing."""
    walls, cells, nearest, ground, origin, resolution, agrees, contradicts = into
    labels = np.zeros(len(lines), np.int8)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    height, width = ground.shape
    for k in range(len(lines)):
        x = pose[0] + c * lines[k, X] - s * lines[k, Y]
        y = pose[1] + s * lines[k, X] + c * lines[k, Y]
        column = math.floor((x - origin[0]) / resolution)
        row = math.floor((y - origin[1]) / resolution)
        if row < 1 or column < 1 or row >= height - 1 or column >= width - 1:
            continue
        wall = nearest[row, column]
        far = wall < 0
        if not far:
            square = (cells[wall, 0] - row) ** 2 + (cells[wall, 1] - column) ** 2
            if square <= agrees:
                nx, ny = c * lines[k, NX] - s * lines[k, NY], s * lines[k, NX] + c * lines[k, NY]
                same = alike(
                    nx * walls[wall, NX] + ny * walls[wall, NY],
                    lines[k, STRAIGHTNESS],
                    walls[wall, STRAIGHTNESS],
                    lines[k, SIDED],
                    walls[wall, SIDED],
                )
                labels[k] = AGREES if same else NEITHER
                continue
            far = square > contradicts
        if ground[row, column] == UNKNOWN or ground[row, column] == STOOD:
            continue
        labels[k] = NEITHER
        if far:
            open_ = True
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    open_ &= ground[row + dy, column + dx] == FREE or ground[row + dy, column + dx] == STOOD
            if open_:
                labels[k] = CONTRADICTS
    return labels
