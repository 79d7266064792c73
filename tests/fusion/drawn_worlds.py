"""Small drawn worlds, and what a robot would map of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.fusion.matchmap import MatchMap
from common.geometry import compose, inverse
from common.grid import Grid
from common.grid.render import render

RESOLUTION = 0.05
Counts = NDArray[np.uint16]


def blank(width_m: float, height_m: float) -> Counts:
    """Free space with an outer wall and a border of unknown."""
    h, w = round(height_m / RESOLUTION), round(width_m / RESOLUTION)
    counts = np.zeros((2, h + 20, w + 20), np.uint16)
    counts[1, 10 : h + 10, 10 : w + 10] = 20
    for wall in (np.s_[10, 10 : w + 10], np.s_[h + 9, 10 : w + 10], np.s_[10 : h + 10, 10], np.s_[10 : h + 10, w + 9]):
        counts[0][wall] = 20
    return counts


def wall(counts: Counts, x0: float, y0: float, x1: float, y1: float) -> None:
    """A straight wall, metres from the lower left corner of the room."""
    n = int(2 * max(abs(x1 - x0), abs(y1 - y0)) / RESOLUTION) + 1
    columns = np.round(np.linspace(x0, x1, n) / RESOLUTION).astype(int) + 10
    rows = np.round(np.linspace(y0, y1, n) / RESOLUTION).astype(int) + 10
    counts[0, rows, columns] = counts[1, rows, columns]


def apartment(seed: int, width_m: float = 16.0, height_m: float = 12.0) -> Counts:
    """Rooms off a corridor, doors and furniture where the seed puts them."""
    rng = np.random.default_rng(seed)
    counts = blank(width_m, height_m)
    low, high = height_m * rng.uniform(0.3, 0.4), height_m * rng.uniform(0.5, 0.62)
    for side, y in ((0.0, low), (height_m, high)):
        x = 0.0
        while x < width_m - 2:
            width = rng.uniform(2.2, 4.5)
            door = rng.uniform(0.3, max(0.4, width - 1.2))
            wall(counts, x, y, x + door, y)
            wall(counts, min(x + door + 0.9, width_m), y, min(x + width, width_m), y)
            wall(counts, min(x + width, width_m), min(side, y), min(x + width, width_m), max(side, y))
            x += width
    for _ in range(14):
        x, y = rng.uniform(0.5, width_m - 2), rng.uniform(0.5, height_m - 2)
        dx, dy = rng.uniform(0.3, 1.3, 2)
        for ends in ((x, y, x + dx, y), (x, y + dy, x + dx, y + dy), (x, y, x, y + dy), (x + dx, y, x + dx, y + dy)):
            wall(counts, *ends)
    return counts


def symmetric_hall() -> Counts:
    """A building that looks the same when turned by half."""
    counts = blank(14, 10)
    for ends in ((3, 0, 3, 4), (3, 4, 6, 4), (9, 0, 9, 2), (0, 7, 2, 7)):
        wall(counts, *ends)
        wall(counts, 13.95 - ends[0], 9.95 - ends[1], 13.95 - ends[2], 9.95 - ends[3])
    return counts


def row_of_rooms() -> Counts:
    """Six equal rooms of 3.5 m along a corridor, a bed in each."""
    counts = blank(21, 6)
    for x in np.arange(0, 21, 3.5):
        for ends in ((0, 0, 0, 3.5), (0, 3.5, 1.2, 3.5), (2.2, 3.5, 3.5, 3.5), (0.4, 0.9, 2, 0.9), (2, 0, 2, 0.9)):
            wall(counts, x + ends[0], ends[1], x + ends[2], ends[3])
    return counts


def seen(counts: Counts, frame: ArrayLike, window_m: tuple[float, float] | None = None, seed: int = 0) -> Grid:
    """The counts of a robot whose map frame has the pose `frame` in the world: between two x, with ragged walls."""
    rng = np.random.default_rng(seed)
    known = counts.copy()
    if window_m is not None:
        x0, x1 = (round(x / RESOLUTION) + 10 for x in window_m)
        known[:, :, :x0] = 0
        known[:, :, x1:] = 0
    missed = (known[0] > 0) & (rng.random(known[0].shape) < 0.1)
    known[0][missed] = 0
    return render(Grid.from_dense(known, (-10, -10), RESOLUTION), inverse(frame), RESOLUTION)


def mapped(counts: Counts, frame: ArrayLike, window_m: tuple[float, float] | None = None, seed: int = 0) -> MatchMap:
    """`seen`, prepared for matching."""
    return MatchMap.from_grid(seen(counts, frame, window_m, seed))


def moved(pose: ArrayLike, by: ArrayLike) -> NDArray[np.float64]:
    """A pose moved by a step in its own frame."""
    return compose(pose, by)
