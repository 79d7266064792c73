"""Proposals that need no features: wall orientations give rotations, correlation gives every translation.

For each candidate rotation all translations are scored at once by FFT: walls attract walls, free space repels them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.fusion.walls import ORIENTATION_BINS
from common.geometry.se2 import wrap

SMOOTH_BINS = 2.0
"""blur of the orientation histograms: 1 degree"""

Raster = NDArray[np.float32]


def propose_by_correlation(a: MatchMap, b: MatchMap, settings: FusionSettings) -> NDArray[np.float64]:
    """Poses (n, 3) of b's frame in a's, best correlation first within each rotation."""
    cell = settings.coarse_m
    walls_a, free_a, low_a = rasters(a.walls.points, a.free_points, 0.0, cell)
    spread = cv2.GaussianBlur(walls_a, (0, 0), 0.7)
    diagonal = math.ceil(math.hypot(*np.ptp(b.walls.points, axis=0)) / cell) + 4
    shape = tuple(scipy.fft.next_fast_len(int(n) + diagonal, real=True) for n in walls_a.shape)
    attract = scipy.fft.rfft2(spread - settings.repulsion * free_a, shape)
    repel = scipy.fft.rfft2(-settings.repulsion * spread, shape)
    poses: list[NDArray[np.float64]] = []
    for angle in candidate_rotations(a.histogram, b.histogram, settings.rotations):
        walls_b, free_b, low_b = rasters(b.walls.points, b.free_points, angle, cell)
        spectrum = attract * scipy.fft.rfft2(walls_b, shape).conj() + repel * scipy.fft.rfft2(free_b, shape).conj()
        scores = scipy.fft.irfft2(spectrum, shape)
        for dy, dx in _peaks(scores, settings.peaks):
            shift = np.array([_signed(dx, shape[1], walls_b.shape[1]), _signed(dy, shape[0], walls_b.shape[0])])
            x, y = (low_a - low_b + shift) * cell
            poses.append(np.array([x, y, float(wrap(angle))]))
    return np.array(poses).reshape(-1, 3)


def candidate_rotations(a: NDArray[np.float64], b: NDArray[np.float64], count: int) -> list[float]:
    """Angles (rad) that bring b's wall orientations onto a's, best first, each followed by its opposite."""
    spectrum = np.fft.rfft(_smooth(a)) * np.fft.rfft(_smooth(b)).conj()
    likeness = np.fft.irfft(spectrum, ORIENTATION_BINS)
    before, after = np.roll(likeness, 1), np.roll(likeness, -1)
    tops = np.flatnonzero((likeness >= before) & (likeness > after))
    angles: list[float] = []
    for top in tops[np.argsort(-likeness[tops], kind="stable")][:count]:
        curve = before[top] - 2 * likeness[top] + after[top]
        offset = 0.5 * (before[top] - after[top]) / curve if curve < 0 else 0.0
        angle = float(top + offset) * (math.pi / ORIENTATION_BINS)
        angles += [angle, angle + math.pi]
    return angles


def _smooth(histogram: NDArray[np.float64]) -> NDArray[np.float64]:
    offsets = (np.arange(ORIENTATION_BINS) + ORIENTATION_BINS // 2) % ORIENTATION_BINS - ORIENTATION_BINS // 2
    kernel = np.exp(-0.5 * (offsets / SMOOTH_BINS) ** 2)
    smooth = np.fft.irfft(np.fft.rfft(histogram) * np.fft.rfft(kernel), ORIENTATION_BINS)
    return smooth / max(float(np.linalg.norm(smooth)), 1e-12)


def rasters(
    walls: NDArray[np.float64], free: NDArray[np.float64], angle: float, cell: float
) -> tuple[Raster, Raster, NDArray[np.int64]]:
    """Wall and free raster (h, w) of 0 and 1 around walls turned by `angle`, and the cell (x, y) of their [0, 0].

    A cell is free when a free point falls in it and no wall in it or next to it: a small error must not repel.
    """
    c, s = math.cos(angle), math.sin(angle)
    cells = np.floor(walls @ np.array([[c, s], [-s, c]]) / cell).astype(np.int64)
    low = cells.min(axis=0) - 1
    width, height = cells.max(axis=0) + 2 - low
    wall = np.zeros((height, width), np.float32)
    wall[cells[:, 1] - low[1], cells[:, 0] - low[0]] = 1
    open_ = np.zeros_like(wall)
    _mark(open_, free, c / cell, s / cell, low)
    open_[cv2.dilate(wall, np.ones((3, 3), np.uint8)) > 0] = 0
    return wall, open_, low


@njit(cache=True)
def _mark(raster: Raster, points: NDArray[np.float64], c: float, s: float, low: NDArray[np.int64]) -> None:
    """Set the cells that the turned and scaled points (n, 2) fall in."""
    for k in range(len(points)):
        x = math.floor(c * points[k, 0] - s * points[k, 1]) - low[0]
        y = math.floor(s * points[k, 0] + c * points[k, 1]) - low[1]
        if 0 <= x < raster.shape[1] and 0 <= y < raster.shape[0]:
            raster[y, x] = 1.0


def _peaks(scores: NDArray[np.float32], count: int) -> Iterator[tuple[int, int]]:
    """(row, column) of the highest local maxima, highest first, ties by place."""
    top = scores >= cv2.dilate(scores, np.ones((5, 5), np.uint8), borderType=cv2.BORDER_REPLICATE)
    places = np.flatnonzero(top & (scores > 0))
    order = np.lexsort((places, -scores.ravel()[places]))[:count]
    for place in places[order]:
        row, column = divmod(int(place), scores.shape[1])
        yield row, column


def _signed(shift: int, period: int, size: int) -> int:
    """A cyclic shift as the signed one: b may hang out of a's lower end by at most its own size."""
    return shift if shift < period - size else shift - period
