"""How good a map is: walls found and invented against the true wall faces, coverage, and wall thickness.

The map is brought to the truth by the robots' trajectories (`trajectory.fit_all`), never by fitting maps: a map
that is right in itself but wrongly placed against its robots is wrong.

A cell and a wall face agree when the cell's centre lies within `tolerance` cells (default one) of a point of the
face, by the Euclidean distance. Truth points are sampled along wall faces, closer than a cell:

* precision P: the share of occupied cells that have a truth point within reach;
* recall R: the share of truth points that have an occupied cell within reach;
* IoU = PR / (P + R - PR): with tp matches, P = tp/(tp+fp) and R = tp/(tp+fn), this is tp/(tp+fp+fn).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from common.errors import UsageError
from common.geometry import apply
from common.wire.base import PoseTuple

OCCUPIED_FROM = 65
"""percent"""
SLACK = 1e-9
"""m; what lies exactly at the tolerance is within it, whatever the last bit says"""


class MapScore(NamedTuple):
    """A map against the truth; all are shares (0..1) but the counts."""

    iou: float
    precision: float
    recall: float
    coverage: float
    """share of the true free space that the map knows, or the recall of walls where that was not given"""
    cells: int
    """occupied cells"""
    truth: int
    """truth points"""


def score_map(
    occupied: ArrayLike,
    truth: ArrayLike,
    resolution: float,
    *,
    known: ArrayLike | None = None,
    truth_free: ArrayLike | None = None,
    tolerance: float = 1.0,
) -> MapScore:
    """Score occupied cell centres (n, 2) against truth points (m, 2) on wall faces; all in m, in the truth's frame.

    With `known`, the centres of all cells known to the map (k, 2), and `truth_free`, points (f, 2) of the space that
    robots could see, coverage is the share of the latter within a cell's half diagonal of the former.
    """
    cells, faces = _points(occupied, "occupied"), _points(truth, "truth")
    if not len(faces):
        raise UsageError("no truth points to score a map against")
    if not resolution > 0:
        raise UsageError(f"a resolution of {resolution} m is none")
    reach = tolerance * resolution
    precision, recall = _share_near(cells, faces, reach), _share_near(faces, cells, reach)
    union = precision + recall - precision * recall
    iou = precision * recall / union if union > 0 else 0.0
    coverage = recall
    if known is not None and truth_free is not None:
        half_diagonal = resolution / np.sqrt(2)
        coverage = _share_near(_points(truth_free, "truth_free"), _points(known, "known"), half_diagonal)
    return MapScore(iou, precision, recall, coverage, len(cells), len(faces))


def score_occupancy(
    occupancy: NDArray[np.int8],
    resolution: float,
    truth: ArrayLike,
    *,
    origin: PoseTuple = (0.0, 0.0, 0.0),
    pose: ArrayLike = (0.0, 0.0, 0.0),
    truth_free: ArrayLike | None = None,
    tolerance: float = 1.0,
) -> MapScore:
    """`score_map` of an occupancy map (height, width) of -1, 0..100; `origin` and `pose` as in `cell_centres`."""
    cells = np.asarray(occupancy)
    occupied, known = (cell_centres(mask, resolution, origin, pose) for mask in (cells >= OCCUPIED_FROM, cells >= 0))
    return score_map(occupied, truth, resolution, known=known, truth_free=truth_free, tolerance=tolerance)


def cell_centres(
    mask: NDArray[np.bool_],
    resolution: float,
    origin: PoseTuple = (0.0, 0.0, 0.0),
    pose: ArrayLike = (0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    """Centres (n, 2) in m of the true cells of `mask` (height, width), row 0 the lowest y.

    `origin` is the pose of the lower left corner of cell [0, 0] in the map frame, `pose` that of the map frame in
    the frame wanted (what `fit_all` returns).
    """
    rows, columns = np.nonzero(mask)
    return apply(pose, apply(origin, np.column_stack([columns + 0.5, rows + 0.5]) * resolution))


def wall_thickness(occupancy: NDArray[np.int8]) -> float:
    """Mean thickness of walls in cells, of an occupancy map (height, width); NaN without a wall.

    A wall cell's thickness is the shortest straight run of wall cells through it along x, y and both diagonals, where
    a diagonal step counts sqrt(2). Walls at other angles come out at most 8 % too thick, ends a little too thin.
    """
    y, x = np.nonzero(np.asarray(occupancy) >= OCCUPIED_FROM)
    if not len(x):
        return float("nan")
    diagonal = np.sqrt(2)
    runs = (_runs(y, x), _runs(x, y), diagonal * _runs(x - y, y), diagonal * _runs(x + y, y))
    return float(np.minimum.reduce(runs).mean())


def _runs(line: NDArray[np.intp], place: NDArray[np.intp]) -> NDArray[np.intp]:
    """For each cell at a `place` on a `line`, how many cells of that line adjoin without a gap, itself included."""
    order = np.lexsort((place, line))
    starts = np.flatnonzero(
        (np.diff(line[order], prepend=line[order][0] - 1) != 0) | (np.diff(place[order], prepend=-2) != 1)
    )
    lengths = np.diff(starts, append=len(order))
    out = np.empty(len(order), np.intp)
    out[order] = np.repeat(lengths, lengths)
    return out


def _points(points: ArrayLike, what: str) -> NDArray[np.float64]:
    table = np.asarray(points, np.float64).reshape(-1, 2)
    if not np.isfinite(table).all():
        raise UsageError(f"{what} holds points that are not finite")
    return table


def _share_near(points: NDArray[np.float64], others: NDArray[np.float64], reach: float) -> float:
    """Share of the points that have one of the others within reach; 0 where there are none of either."""
    if not len(points) or not len(others):
        return 0.0
    distance, _ = cKDTree(others).query(points, distance_upper_bound=reach + 2 * SLACK)
    return float((distance <= reach + SLACK).mean())
