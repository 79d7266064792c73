"""Worlds from pictures: map_server maps, and bitmaps whose size in metres is told.

Faces run along the borders between occupied cells and all others, merged into the longest straight segments.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import BadFile
from common.formats.map_image import read_channels
from common.formats.map_server import FREE_UP_TO, OCCUPIED_FROM, Metadata, read_map
from common.geometry import apply, inverse
from common.sim.free import FreeSpace
from common.sim.world import Point, Segments, World
from common.wire.base import PoseTuple

Mask = NDArray[np.bool_]

CLEARANCE = 0.35
"""m, what the place that counts as inside keeps off walls"""
SPECKS = 3
"""occupied areas of fewer cells are taken for noise of the mapping"""


def load_map(path: Path) -> tuple[World, Point]:
    """The world of a map_server yaml, and a place in its biggest free space. Raises BadFile naming the file.

    Unknown cells are no walls, but no free space either. Where the image that the yaml names is missing, as after a
    renaming, a .pgm or .pgm.gz named like the yaml is taken.
    """
    alike = [path.with_suffix(suffix) for suffix in (".pgm", ".pgm.gz")]
    renamed = next((image for image in alike if image.exists()), None)
    saved = read_map(path, None if Metadata(path).image().exists() else renamed)
    cells = saved.occupancy
    free = (cells >= 0) & (cells <= FREE_UP_TO)
    return _world_of(cells >= OCCUPIED_FROM, free, saved.resolution, saved.origin, path)


def load_bitmap(path: Path, width_m: float, dark_below: float = 0.5, border: bool = False) -> tuple[World, Point]:
    """The world of a picture `width_m` metres wide, lower left corner at (0, 0), and a place in its free space.

    Pixels darker than `dark_below` (0 black, 1 white) are walls; `border` walls the picture's edge in, for pictures
    of places that go on beyond it. Raises BadFile naming the file.
    """
    walls = read_channels(path)[::-1, :, :3].mean(axis=2) < dark_below
    if border:
        walls[[0, -1], :] = walls[:, [0, -1]] = True
    return _world_of(walls, ~walls, width_m / walls.shape[1], (0.0, 0.0, 0.0), path)


def _world_of(walls: Mask, free: Mask, resolution: float, origin: PoseTuple, path: Path) -> tuple[World, Point]:
    """World and inner place of cells whose row 0 is the lowest; `origin` is the pose of their lower left corner."""
    walls = without_specks(walls)
    if not walls.any():
        raise BadFile(f"{path}: holds no wall")
    faces = boundary(walls) * resolution
    world = World(np.hstack([apply(origin, faces[:, :2]), apply(origin, faces[:, 2:])]))
    return world, _inner_place(world, free, resolution, origin, path)


def boundary(walls: Mask) -> Segments:
    """Borders (n, 4) of a mask [y, x] in cells, lower left corner at (0, 0), collinear neighbours merged."""
    padded = np.pad(walls, 1).astype(np.int8)
    lying = [(x0, y, x1, y) for y, x0, x1 in _runs(np.diff(padded, axis=0)[:, 1:-1])]
    standing = [(x, y0, x, y1) for x, y0, y1 in _runs(np.diff(padded, axis=1)[1:-1].T)]
    return np.array(lying + standing, dtype=np.float64).reshape(-1, 4)


def _runs(steps: NDArray[np.int8]) -> list[tuple[int, int, int]]:
    """(line, from, to) of all stretches of equal non-zero steps along the lines (rows) of an array."""
    edged = np.pad(steps, ((0, 0), (1, 1)))
    out = []
    for line, row in enumerate(edged):
        cuts = np.flatnonzero(np.diff(row))
        out += [(line, int(a), int(b)) for a, b in pairwise(cuts) if row[a + 1]]
    return out


def without_specks(walls: Mask) -> Mask:
    """The mask without areas of fewer than `SPECKS` cells."""
    import cv2

    _, labels, stats, _ = cv2.connectedComponentsWithStats(walls.astype(np.uint8), connectivity=8)
    return np.asarray(walls & (stats[labels, cv2.CC_STAT_AREA] >= SPECKS))


def _inner_place(world: World, free: Mask, resolution: float, origin: PoseTuple, path: Path) -> Point:
    """A place in the biggest connected space that the picture calls free and that keeps off the walls."""
    import cv2

    space = FreeSpace.of(world, CLEARANCE)
    clear = np.flatnonzero(space.free)
    columns, rows = np.floor(apply(inverse(origin), space.centres(clear)) / resolution).astype(int).T
    inside = (columns >= 0) & (rows >= 0) & (rows < free.shape[0]) & (columns < free.shape[1])
    clear, columns, rows = clear[inside], columns[inside], rows[inside]
    known = np.zeros(space.free.shape, np.uint8)
    known.ravel()[clear] = free[rows, columns]
    _, labels, stats, _ = cv2.connectedComponentsWithStats(known, connectivity=4)
    if len(stats) < 2:
        raise BadFile(f"{path}: leaves no free space for a robot")
    biggest = int(stats[1:, cv2.CC_STAT_AREA].argmax()) + 1
    x, y = space.centres(np.flatnonzero(labels == biggest)[:1])[0]
    return float(x), float(y)
