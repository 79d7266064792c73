"""Proposals that need no features: wall orientations give rotations, correlation gives every translation.

For each candidate rotation all translations are scored at once by FFT: walls attract walls, free space repels them.
"""

from __future__ import annotations

import math

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
STRETCH = 32
"""scores that are passed over at once when none of them is high enough"""

Raster = NDArray[np.float32]
Spectrum = NDArray[np.complex64]


def propose_by_correlation(a: MatchMap, b: MatchMap, settings: FusionSettings) -> NDArray[np.float64]:
    """Poses (n, 3) of b's frame in a's, best correlation first within each rotation."""
    cell = settings.coarse_m
    walls_a, free_a, low_a = rasters(a.walls.points, a.free_points, 0.0, cell)
    spread = cv2.GaussianBlur(walls_a, (0, 0), 0.7)
    angles = candidate_rotations(a.histogram, b.histogram, settings.rotations)
    turned = [rasters(b.walls.points, b.free_points, angle, cell) for angle in angles]
    sizes = np.array([walls_b.shape for walls_b, _, _ in turned]).max(axis=0) + walls_a.shape - 1
    shape = tuple(scipy.fft.next_fast_len(int(n), real=True) for n in sizes)
    attract = _spectrum(spread - settings.repulsion * free_a, shape)
    repel = _spectrum(-settings.repulsion * spread, shape)
    poses: list[NDArray[np.float64]] = []
    for angle, (walls_b, free_b, low_b) in zip(angles, turned, strict=True):
        size = np.array(walls_b.shape[::-1])
        # turned by another half, b's rasters are the same, read from the far corner: correlation is convolution
        forth, back = (
            scipy.fft.irfft2(product, shape, overwrite_x=True)
            for product in _products(attract, repel, _spectrum(walls_b, shape), _spectrum(free_b, shape))
        )
        for dy, dx in _peaks(forth, settings.peaks):
            shift = np.array([_signed(dx, shape[1], size[0]), _signed(dy, shape[0], size[1])])
            poses.append(np.array([*((low_a - low_b + shift) * cell), float(wrap(angle))]))
        for dy, dx in _peaks(back, settings.peaks):
            shift = np.array([dx, dy]) - (size - 1)
            poses.append(np.array([*((low_a + low_b + size + shift) * cell), float(wrap(angle + math.pi))]))
    return np.array(poses).reshape(-1, 3)


def _spectrum(raster: Raster, shape: tuple[int, ...]) -> Spectrum:
    """The real FFT of a raster filled up with zeros to `shape`, whose empty rows are not transformed."""
    rows = scipy.fft.rfft(raster, shape[1], axis=1)
    return np.asarray(scipy.fft.fft(rows, shape[0], axis=0, overwrite_x=True))


@njit(cache=True)
def _products(attract: Spectrum, repel: Spectrum, walls: Spectrum, free: Spectrum) -> tuple[Spectrum, Spectrum]:
    """attract walls* + repel free*, and the same without the conjugation, in one pass."""
    forth, back = np.empty_like(attract), np.empty_like(attract)
    for y in range(attract.shape[0]):
        for x in range(attract.shape[1]):
            p, q, w, f = attract[y, x], repel[y, x], walls[y, x], free[y, x]
            real = p.real * w.real + q.real * f.real, p.imag * w.imag + q.imag * f.imag
            imaginary = p.imag * w.real + q.imag * f.real, p.real * w.imag + q.real * f.imag
            forth[y, x] = complex(real[0] + real[1], imaginary[0] - imaginary[1])
            back[y, x] = complex(real[0] - real[1], imaginary[0] + imaginary[1])
    return forth, back


def candidate_rotations(a: NDArray[np.float64], b: NDArray[np.float64], count: int) -> list[float]:
    """Angles (rad) that bring b's wall orientations onto a's, best first; their opposites do so as well."""
    spectrum = np.fft.rfft(_smooth(a)) * np.fft.rfft(_smooth(b)).conj()
    likeness = np.fft.irfft(spectrum, ORIENTATION_BINS)
    before, after = np.roll(likeness, 1), np.roll(likeness, -1)
    tops = np.flatnonzero((likeness >= before) & (likeness > after))
    angles: list[float] = []
    for top in tops[np.argsort(-likeness[tops], kind="stable")][:count]:
        curve = before[top] - 2 * likeness[top] + after[top]
        offset = 0.5 * (before[top] - after[top]) / curve if curve < 0 else 0.0
        angles.append(float(top + offset) * (math.pi / ORIENTATION_BINS))
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
    c, s = math.cos(angle) / cell, math.sin(angle) / cell
    low, (width, height) = _bounds(walls, c, s)
    wall, open_ = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    _mark(wall, walls, c, s, low)
    _mark(open_, free, c, s, low)
    open_[cv2.dilate(wall, np.ones((3, 3), np.uint8)) > 0] = 0
    return wall, open_, low


@njit(cache=True)
def _bounds(points: NDArray[np.float64], c: float, s: float) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """The lowest cell (x, y) of the turned and scaled points (n, 2) less one, and (width, height) up to the highest
    and one more."""
    x, y = c * points[0, 0] - s * points[0, 1], s * points[0, 0] + c * points[0, 1]
    x0, x1, y0, y1 = x, x, y, y
    for k in range(1, len(points)):
        x, y = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    low = np.array([math.floor(x0) - 1, math.floor(y0) - 1])
    return low, (math.floor(x1) + 2 - low[0], math.floor(y1) + 2 - low[1])


@njit(cache=True)
def _mark(raster: Raster, points: NDArray[np.float64], c: float, s: float, low: NDArray[np.int64]) -> None:
    """Set the cells that the turned and scaled points (n, 2) fall in."""
    for k in range(len(points)):
        x = math.floor(c * points[k, 0] - s * points[k, 1]) - low[0]
        y = math.floor(s * points[k, 0] + c * points[k, 1]) - low[1]
        if 0 <= x < raster.shape[1] and 0 <= y < raster.shape[0]:
            raster[y, x] = 1.0


def _peaks(scores: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """(n, 2) row and column of the highest local maxima above 0, at most `count`, highest first, ties by place."""
    found, places = _highest(scores, count)
    return np.asarray(places[:found])


@njit(cache=True)
def _highest(scores: NDArray[np.float32], count: int) -> tuple[int, NDArray[np.int64]]:
    height, width = scores.shape
    places, tops, found = np.zeros((count + 1, 2), np.int64), np.zeros(count + 1, np.float32), 0
    least = np.float32(0)
    for y in range(height):
        for begin in range(0, width, STRETCH):
            end, some = min(begin + STRETCH, width), False
            for x in range(begin, end):
                some |= scores[y, x] > least
            if not some:
                continue
            for x in range(begin, end):
                score = scores[y, x]
                if score <= least or scores[max(0, y - 2) : y + 3, max(0, x - 2) : x + 3].max() > score:
                    continue
                k = found
                while k > 0 and tops[k - 1] < score:
                    tops[k], places[k] = tops[k - 1], places[k - 1]
                    k -= 1
                tops[k] = score
                places[k, 0], places[k, 1] = y, x
                found = min(found + 1, count)
                least = tops[count - 1]
    return found, places


def _signed(shift: int, period: int, size: int) -> int:
    """A cyclic shift as the signed one: b may hang out of a's lower end by at most its own size."""
    return shift if shift < period - size else shift - period
