"""From keyframes that have been corrected to a map that is straightened: the warp that carries each place along.

A place moves as the keyframes around it do, the nearest ones counting most, so the warp is smooth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.fusion.matchmap import MatchMap
from common.geometry.se2 import compose, inverse
from common.grid.warp import shifts
from common.wire.cloud import Warp

SPACING_M = 2.0
NEAR_M = 1.0
"""keyframes count by a bell of this width about a place; about one far from all of them, of half that distance"""
CHUNK = 1024
"""nodes at a time"""


def warp(map_: MatchMap, before: NDArray[np.float64], after: NDArray[np.float64]) -> Warp:
    """The warp of a map whose keyframes move from poses `before` (k, 3) to `after` (k, 3), both in its own frame."""
    far = map_.origin + np.array(map_.occupancy.shape[::-1]) * map_.resolution
    (x, y), (right, top) = (np.floor(map_.origin / SPACING_M).astype(int), np.ceil(far / SPACING_M).astype(int))
    columns, rows = np.meshgrid(np.arange(x, right + 1), np.arange(y, top + 1))
    nodes = np.stack([columns.ravel(), rows.ravel()], axis=1) * SPACING_M
    moves = compose(after, inverse(before))
    moved = np.concatenate([_moved(nodes[k : k + CHUNK], before, moves) for k in range(0, len(nodes), CHUNK)])
    um = np.rint((moved - nodes) * 1e6).astype(int).ravel().tolist()
    return Warp(spacing_m=SPACING_M, x=int(x), y=int(y), columns=int(right - x + 1), shifts_um=tuple(um))


def _moved(
    points: NDArray[np.float64], keyframes: NDArray[np.float64], moves: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (n, 2) moved by the mean of the keyframes' motions (k, 3) as they count there."""
    squares = np.square(points[:, None] - keyframes[None, :, :2]).sum(axis=2)
    nearest = squares.min(axis=1, keepdims=True)
    weights = np.exp(-(squares - nearest) / (2 * np.maximum(NEAR_M**2, nearest / 4)))
    weights /= weights.sum(axis=1, keepdims=True)
    x, y, cos, sin = (
        weights @ moves[:, 0],
        weights @ moves[:, 1],
        weights @ np.cos(moves[:, 2]),
        weights @ np.sin(moves[:, 2]),
    )
    return np.stack([x + cos * points[:, 0] - sin * points[:, 1], y + sin * points[:, 0] + cos * points[:, 1]], axis=1)


def bent_by(warp: Warp, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Straightened points (n, 2) m back where they lie in the bent map."""
    return points - shifts(warp, points - shifts(warp, points))
