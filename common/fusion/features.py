"""Proposals by ORB key points on the map as an image, and a seeded rigid RANSAC in metres."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.geometry.se2 import apply
from common.grid.grid import FREE, OCCUPIED

PIXEL_M = 0.1
LEVELS = 4
RATIO = 0.85
"""a match must be this much nearer than the second best (Lowe's test)"""
INLIER_M = 0.25
DRAWS = 400
MIN_INLIERS = 4
MIN_SPREAD_M = 1.0
"""two matches closer than this fix no rotation"""


class Features(NamedTuple):
    points: NDArray[np.float64]
    """(n, 2) m in the map frame"""
    descriptors: NDArray[np.uint8]
    """(n, 32)"""


def find_features(raster: NDArray[np.int8], origin: NDArray[np.float64], resolution: float, count: int) -> Features:
    """At most `count` ORB key points of an occupancy raster (h, w) whose [0, 0] has its lower left corner at `origin`.

    Key points are looked for from PIXEL_M upwards: finer detail of a map is noise.
    """
    step = max(1, round(PIXEL_M / resolution))
    orb = cv2.ORB.create(nfeatures=count, fastThreshold=10, nlevels=LEVELS)
    keys, descriptors = orb.detectAndCompute(draw(raster, step), None)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 32), np.uint8))
    pixels = np.array([key.pt for key in keys], np.float64)
    return Features(origin + (pixels + 0.5) * (step * resolution), np.asarray(descriptors, np.uint8))


def draw(raster: NDArray[np.int8], step: int) -> NDArray[np.uint8]:
    """An occupancy raster as an image, `step` cells a pixel: a pixel with any wall is 0, else any free 255, else 128.

    So walls are the strongest edge and frontiers a weak one.
    """
    block = np.ones((step, step), np.uint8)
    wall, free = (
        cv2.dilate((raster == value).astype(np.uint8), block, anchor=(step - 1, step - 1))[
            step - 1 :: step, step - 1 :: step
        ]
        for value in (OCCUPIED, FREE)
    )
    image = np.full(wall.shape, 128, np.uint8)
    image[free > 0] = 255
    image[wall > 0] = 0
    return image


def propose_by_features(fa: Features, fb: Features, hypotheses: int, seed: int) -> NDArray[np.float64]:
    """Poses (n, 3) of b's frame in a's, most inliers first; the inliers of one are not used for the next."""
    pairs = _matches(fa.descriptors, fb.descriptors)
    points_a, points_b = fa.points[pairs[:, 0]], fb.points[pairs[:, 1]]
    rng = np.random.default_rng(seed)
    poses: list[NDArray[np.float64]] = []
    while len(poses) < hypotheses and len(points_a) >= MIN_INLIERS:
        pose, inliers = _ransac(points_a, points_b, rng)
        if inliers.sum() < MIN_INLIERS:
            break
        poses.append(pose)
        points_a, points_b = points_a[~inliers], points_b[~inliers]
    return np.array(poses).reshape(-1, 3)


def fitting(fa: Features, fb: Features, seed: int) -> int:
    """How many matches the best rigid transform brings together."""
    pairs = _matches(fa.descriptors, fb.descriptors)
    if len(pairs) < MIN_INLIERS:
        return 0
    _, inliers = _ransac(fa.points[pairs[:, 0]], fb.points[pairs[:, 1]], np.random.default_rng(seed))
    return int(inliers.sum())


def fit_rigid(points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose (..., 3) with least squares |pose(b) - a|, points (..., n, 2); no scale."""
    mean_a, mean_b = points_a.mean(axis=-2), points_b.mean(axis=-2)
    da, db = points_a - mean_a[..., None, :], points_b - mean_b[..., None, :]
    sine = (db[..., 0] * da[..., 1] - db[..., 1] * da[..., 0]).sum(axis=-1)
    cosine = (db * da).sum(axis=(-1, -2))
    theta = np.arctan2(sine, cosine)
    c, s = np.cos(theta), np.sin(theta)
    x = mean_a[..., 0] - c * mean_b[..., 0] + s * mean_b[..., 1]
    y = mean_a[..., 1] - s * mean_b[..., 0] - c * mean_b[..., 1]
    return np.stack([x, y, theta], axis=-1)


def _matches(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(n, 2) indices of matches that pass the ratio test in either direction, sorted."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), np.int64)
    best, distances = _nearest_two(_words(a), _words(b))
    forth, back = (side[:, 0] < RATIO * side[:, 1] for side in (distances[: len(a)], distances[len(a) :]))
    pairs = [
        np.stack([np.flatnonzero(forth), best[: len(a)][forth]], axis=1),
        np.stack([best[len(a) :][back], np.flatnonzero(back)], axis=1),
    ]
    return np.unique(np.concatenate(pairs), axis=0)


def _words(descriptors: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """Descriptors (n, 32) as (n, 4) words."""
    return np.ascontiguousarray(descriptors).view(np.uint64)


@njit(cache=True)
def _nearest_two(a: NDArray[np.uint64], b: NDArray[np.uint64]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """For each of a in b, then for each of b in a: the nearest one (na + nb,), its and the second's bits (na + nb, 2).

    Both ways in one pass over all Hamming distances.
    """
    n = len(a)
    nearest = np.zeros(n + len(b), np.int64)
    bits = np.full((n + len(b), 2), np.int32(257))
    row = np.empty(len(b), np.int32)
    for i in range(n):
        for j in range(len(b)):
            distance = np.int32(0)
            for word in range(4):
                distance += _ones(a[i, word] ^ b[j, word])
            row[j] = distance
        for j in range(len(b)):
            distance = row[j]
            if distance < bits[i, 1]:
                _take(nearest, bits, i, j, distance)
            if distance < bits[n + j, 1]:
                _take(nearest, bits, n + j, i, distance)
    return nearest, bits


@njit(cache=True)
def _take(nearest: NDArray[np.int64], bits: NDArray[np.int32], of: int, other: int, distance: int) -> None:
    if distance < bits[of, 0]:
        bits[of, 1] = bits[of, 0]
        bits[of, 0] = distance
        nearest[of] = other
    else:
        bits[of, 1] = distance


@njit(cache=True)
def _ones(word: np.uint64) -> np.int32:
    """How many bits are set."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int32((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


def _ransac(
    points_a: NDArray[np.float64], points_b: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The pose that most matches agree on, fitted to them, and which do."""
    draws = rng.integers(0, len(points_a), (DRAWS, 2))
    points_a, points_b = np.ascontiguousarray(points_a), np.ascontiguousarray(points_b)
    agreed, best = _most_agreed(points_a, points_b, draws)
    if not agreed:
        return np.zeros(3), np.zeros(len(points_a), np.bool_)
    inliers = _near(best, points_a, points_b)
    pose = fit_rigid(points_a[inliers], points_b[inliers])
    return pose, _near(pose, points_a, points_b) | inliers


def _near(pose: NDArray[np.float64], points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points of b the pose brings to their points of a."""
    return np.asarray(np.linalg.norm(apply(pose, points_b) - points_a, axis=1) < INLIER_M)


@njit(cache=True)
def _most_agreed(
    points_a: NDArray[np.float64], points_b: NDArray[np.float64], draws: NDArray[np.int64]
) -> tuple[int, NDArray[np.float64]]:
    """(matches brought together, pose) of the first best among the poses that two matches each (n, 2) fix."""
    most, pose = 0, np.zeros(3)
    for k in range(len(draws)):
        i, j = draws[k, 0], draws[k, 1]
        ax, ay = points_a[j, 0] - points_a[i, 0], points_a[j, 1] - points_a[i, 1]
        bx, by = points_b[j, 0] - points_b[i, 0], points_b[j, 1] - points_b[i, 1]
        length_a, length_b = math.hypot(ax, ay), math.hypot(bx, by)
        if length_a <= MIN_SPREAD_M or abs(length_a - length_b) >= INLIER_M:
            continue
        product = length_a * length_b
        c, s = (bx * ax + by * ay) / product, (bx * ay - by * ax) / product
        mx, my = 0.5 * (points_b[i, 0] + points_b[j, 0]), 0.5 * (points_b[i, 1] + points_b[j, 1])
        x = 0.5 * (points_a[i, 0] + points_a[j, 0]) - c * mx + s * my
        y = 0.5 * (points_a[i, 1] + points_a[j, 1]) - s * mx - c * my
        agreed = 0
        for m in range(len(points_a)):
            ex = x + c * points_b[m, 0] - s * points_b[m, 1] - points_a[m, 0]
            ey = y + s * points_b[m, 0] + c * points_b[m, 1] - points_a[m, 1]
            agreed += ex * ex + ey * ey < INLIER_M * INLIER_M
        if agreed > most:
            most = agreed
            pose[:] = x, y, math.atan2(s, c)
    return most, pose
