"""A keyframe: a scan that is kept, with the direction of the wall at each of its points, and what is drawn of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.scan import Points, Scan
from services.edge_worker.slam.surfaces import noise, polar, walls

REACH = 2
"""neighbours on each side that a wall's direction is fitted to at least"""
SURE = 0.35
"""rad, standard deviation of the direction that so many neighbours may leave, by the scan's noise, seen square on"""
SPAN_M, MOST = 0.1, 24
"""else it is fitted to all neighbours so far off on each side, and so many at most: beams that are dense for their
noise give normals that stand anyhow, and seem to hold a robot in a corridor, and hold it back"""
GAP_BASE = 0.06
"""m; neighbours further apart than this and `GAP_SHARE` of their distance from the laser are two things"""
GAP_SHARE = 0.06
MAX_ROUGHNESS = 0.03
"""m rms off the fitted line; more is no wall"""
GRAZING = 0.05
"""cosine of the flattest angle at which a beam is thought to meet a wall"""
TINY = 1e-9


@dataclass(frozen=True)
class View:
    """A scan as it is drawn."""

    pose: NDArray[np.float64]
    """(3,) in the frame of the keyframe that it hangs on"""
    ends: Points
    """(n, 2) m where its beams met walls, in its own frame; better known than its points (see surfaces.py)"""
    joined: NDArray[np.bool_]
    """(n,) whether there is wall from this end on to the next"""
    silent: Points
    """(m, 2) m"""
    laser: NDArray[np.float64]
    """(2,) m"""

    @classmethod
    def of(cls, scan: Scan, pose: NDArray[np.float64]) -> View:
        ends, joined = walls(scan.points, scan.beams, scan.laser)
        return cls(pose, ends, joined, scan.silent, scan.laser)


@dataclass(frozen=True)
class Keyframe:
    """A kept scan in its base frame."""

    points: Points
    """(n, 2) m"""
    normals: Points
    """(n, 2) unit vectors out of the wall towards the laser; zero where there is no wall"""
    beams: NDArray[np.int32]
    """(n,)"""
    silent: Points
    """(m, 2) m"""
    laser: NDArray[np.float64]
    """(2,) m"""
    views: tuple[View, ...]
    """what is drawn: some scans on the way here, the scan itself last"""

    @classmethod
    def of(cls, scan: Scan, before: Iterable[View] = ()) -> Keyframe:
        """Of a scan, with views `before` it, whose poses are in its frame."""
        facing = normals(scan.points, scan.beams, scan.laser)
        views = (*before, View.of(scan, np.zeros(3)))
        return cls(scan.points, facing, scan.beams, scan.silent, scan.laser, views)


def normals(points: Points, beams: NDArray[np.int32], laser: NDArray[np.float64]) -> Points:
    """Unit normals (n, 2) towards the laser of lines fitted to each point and its neighbours in angle.

    `points` (n, 2), `beams` (n,) rising, `laser` (2,). A point without two near neighbours, or in a rough place,
    gets zeros.
    """
    ranges, c, s = polar(points, laser)
    return fitted(points, beams, laser, c, s, noise(ranges, c, s, beams))


@njit(cache=True)
def fitted(
    points: Points,
    beams: NDArray[np.int32],
    laser: NDArray[np.float64],
    c: NDArray[np.float64],
    s: NDArray[np.float64],
    share: float,
) -> Points:
    """Normals as above, of beams at cosines (n,) and sines (n,) that err by a `share` of their ranges."""
    n = len(points)
    out = np.zeros((n, 2), np.float32)
    for i in range(n):
        first, last = _end(points, beams, laser, i, -1, 0.0), _end(points, beams, laser, i, 1, 0.0)
        square = 0.0
        for k in range(first, last + 1):
            square += (c[k] * s[i] - s[k] * c[i]) ** 2
        if share * share > SURE * SURE * square:
            first, last = _end(points, beams, laser, i, -1, SPAN_M), _end(points, beams, laser, i, 1, SPAN_M)
        count = last - first + 1
        if count < 3:
            continue
        mx = my = 0.0
        for k in range(first, last + 1):
            mx += points[k, 0]
            my += points[k, 1]
        mx /= count
        my /= count
        xx = xy = yy = 0.0
        for k in range(first, last + 1):
            dx, dy = points[k, 0] - mx, points[k, 1] - my
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
        spread = np.sqrt((xx - yy) ** 2 / 4 + xy * xy)
        if np.sqrt(max((xx + yy) / 2 - spread, 0.0) / count) > MAX_ROUGHNESS:
            continue
        angle = 0.5 * np.arctan2(2 * xy, xx - yy) + np.pi / 2
        nx, ny = np.cos(angle), np.sin(angle)
        if nx * (laser[0] - points[i, 0]) + ny * (laser[1] - points[i, 1]) < 0:
            nx, ny = -nx, -ny
        out[i, 0], out[i, 1] = nx, ny
    return out


@njit(cache=True)
def _end(points: Points, beams: NDArray[np.int32], laser: NDArray[np.float64], i: int, step: int, span: float) -> int:
    """The last point on one side of point i (`step` -1 or 1) that its wall's direction is fitted to, `span` m off."""
    k = i
    while abs(k - i) < MOST and 0 <= k + step < len(points):
        across = np.hypot(points[k, 0] - points[i, 0], points[k, 1] - points[i, 1])
        if abs(k - i) >= REACH and across >= span:
            break
        if not _joined(points, beams, laser, min(k, k + step), max(k, k + step)):
            break
        k += step
    return k


@njit(cache=True)
def _joined(points: Points, beams: NDArray[np.int32], laser: NDArray[np.float64], i: int, j: int) -> bool:
    """Do neighbours i and j lie on one surface?"""
    if beams[j] - beams[i] > 2:
        return False
    gap = np.hypot(points[j, 0] - points[i, 0], points[j, 1] - points[i, 1])
    away = np.hypot(points[i, 0] - laser[0], points[i, 1] - laser[1])
    return gap <= GAP_BASE + GAP_SHARE * away


@njit(cache=True)
def thin(points: Points, normals: Points, laser: NDArray[np.float64], spacing: float, most: int) -> NDArray[np.int64]:
    """Indices of points on walls, on average `spacing` metres apart or as dense as they are; evenly thinned to `most`.

    `points` (n, 2) and `normals` (n, 2) in the order of their beams, `laser` (2,). How far beams are apart on a wall
    comes from the angle between them and the wall's direction, never from the distance of the points: taking the first
    one that is far enough from the last takes those that err away from it, and turns every scan the same way.
    """
    kept = np.empty(len(points), np.int64)
    n, share = 0, 1.0
    for i in range(len(points)):
        x, y = points[i, 0] - laser[0], points[i, 1] - laser[1]
        r = np.hypot(x, y)
        if i > 0:
            before_x, before_y = points[i - 1, 0] - laser[0], points[i - 1, 1] - laser[1]
            turn = abs(before_x * y - before_y * x) / max(np.hypot(before_x, before_y) * r, TINY)
            slant = max(abs(normals[i, 0] * x + normals[i, 1] * y) / max(r, TINY), GRAZING)
            share += r * turn / slant / max(spacing, TINY)
        if share < 1.0 or (normals[i, 0] == 0.0 and normals[i, 1] == 0.0):
            continue
        share -= np.floor(share)
        kept[n] = i
        n += 1
    if n <= most:
        return kept[:n].copy()
    out = np.empty(most, np.int64)
    for i in range(most):
        out[i] = kept[i * n // most]
    return out
