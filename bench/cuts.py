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
from common.geometry import apply, between, compose
from common.grid import Grid
from common.grid.grid import UNKNOWN
from services.edge_worker.slam.raycast import Canvas

RESOLUTION_M = 0.05
MAX_RANGE_M = 15.0
COARSE_M = 0.4
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
    rays: NDArray[np.float64]
    """(beams, 2) unit vectors in the laser's frame"""


@dataclass(frozen=True)
class Cut:
    """Two maps and the truth about them."""

    a: MatchMap
    b: MatchMap
    truth: NDArray[np.float64]
    """pose of b's frame in a's"""
    overlap: float
    """share of the smaller map's known area that the other knows"""
    woven: bool
    """both robots drove at one time (even and odd scans of overlapping stretches); else at different times"""


def load_scans(data: Path, building: str) -> Scans:
    """All scans of the building's log whose stamp has a reference pose."""
    log, reference = (data / name for name in BUILDINGS[building])
    rows = np.loadtxt(reference)
    sweeps = {round(sweep.stamp, 4): sweep for sweep in CarmenLog(log, "FLASER")}
    found = [(row[1:4], sweeps[round(row[0], 4)]) for row in rows if round(row[0], 4) in sweeps]
    geometry = found[0][1].geometry
    ranges = np.array([sweep.ranges for _, sweep in found], np.float64)
    angles = geometry.angle_min + geometry.angle_increment * np.arange(ranges.shape[1])
    return Scans(np.array([pose for pose, _ in found]), ranges, np.stack([np.cos(angles), np.sin(angles)], axis=1))


def draw_map(scans: Scans, chosen: NDArray[np.int64], frame: NDArray[np.float64]) -> Grid:
    """The map of the chosen scans in a frame whose pose in the reference's is `frame`."""
    canvas, grid = Canvas(RESOLUTION_M), Grid(RESOLUTION_M)
    for pose, ranges in zip(between(frame, scans.poses[chosen]), scans.ranges[chosen], strict=True):
        seen = (ranges > 0.1) & (ranges < MAX_RANGE_M)
        canvas.draw(pose, scans.rays[seen] * ranges[seen, None], np.zeros(2))
    canvas.publish(grid)
    return grid


def cuts(scans: Scans, rng: np.random.Generator, overlap: tuple[float, float], count: int) -> Iterator[Cut]:
    """`count` random pairs whose overlap lies in the given range; two of three from different times."""
    prints, n = _footprints(scans), len(scans.poses)
    for k in range(count):
        woven = k % 3 == 0
        while True:
            lengths = (rng.uniform(0.06, 0.4, 2) * n).astype(int)
            starts = rng.integers(0, n - lengths)
            ends = starts + lengths
            if not woven and starts.max() < ends.min():
                continue
            first, step = (np.array([0, 1]), 2) if woven else (np.zeros(2, int), 1)
            a, b = (np.arange(starts[i] + first[i], ends[i], step) for i in (0, 1))
            known = [prints[chosen].any(axis=0) for chosen in (a, b)]
            rough = (known[0] & known[1]).sum() / min(known[0].sum(), known[1].sum())
            if not overlap[0] - 0.05 <= rough <= overlap[1] + 0.05:
                continue
            cut = _cut(scans, a, b, rng, woven)
            if overlap[0] <= cut.overlap <= overlap[1]:
                yield cut
                break


def error(estimate: NDArray[np.float64], cut: Cut) -> tuple[float, float]:
    """(m, rad) of an estimate against the truth, seen at the middle of what both maps know."""
    points = cut.b.free_points
    cells = np.floor((apply(cut.truth, points) - cut.a.origin) / cut.a.resolution).astype(int)
    inside = ((cells >= 0) & (cells < cut.a.occupancy.shape[::-1])).all(axis=1)
    inside[inside] = cut.a.occupancy[cells[inside, 1], cells[inside, 0]] != UNKNOWN
    middle = np.array([*points[inside if inside.any() else slice(None)].mean(axis=0), 0.0])
    gap = between(compose(cut.truth, middle), compose(estimate, middle))
    return float(np.hypot(gap[0], gap[1])), abs(float(gap[2]))


def _cut(scans: Scans, a: NDArray[np.int64], b: NDArray[np.int64], rng: np.random.Generator, woven: bool) -> Cut:
    """Maps of the scans `a` and `b`, each in a hidden frame of its own."""
    maps, frames = [], []
    for chosen in (a, b):
        frame = np.array([*(scans.poses[chosen[0], :2] + rng.uniform(-20, 20, 2)), rng.uniform(-math.pi, math.pi)])
        maps.append(MatchMap.from_grid(draw_map(scans, chosen, frame)))
        frames.append(frame)
    truth = between(frames[0], frames[1])
    smaller = min(map_.known_m2 for map_ in maps)
    return Cut(maps[0], maps[1], truth, shared_area(maps[0], maps[1], truth) / smaller, woven)


def _footprints(scans: Scans) -> NDArray[np.bool_]:
    """(n, cells) which coarse cells each scan sees, to find stretches of a wanted overlap without drawing them."""
    low = scans.poses[:, :2].min(axis=0) - MAX_RANGE_M
    width, height = np.ceil((scans.poses[:, :2].max(axis=0) + MAX_RANGE_M - low) / COARSE_M).astype(int)
    prints = np.zeros((len(scans.poses), height, width), np.bool_)
    steps = np.arange(0, MAX_RANGE_M, COARSE_M)
    for k, (pose, ranges) in enumerate(zip(scans.poses, scans.ranges, strict=True)):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        directions = scans.rays @ np.array([[c, s], [-s, c]])
        along = (steps[None, :] <= ranges[:, None]) & (ranges[:, None] < MAX_RANGE_M)
        beam, step = np.nonzero(along)
        x, y = np.floor((pose[:2] + directions[beam] * steps[step, None] - low) / COARSE_M).astype(int).T
        prints[k, y, x] = True
    return prints.reshape(len(prints), -1)
