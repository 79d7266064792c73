"""The overlap matrix from coarse footprints: w(u, v) = |A∩B| / (|A|+|B|), the paper's overlapping degree, 0 to 0.5.

A footprint is the set of lattice cells of CELL_M metres that a robot map covers (or will, by its route or its start
pose and sensor range), in a named frame. Footprints in different frames cannot be compared: their pair is unknown,
weight 0.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from common.errors import UsageError
from services.scheduler.graph import Weights, quantise

CELL_M = 1.0
_HALF = 2**30
_ROW = 2**32

Cells = NDArray[np.int64]
"""sorted distinct cell ids"""
Source = Literal["unknown", "start", "route", "map"]
SOURCES: tuple[Source, ...] = ("unknown", "start", "route", "map")
"""where an overlap comes from, from the weakest evidence to the strongest"""


def cells_of_points(points: ArrayLike) -> Cells:
    """Cells that hold any of the (n, 2) points in metres; non-finite points are passed over."""
    xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    index = np.floor(xy[np.isfinite(xy).all(axis=1)] / CELL_M)
    if (np.abs(index) >= _HALF).any():
        raise UsageError("footprint: a point lies more than 10^9 m from the origin; check the units, metres are meant")
    lattice = index.astype(np.int64) + _HALF
    return np.unique(lattice[:, 0] * _ROW + lattice[:, 1])


def cells_of_raster(known: NDArray[np.bool_], resolution: float, pose: ArrayLike = (0.0, 0.0, 0.0)) -> Cells:
    """Cells covered by a (rows, columns) raster whose cell [row, column] is centred at
    ((column + 0.5), (row + 0.5)) x `resolution` metres in a frame at `pose` (x m, y m, theta rad) of the common one."""
    row, column = np.nonzero(known)
    x, y, theta = np.asarray(pose, dtype=np.float64)
    local = (np.stack([column, row], axis=1) + 0.5) * resolution
    cosine, sine = np.cos(theta), np.sin(theta)
    return cells_of_points(local @ np.array([[cosine, sine], [-sine, cosine]]) + [x, y])


def cells_of_route(route: ArrayLike, radius: float) -> Cells:
    """Cells whose centre a sensor of `radius` metres comes to see along the (n, 2) route of straight legs."""
    way = np.asarray(route, dtype=np.float64).reshape(-1, 2)
    reach = int(np.ceil(radius / CELL_M)) + 1
    steps = np.arange(-reach, reach + 1) * CELL_M
    disc = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    near = []
    for here in _walk(way):
        centres = (np.floor(here / CELL_M) + 0.5) * CELL_M + disc
        near.append(centres[np.hypot(*(centres - here).T) <= radius])
    return cells_of_points(np.concatenate(near)) if near else np.empty(0, dtype=np.int64)


def _walk(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points along the legs, at most half a cell apart."""
    legs = []
    for begin, end in itertools.pairwise(way):
        count = max(1, int(np.ceil(np.hypot(*(end - begin)) / (CELL_M / 2))))
        legs.append(begin + (end - begin) * (np.arange(count) / count)[:, None])
    return np.concatenate([*legs, way[-1:]])


@dataclass(frozen=True)
class Footprint:
    """What one robot covers."""

    robot: str
    frame: str
    """name of the frame that the cells are in, for example that of the robot's component"""
    cells: Cells
    source: Source = "map"


@dataclass(frozen=True)
class Overlap:
    """The overlap graph with what is known about each entry. Arrays are (V, V), symmetric."""

    robots: tuple[str, ...]
    weights: Weights
    source: NDArray[np.int8]
    """index into SOURCES"""

    def sources(self) -> dict[str, int]:
        """How many pairs were estimated from what."""
        pairs = self.source[np.triu_indices(len(self.robots), 1)]
        return {SOURCES[index]: count for index, count in sorted(Counter(pairs.tolist()).items())}


def lattice_cells(footprints: Sequence[Footprint]) -> tuple[Cells, ...]:
    """The cells of each footprint with frames kept apart, numbered from 0: what `Problem.footprints` takes."""
    frames = sorted({footprint.frame for footprint in footprints})
    numbered: dict[str, tuple[Cells, int]] = {}
    used = 0
    for frame in frames:
        cells = np.unique(np.concatenate([each.cells for each in footprints if each.frame == frame]))
        numbered[frame] = (cells, used)
        used += cells.size
    out = []
    for footprint in footprints:
        cells, first = numbered[footprint.frame]
        out.append(np.searchsorted(cells, footprint.cells).astype(np.int64) + first)
    return tuple(out)


def overlap_matrix(footprints: Sequence[Footprint]) -> Overlap:
    """The overlap of every two robots, in the order of `footprints`.

    A pair's source is that of the weaker footprint; an empty footprint is unknown. Weights are quantised.
    """
    count = len(footprints)
    cells = lattice_cells(footprints)
    sizes = np.array([each.size for each in cells], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    flat = np.concatenate([*cells, np.empty(0, dtype=np.int64)])
    covers = csr_array((np.ones(flat.size), flat, starts), shape=(count, int(flat.max(initial=-1)) + 1))
    shared = (covers @ covers.T).toarray()
    weights = shared / np.maximum(sizes[:, None] + sizes[None, :], 1)
    frames = np.array([footprint.frame for footprint in footprints], dtype=object)
    known = (frames[:, None] == frames[None, :]) & (sizes > 0)[:, None] & (sizes > 0)[None, :]
    ranks = np.array([SOURCES.index(footprint.source) for footprint in footprints], dtype=np.int8)
    source = np.where(known, np.minimum(ranks[:, None], ranks[None, :]), 0).astype(np.int8)
    np.fill_diagonal(weights, 0.0)
    return Overlap(tuple(footprint.robot for footprint in footprints), quantise(weights), source)
