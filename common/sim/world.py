"""A world is what lasers see: wall segments in one fixed frame, metres.

Walls are the *faces* of solid things, so a wall with thickness is a closed polygon of four segments. Things may
overlap or touch: a laser outside of all of them sees the outermost face first.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import ConfigError, UsageError

if TYPE_CHECKING:
    from common.sim.index import SegmentIndex

Segments = NDArray[np.float64]
"""(n, 4): x0, y0, x1, y1 in metres"""
Point = tuple[float, float]


@dataclass(frozen=True)
class World:
    """Wall segments; never changed once made."""

    segments: Segments

    def __post_init__(self) -> None:
        if self.segments.ndim != 2 or self.segments.shape[1] != 4 or len(self.segments) == 0:
            raise ConfigError(f"a world needs segments (n, 4) with n > 0, got {self.segments.shape}")
        if not np.isfinite(self.segments).all():
            raise ConfigError("a world's segments must be finite metres")
        self.segments.setflags(write=False)

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) around all walls, metres."""
        low = np.minimum(self.segments[:, :2], self.segments[:, 2:]).min(axis=0)
        high = np.maximum(self.segments[:, :2], self.segments[:, 2:]).max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @cached_property
    def index(self) -> SegmentIndex:
        """The segments sorted into a uniform grid, for casting rays. Raises UsageError where numba is missing."""
        try:
            from common.sim.index import SegmentIndex
        except ModuleNotFoundError as error:
            raise UsageError(f"the simulator needs {error.name}; install it: pip install 'recslam[edge]'") from error
        return SegmentIndex.of(self.segments)

    def clearance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Distance (n,) in metres from each of the points (n, 2) to the nearest wall."""
        points = np.asarray(points, dtype=np.float64)
        start, along = self.segments[:, :2], self.segments[:, 2:] - self.segments[:, :2]
        square = np.maximum((along**2).sum(axis=1), 1e-12)
        out = np.empty(len(points))
        for first in range(0, len(points), 256):  # bounds the temporaries in big worlds
            offset = points[first : first + 256, None, :] - start
            share = np.clip((offset * along).sum(axis=2) / square, 0.0, 1.0)
            distance = np.hypot(*np.moveaxis(offset - share[:, :, None] * along, 2, 0))
            out[first : first + 256] = distance.min(axis=1)
        return out


class Plan:
    """Collects the things that a world is built of."""

    def __init__(self) -> None:
        self._faces: list[Segments] = []

    def polygon(self, corners: Iterable[Point]) -> None:
        """A closed outline through these corners."""
        points = np.array(list(corners), dtype=np.float64)
        self._faces.append(np.hstack([points, np.roll(points, -1, axis=0)]))

    def box(self, x: float, y: float, width: float, height: float, turn: float = 0.0) -> None:
        """A rectangle with its lower left corner at (x, y), turned by `turn` rad about its centre."""
        centre = np.array([x + width / 2, y + height / 2])
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width, height]) / 2
        c, s = np.cos(turn), np.sin(turn)
        self.polygon([(float(p[0]), float(p[1])) for p in centre + corners @ np.array([[c, s], [-s, c]])])

    def column(self, x: float, y: float, radius: float, corners: int = 12) -> None:
        """A round thing about (x, y), as a regular polygon of the same radius."""
        angles = 2 * np.pi * np.arange(corners) / corners
        self.polygon([(x + radius * float(np.cos(a)), y + radius * float(np.sin(a))) for a in angles])

    def wall(self, start: Point, end: Point, doors: Sequence[Point] = (), thickness: float = 0.12) -> None:
        """A straight wall between two points, square-ended past them by half its thickness.

        `doors` are the openings: distances (from, to) in metres from `start` along the wall.
        """
        origin, along = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64) - np.array(start)
        length = float(np.hypot(*along))
        along, aside = along / length, np.array([-along[1], along[0]]) / length * thickness / 2
        cuts = [-thickness / 2, *(cut for door in sorted(doors) for cut in door), length + thickness / 2]
        for low, high in zip(cuts[::2], cuts[1::2], strict=True):
            if high - low > 1e-6:
                a, b = origin + low * along, origin + high * along
                self.polygon([(float(p[0]), float(p[1])) for p in (a - aside, b - aside, b + aside, a + aside)])

    def room(self, x0: float, y0: float, x1: float, y1: float, thickness: float = 0.15) -> None:
        """Four walls around a rectangle (their middle lines), without doors."""
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            self.wall(start, end, thickness=thickness)

    def world(self) -> World:
        return World(np.vstack(self._faces))
