"""Pictures of a merge for people: agreement green, conflict red, walls of one map alone blue and orange."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.fusion.matchmap import MatchMap
from common.geometry.se2 import apply, inverse
from common.grid.grid import FREE, OCCUPIED, UNKNOWN

TOLERANCE_M = 0.12
UNKNOWN_RGB, ONE_FREE_RGB, BOTH_FREE_RGB = (160, 160, 160), (235, 235, 235), (255, 255, 255)
AGREES_RGB, CONFLICT_RGB, A_RGB, B_RGB = (0, 150, 0), (220, 0, 0), (40, 80, 220), (240, 140, 20)


def overlay(a: MatchMap, b: MatchMap, transform: ArrayLike) -> NDArray[np.uint8]:
    """RGB image (h, w, 3) of b laid on a by `transform`, in a's frame, row 0 the highest y."""
    pose = np.asarray(transform, np.float64)
    height, width = b.occupancy.shape
    far = np.array([width, height]) * b.resolution
    corners = apply(pose, b.origin + np.array([[0, 0], [far[0], 0], [0, far[1]], far]))
    end_a = a.origin + np.array(a.occupancy.shape[::-1]) * a.resolution
    low = np.floor(np.minimum(a.origin, corners.min(axis=0)) / a.resolution).astype(np.int64)
    high = np.ceil(np.maximum(end_a, corners.max(axis=0)) / a.resolution).astype(np.int64)
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    points = (np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5) * a.resolution
    in_a = _look_up(a, points).reshape(rows.shape)
    in_b = _look_up(b, apply(inverse(pose), points)).reshape(rows.shape)
    return np.ascontiguousarray(_colour(in_a, in_b, a.resolution)[::-1])


def write_png(path: str, image: NDArray[np.uint8]) -> None:
    """Write an RGB image (h, w, 3)."""
    if not cv2.imwrite(path, cv2.cvtColor(image, cv2.COLOR_RGB2BGR)):
        raise OSError(f"{path}: could not be written")


def _look_up(map_: MatchMap, points: NDArray[np.float64]) -> NDArray[np.int8]:
    cells = np.floor((points - map_.origin) / map_.resolution).astype(np.int64)
    inside = ((cells >= 0) & (cells < np.array(map_.occupancy.shape[::-1]))).all(axis=1)
    values = np.full(len(points), UNKNOWN)
    values[inside] = map_.occupancy[cells[inside, 1], cells[inside, 0]]
    return values


def _colour(a: NDArray[np.int8], b: NDArray[np.int8], resolution: float) -> NDArray[np.uint8]:
    size = 2 * round(TOLERANCE_M / resolution) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    near_a = cv2.dilate((a == OCCUPIED).astype(np.uint8), disc) > 0
    near_b = cv2.dilate((b == OCCUPIED).astype(np.uint8), disc) > 0
    wall_a, wall_b = a == OCCUPIED, b == OCCUPIED
    image = np.empty((*a.shape, 3), np.uint8)
    image[:] = UNKNOWN_RGB
    image[(a == FREE) | (b == FREE)] = ONE_FREE_RGB
    image[(a == FREE) & (b == FREE)] = BOTH_FREE_RGB
    image[wall_a] = A_RGB
    image[wall_b] = B_RGB
    image[(wall_a & (b == FREE) & ~near_b) | (wall_b & (a == FREE) & ~near_a)] = CONFLICT_RGB
    image[(wall_a & near_b) | (wall_b & near_a)] = AGREES_RGB
    return image
