"""Components that share nothing are laid out apart, so that nobody takes neighbours on the picture for neighbours.

Places are whole multiples of SNAP_M: shifting a map by them is exact at any usual resolution, and a component keeps
the place that it has been given unless another has grown into it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from common.fusion.matchmap import MatchMap
from common.geometry.se2 import IDENTITY, Pose, apply

SNAP_M = 1.0
GAP_M = 2.0


class Box(NamedTuple):
    """An axis-parallel box in metres."""

    x0: float
    y0: float
    x1: float
    y1: float


def bounds(maps: Iterable[tuple[MatchMap, ArrayLike]]) -> Box:
    """The box around maps placed by their poses; empty at the origin when they know nothing."""
    corners = [np.zeros((0, 2))]
    for map_, pose in maps:
        if map_.known_cells:
            height, width = map_.occupancy.shape
            far = map_.origin + np.array([width, height]) * map_.resolution
            x, y = np.meshgrid((map_.origin[0], far[0]), (map_.origin[1], far[1]))
            corners.append(apply(pose, np.stack([x.ravel(), y.ravel()], axis=1)))
    points = np.concatenate(corners)
    if not len(points):
        return Box(0.0, 0.0, 0.0, 0.0)
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    return Box(float(x0), float(y0), float(x1), float(y1))


def lay_out(boxes: Mapping[str, Box], kept: Mapping[str, ArrayLike] = {}) -> dict[str, Pose]:
    """World poses of components' frames, given their boxes in their own frames, by id.

    `kept` are places given before (for a component whose frame is the world's: the identity); of two kept ones that
    have grown together, the later by id moves. The first component lies at the identity, others to its right.
    """
    places: dict[str, Pose] = {}
    taken: list[Box] = []
    for name in sorted(boxes, key=lambda name: (name not in kept, name)):
        place = np.asarray(kept.get(name, IDENTITY), np.float64)
        if (name not in kept and taken) or any(_touch(_moved(boxes[name], place), other) for other in taken):
            x = math.ceil((max(box.x1 for box in taken) + GAP_M - boxes[name].x0) / SNAP_M) * SNAP_M
            y = math.ceil((taken[0].y0 - boxes[name].y0) / SNAP_M) * SNAP_M
            place = np.array([x, y, 0.0])
        places[name] = place
        taken.append(_moved(boxes[name], place))
    return places


def _moved(box: Box, pose: Pose) -> Box:
    """The box around a box that has been moved by a pose."""
    corners = np.array([[x, y] for x in (box.x0, box.x1) for y in (box.y0, box.y1)])
    (x0, y0), (x1, y1) = (f(apply(pose, corners), axis=0) for f in (np.min, np.max))
    return Box(float(x0), float(y0), float(x1), float(y1))


def _touch(a: Box, b: Box) -> bool:
    return a.x0 < b.x1 + GAP_M / 2 and b.x0 < a.x1 + GAP_M / 2 and a.y0 < b.y1 + GAP_M / 2 and b.y0 < a.y1 + GAP_M / 2
