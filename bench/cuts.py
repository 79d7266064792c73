"""Pairs of maps cut from one real log: two stretches of the drive, different scans, hidden start frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.formats.carmen import CarmenLog
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import shared_area
from common.geometry import between, compose
from common.grid import Grid
from services.edge_worker.slam.raycast import Canvas

RESOLUTION_M = 0.05
MAX_RANGE_M = 15.0
BUILDINGS = {
    "intel": ("logs/intel.raw.log.gz", "reference/intel.ref.txt.gz"),
    "aces": ("logs/aces.raw.log.gz", "reference/aces.ref.txt.gz"),
    "csail": ("logs/mit-csail.clf.gz", "reference/csail.ref.txt.gz"),
}


class Scans(NamedTuple):
    """Laser scans with corrected poses of the laser."""

    poses: NDArray[np.float64]
    """(n, 3)"""
    ranges: NDArray[np.float64]
    """(n, beams) m"""
    angles: NDArray[np.float64]
    """(beams,) rad"""


@dataclass(frozen=True)
class Cut:
    """Two maps and the truth about them."""

    a: MatchMap
    b: MatchMap
    truth: NDArray[np.float64]
    """pose of b's frame in a's"""
    overlap: float
    """share of the smaller map's known area that the other knows"""


def load_scans(data: Path, building: str) -> Scans:
    """All scans of the building's log whose stamp has a reference pose."""
    log, reference = (data / name for name in BUILDINGS[building])
    rows = np.loadtxt(reference)
    sweeps = {round(sweep.stamp, 4): sweep for sweep in CarmenLog(log, "FLASER")}
    found = [(row[1:4], sweeps[round(row[0], 4)]) for row in rows if round(row[0], 4) in sweeps]
    geometry = found[0][1].geometry
    ranges = np.array([sweep.ranges for _, sweep in found], np.float64)
    angles = geometry.angle_min + geometry.angle_increment * np.arange(ranges.shape[1])
    return Scans(np.array([pose for pose, _ in found]), ranges, angles)


def draw_map(scans: Scans, chosen: NDArray[np.int64], frame: NDArray[np.float64]) -> Grid:
    """The map of the chosen scans in a frame whose pose in the reference's is `frame`."""
    canvas, grid = Canvas(RESOLUTION_M), Grid(RESOLUTION_M)
    rays = np.stack([np.cos(scans.angles), np.sin(scans.angles)], axis=1)
    for pose, ranges in zip(between(frame, scans.poses[chosen]), scans.ranges[chosen], strict=True):
        seen = (ranges > 0.1) & (ranges < MAX_RANGE_M)
        canvas.draw(pose, rays[seen] * ranges[seen, None], np.zeros(2))
    canvas.publish(grid)
    return grid


def cuts(scans: Scans, rng: np.random.Generator) -> Iterator[Cut]:
    """Random pairs without end: one map of even scans, one of odd ones, each a stretch of the drive."""
    n = len(scans.poses)
    while True:
        maps = []
        for parity in (0, 1):
            length = int(rng.uniform(0.06, 0.45) * n)
            first = int(rng.integers(0, n - length))
            chosen = np.arange(first + (first + parity) % 2, first + length, 2)
            shift = rng.uniform(-20, 20, 2)
            frame = np.array([*(scans.poses[chosen[0], :2] + shift), rng.uniform(-math.pi, math.pi)])
            maps.append((MatchMap.from_grid(draw_map(scans, chosen, frame)), frame))
        (a, frame_a), (b, frame_b) = maps
        truth = between(frame_a, frame_b)
        shared = shared_area(a, b, truth) / min(a.known_m2, b.known_m2)
        yield Cut(a, b, truth, shared)


def error(estimate: NDArray[np.float64], cut: Cut) -> tuple[float, float]:
    """(m, rad) of an estimate against the truth, seen at the middle of b's map."""
    middle = np.array([*cut.b.walls.points.mean(axis=0), 0.0])
    gap = between(compose(cut.truth, middle), compose(estimate, middle))
    return float(np.hypot(gap[0], gap[1])), abs(float(gap[2]))
