"""Lasers that turn while the robot drives: each beam is cast from where the laser is at the beam's own time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.geometry import compose
from common.sim.track import Track
from common.sim.world import World
from common.sweep import LaserGeometry
from common.wire.base import PoseTuple


@dataclass(frozen=True)
class Lidar:
    """A laser's geometry and how it errs."""

    geometry: LaserGeometry
    beams: int
    rate_hz: float
    sigma: float
    """m, standard deviation of a range at any distance"""
    sigma_share: float
    """m per metre, what grows with the distance"""
    sigma_cap: float
    """m, the most that the standard deviation comes to"""
    drop_out: float
    """share of beams that come back invalid"""

    @property
    def period(self) -> float:
        """s from one sweep to the next"""
        return 1.0 / self.rate_hz

    def angles(self) -> NDArray[np.float64]:
        """Beam directions (n,) in the laser frame, rad."""
        return self.geometry.angle_min + self.geometry.angle_increment * np.arange(self.beams, dtype=np.float64)

    def offsets(self) -> NDArray[np.float64]:
        """Times of the beams (n,) after the first, s."""
        return self.geometry.time_increment * np.arange(self.beams, dtype=np.float64)

    def mounted(self, mount: PoseTuple) -> Lidar:
        """The same laser elsewhere on the robot (pose in the base frame: m, m, rad)."""
        return replace(self, geometry=replace(self.geometry, mount=mount))

    def spoil(self, true: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float32]:
        """What the laser reports for true ranges (n,) in metres: noise, NaN, +inf and -inf as REP-117 has them."""
        noise, lost = rng.normal(size=self.beams), rng.random(size=self.beams) < self.drop_out
        hit = np.isfinite(true)
        spread = np.minimum(np.maximum(self.sigma, self.sigma_share * np.where(hit, true, 0.0)), self.sigma_cap)
        seen = np.where(hit, true + spread * noise, np.inf)
        seen = np.where(seen > self.geometry.range_max, np.inf, seen)
        seen = np.where(seen < self.geometry.range_min, -np.inf, seen)
        return np.where(lost, np.nan, seen).astype(np.float32)


def _turning(range_min: float, range_max: float, rate_hz: float, angle_min: float) -> LaserGeometry:
    """One whole turn of 360 beams, counter-clockwise."""
    return LaserGeometry(angle_min, 2 * np.pi / 360, range_min, range_max, time_increment=1.0 / rate_hz / 360)


LIDARS: dict[str, Lidar] = {
    "lds01": Lidar(_turning(0.12, 3.5, 5.0, 0.0), 360, 5.0, 0.015, 0.01, 0.04, 0.005),
    "rplidar_a1": Lidar(_turning(0.15, 12.0, 5.5, -np.pi), 360, 5.5, 0.005, 0.01, 0.06, 0.01),
    # the mirror turns 75 times a second and looks ahead for half a turn; one sweep in 7.5 is passed on
    "sick": Lidar(LaserGeometry(-np.pi / 2, np.pi / 180, 0.02, 80.0, 1 / 75 / 360), 180, 10.0, 0.01, 0.0, 0.01, 0.002),
    "urg04lx": Lidar(
        LaserGeometry(-2 * np.pi / 3, 2 * np.pi / 1024, 0.06, 5.6, 1 / 10 / 1024), 683, 10.0, 0.01, 0.01, 0.05, 0.01
    ),
    # the mirror turns 40 times a second; one sweep in four is passed on
    "utm30lx": Lidar(
        LaserGeometry(-3 * np.pi / 4, np.pi / 720, 0.1, 30.0, 1 / 40 / 1440), 1081, 10.0, 0.015, 0.002, 0.04, 0.002
    ),
}


def lidar_named(name: str) -> Lidar:
    """A laser of those known. Raises ConfigError naming them."""
    if name not in LIDARS:
        raise ConfigError(f"lidar: nothing is called {name!r}; there are: {', '.join(LIDARS)}")
    return LIDARS[name]


@dataclass(frozen=True)
class Disc:
    """A robot as the others see it."""

    track: Track
    radius: float
    """m"""


def true_ranges(world: World, lidar: Lidar, track: Track, stamp: float, discs: list[Disc]) -> NDArray[np.float64]:
    """Ranges (n,) in metres without error, +inf beyond the laser's reach, of the sweep that begins at `stamp`.

    Discs move meanwhile too. A disc that the laser itself is inside of is not seen.
    """
    times = stamp + lidar.offsets()
    laser = compose(track.turned(times), lidar.geometry.mount)
    angles, limit = laser[:, 2] + lidar.angles(), lidar.geometry.range_max
    ranges = world.index.cast(laser[:, :2], angles, limit)
    for disc in discs:
        centres = disc.track.turned(times)[:, :2]
        ranges = np.minimum(ranges, disc_ranges(laser[:, :2], angles, centres, disc.radius, limit))
    return ranges


def disc_ranges(
    origins: NDArray[np.float64], angles: NDArray[np.float64], centres: NDArray[np.float64], radius: float, limit: float
) -> NDArray[np.float64]:
    """Distance (n,) in metres along each ray to a disc about `centres[i]` (n, 2), +inf when missed or from inside."""
    offset = centres - origins
    ahead = offset[:, 0] * np.cos(angles) + offset[:, 1] * np.sin(angles)
    square = (offset**2).sum(axis=1)
    chord = radius**2 - (square - ahead**2)
    distance = ahead - np.sqrt(np.maximum(chord, 0.0))
    hit = (chord > 0) & (ahead > 0) & (square > radius**2) & (distance < limit)
    return np.where(hit, distance, np.inf)
