"""Worlds from pictures: map_server yaml + pgm(.gz), and bitmaps whose size in metres is told.

Faces run along the borders between occupied cells and all others, merged into the longest straight segments.
"""

from __future__ import annotations

import gzip
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import BadFile
from common.sim.free import FreeSpace
from common.sim.world import Point, Segments, World

ROOM = 0.35
"""m, clearance of the place that counts as inside"""
SPECKS = 3
"""occupied areas of fewer cells are taken for noise of the mapping"""


def load_map(path: Path) -> tuple[World, Point]:
    """The world of a map_server yaml, and a place in its biggest free space. Raises BadFile naming the file.

    Cells count as walls when they are occupied by the yaml's own thresholds; unknown cells do not.
    """
    keys = _read_yaml(path)
    try:
        resolution = float(keys["resolution"])
        origin = [float(part) for part in keys["origin"].strip("[] ").split(",")]
        occupied, negate = float(keys["occupied_thresh"]), int(keys.get("negate", "0"))
    except (KeyError, ValueError) as error:
        raise BadFile(f"{path}: is no map_server yaml, it lacks or misstates {error}") from None
    shades = _read_image(_image_beside(path, keys.get("image", "")))
    darkness = shades / 255.0 if negate else 1.0 - shades / 255.0
    free_below = float(keys.get("free_thresh", "0.196"))
    return _world_of(darkness > occupied, darkness < free_below, resolution, (origin[0], origin[1]), path)


def load_bitmap(path: Path, width_m: float, dark_below: int = 128) -> tuple[World, Point]:
    """The world of a picture `width_m` metres wide, lower left corner at (0, 0), and a place in its free space.

    Pixels darker than `dark_below` of 255 are walls. Raises BadFile naming the file.
    """
    shades = _read_image(path)
    walls = shades < dark_below
    return _world_of(walls, ~walls, width_m / walls.shape[1], (0.0, 0.0), path)


def _world_of(
    walls: NDArray[np.bool_], free: NDArray[np.bool_], resolution: float, origin: Point, path: Path
) -> tuple[World, Point]:
    """World and inner place of a picture whose row 0 is its top."""
    walls, free = _without_specks(walls[::-1]), free[::-1]
    if not walls.any():
        raise BadFile(f"{path}: holds no wall")
    world = World(boundary(walls) * resolution + np.tile(origin, 2))
    return world, _inner_place(world, free, resolution, np.array(origin), path)


def boundary(walls: NDArray[np.bool_]) -> Segments:
    """Borders (n, 4) of a mask [y, x] in cells, lower left corner at (0, 0), collinear neighbours merged."""
    padded = np.pad(walls, 1).astype(np.int8)
    out = [(x0, y, x1, y) for y, x0, x1 in _runs(np.diff(padded, axis=0)[:, 1:-1])]
    out += [(x, y0, x, y1) for x, y0, y1 in _runs(np.diff(padded, axis=1)[1:-1].T)]
    return np.array(out, dtype=np.float64)


def _runs(steps: NDArray[np.int8]) -> list[tuple[int, int, int]]:
    """(line, from, to) of all stretches of equal non-zero steps along the lines (rows) of an array."""
    edged = np.pad(steps, ((0, 0), (1, 1)))
    changed = np.diff(edged, axis=1) != 0
    out = []
    for line, row in enumerate(changed):
        cuts = np.flatnonzero(row)
        out += [(line, int(a), int(b)) for a, b in pairwise(cuts) if edged[line, a + 1]]
    return out


def _without_specks(walls: NDArray[np.bool_]) -> NDArray[np.bool_]:
    import cv2

    _, labels, stats, _ = cv2.connectedComponentsWithStats(walls.astype(np.uint8), connectivity=8)
    return np.asarray(walls & (stats[labels, cv2.CC_STAT_AREA] >= SPECKS))


def _inner_place(
    world: World, free: NDArray[np.bool_], resolution: float, origin: NDArray[np.float64], path: Path
) -> Point:
    """A place in the biggest connected space that the picture calls free and that keeps off the walls."""
    import cv2

    space = FreeSpace.of(world, ROOM)
    centres = space.centres(np.flatnonzero(space.free))
    columns, rows = np.floor((centres - origin) / resolution).astype(int).T
    known = np.zeros(space.free.shape, np.uint8)
    inside = (columns >= 0) & (rows >= 0) & (rows < free.shape[0]) & (columns < free.shape[1])
    known.ravel()[np.flatnonzero(space.free)[inside]] = free[rows[inside], columns[inside]]
    _, labels, stats, _ = cv2.connectedComponentsWithStats(known, connectivity=4)
    if len(stats) < 2:
        raise BadFile(f"{path}: leaves no free space for a robot")
    biggest = int(stats[1:, cv2.CC_STAT_AREA].argmax()) + 1
    x, y = space.centres(np.flatnonzero(labels == biggest)[:1])[0]
    return float(x), float(y)


def _read_yaml(path: Path) -> dict[str, str]:
    """The flat `key: value` lines of a map_server yaml."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadFile(f"{path}: {error}") from None
    pairs = (line.split("#")[0].partition(":") for line in lines)
    return {key.strip(): value.strip() for key, colon, value in pairs if colon}


def _image_beside(path: Path, named: str) -> Path:
    """The picture that a yaml names or, where that one is missing, one named like the yaml itself."""
    stems = [named, f"{named}.gz", f"{path.stem}.pgm", f"{path.stem}.pgm.gz", f"{path.stem}.png"]
    for name in stems:
        if (found := path.parent / name).is_file():
            return found
    raise BadFile(f"{path}: its image {named!r} is not there")


def _read_image(path: Path) -> NDArray[np.uint8]:
    """Grey values [row from the top, column]. Raises BadFile."""
    import cv2

    try:
        data = path.read_bytes()
        data = gzip.decompress(data) if path.suffix == ".gz" else data
    except (OSError, EOFError) as error:
        raise BadFile(f"{path}: {error}") from None
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if image is None:
        raise BadFile(f"{path}: is no picture that can be read")
    return np.asarray(image, dtype=np.uint8)
