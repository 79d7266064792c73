"""Straight surfaces in a scan: beams that met the same one tell together where it is, better than each alone.

A beam's error lies along the beam, and many lasers err by about a share of the distance: a wall far off comes out thick
by several cells. A scan is therefore cut into the lines that explain it best, and each end is moved along its beam onto
its line. With r = range and t = bearing, a line is linear in 1/r = a cos t + b sin t, so a line's fit to any run of
beams comes from running sums, and the best cuts from dynamic programming (as Bellman, 1961): the squared errors of all
ends, in standard deviations, plus a price for each line. How large the errors are is told by the scan itself. A corner,
a pole or a curve costs more as one line than as several, so it is kept to within the errors.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.scan import Points

PRICE = 6.0
"""of a line, in squared errors: three numbers (two for the line, one for where it begins) at two each, which is
Akaike's criterion; it keeps a small step in a wall rather than smooth it away, and lines come out long all the same"""
FEWEST = 3
"""beams of a line; two fit any"""
LONGEST = 100
"""beams of a line; keeps the cost linear in the beams, and ten times less error is enough"""
DROPPED = 2
"""beams without an end that a line goes on across"""
MOST = 4.0
"""standard deviations that an end may be off its line and still belong to it"""
SHARE = (0.001, 0.03)
"""of the range: the standard deviation of lasers, least and most that a scan may tell; clutter looks like more"""
LEAST, LARGEST = 0.005, 0.075
"""m; no range is better, rounding included, and none is taken for worse: that is more than a cell of the map"""
BRIDGED = 0.2
"""m between two neighbouring ends on one line within which there is wall: less than any opening that matters"""
NORMAL = 1.4826
"""standard deviation over median absolute error"""
ALIKE = 1e-9
"""of the running sums; beams of less spread are of one bearing"""


def walls(points: Points, beams: NDArray[np.int32], laser: NDArray[np.float64]) -> tuple[Points, NDArray[np.bool_]]:
    """Where the beams that ended at `points` (n, 2) met walls, and from which of these places on there is wall.

    `beams` (n,) rising, `laser` (2,), all m in one frame. Returns (n, 2), each on the beam of its point, and (n,)
    whether there is wall as far as the next one.
    """
    if len(points) < FEWEST:
        return points, np.zeros(len(points), np.bool_)
    ranges, c, s = polar(points, laser)
    sigma = np.clip(noise(ranges, c, s, beams) * ranges, LEAST, LARGEST)
    cut = np.ones(len(points), np.bool_)
    cut[1:] = np.diff(beams) > DROPPED + 1
    fitted, joined = fit(ranges, c, s, sigma, cut)
    ends = np.asarray(laser + fitted[:, None] * np.stack([c, s], axis=1), np.float32)
    joined[:-1] &= np.hypot(*np.diff(ends, axis=0).T) < BRIDGED
    return ends, joined


def polar(
    points: Points, laser: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Ranges (n,) in m, never less than any is known to, and cosines and sines (n,) of bearings of `points` (n, 2)."""
    arms = points - laser
    ranges = np.maximum(np.hypot(arms[:, 0], arms[:, 1]), LEAST)
    return ranges, arms[:, 0] / ranges, arms[:, 1] / ranges


@njit(cache=True)
def noise(
    ranges: NDArray[np.float64], c: NDArray[np.float64], s: NDArray[np.float64], beams: NDArray[np.int32]
) -> float:
    """Standard deviation of `ranges` (n,) as a share of them; bearings by cosine (n,) and sine (n,).

    It is the median error of an end against the line through the ends of its neighbours.
    """
    errors = np.empty(len(ranges))
    n = 0
    for i in range(1, len(ranges) - 1):
        across = c[i - 1] * s[i + 1] - s[i - 1] * c[i + 1]
        if beams[i + 1] - beams[i - 1] > 2 * (DROPPED + 1) or abs(across) < ALIKE:
            continue
        before = (c[i] * s[i + 1] - s[i] * c[i + 1]) / across
        after = (c[i - 1] * s[i] - s[i - 1] * c[i]) / across
        error = 1.0 - ranges[i] * (before / ranges[i - 1] + after / ranges[i + 1])
        errors[n] = abs(error) / np.sqrt(1.0 + before * before + after * after)
        n += 1
    if n == 0:
        return SHARE[1]
    return min(max(NORMAL * np.median(errors[:n]), SHARE[0]), SHARE[1])


@njit(cache=True)
def fit(
    ranges: NDArray[np.float64],
    c: NDArray[np.float64],
    s: NDArray[np.float64],
    sigma: NDArray[np.float64],
    cut: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ranges (n,) on the lines that explain them best, and whether the next beam is on the same line (n,).

    `sigma` (n,) m; no line goes on across the beginning of a beam that is `cut` (n,).
    """
    n = len(ranges)
    sums = np.zeros((n + 1, 6))
    for i in range(n):
        w, u = (ranges[i] * ranges[i] / sigma[i]) ** 2, 1.0 / ranges[i]
        sums[i + 1, 0] = sums[i, 0] + w * c[i] * c[i]
        sums[i + 1, 1] = sums[i, 1] + w * c[i] * s[i]
        sums[i + 1, 2] = sums[i, 2] + w * s[i] * s[i]
        sums[i + 1, 3] = sums[i, 3] + w * c[i] * u
        sums[i + 1, 4] = sums[i, 4] + w * s[i] * u
        sums[i + 1, 5] = sums[i, 5] + w * u * u
    best = np.full(n + 1, np.inf)
    best[0] = 0.0
    begin = np.zeros(n + 1, np.int64)
    for end in range(1, n + 1):
        for first in range(end - 1, max(end - LONGEST, 0) - 1, -1):
            cost = best[first] + PRICE
            if cost < best[end] and end - first >= FEWEST:
                cost += _line(sums, first, end)[2]
            if cost < best[end]:
                best[end], begin[end] = cost, first
            if cut[first]:
                break
    fitted, joined = ranges.copy(), np.zeros(n, np.bool_)
    end = n
    while end > 0:
        first = begin[end]
        if end - first >= FEWEST:
            a, b, _ = _line(sums, first, end)
            for i in range(first, end):
                u = a * c[i] + b * s[i]
                if abs(1.0 - u * ranges[i]) * ranges[i] < MOST * sigma[i]:
                    fitted[i] = 1.0 / u
                joined[i] = i < end - 1
        end = first
    return fitted, joined


@njit(cache=True)
def _line(sums: NDArray[np.float64], first: int, end: int) -> tuple[float, float, float]:
    """The line (a, b) through the beams from `first` to before `end`, and the squared errors in standard deviations."""
    xx, xy, yy = sums[end, 0] - sums[first, 0], sums[end, 1] - sums[first, 1], sums[end, 2] - sums[first, 2]
    xu, yu, uu = sums[end, 3] - sums[first, 3], sums[end, 4] - sums[first, 4], sums[end, 5] - sums[first, 5]
    det = xx * yy - xy * xy
    if det <= ALIKE * (xx + yy) * (xx + yy):
        return 0.0, 0.0, np.inf
    a, b = (yy * xu - xy * yu) / det, (xx * yu - xy * xu) / det
    return a, b, max(uu - a * xu - b * yu, 0.0)
