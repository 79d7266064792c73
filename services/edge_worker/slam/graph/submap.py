"""A submap: some consecutive keyframes, rigid among themselves, as something to find loops with."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.graph.branch_and_bound import COARSE, pyramid
from services.edge_worker.slam.graph.keyframe import Keyframe
from services.edge_worker.slam.graph.surfels import SurfelMap
from services.edge_worker.slam.raycast import NOWHERE, trace
from services.edge_worker.slam.scan import Points

SIZE = 512
"""cells of a target's torus each way"""
REACH = 0.45 * SIZE * COARSE
"""m; points of a target further from its anchor are left out, so that nothing wraps around"""
CACHED = 8


@dataclass(frozen=True)
class Submap:
    """Which keyframes, and how they lie to the anchor; kept as it was when the submap was finished."""

    anchor: int
    """keyframe whose frame is the submap's"""
    members: tuple[int, ...]
    poses: NDArray[np.float64]
    """(m, 3) of the members in the anchor's frame"""


class Target:
    """A submap laid out for matching, in its anchor's frame."""

    def __init__(self, submap: Submap, keyframes: list[Keyframe]) -> None:
        self.surfels = SurfelMap(SIZE)
        self.seen = np.zeros((SIZE, SIZE), np.uint8)
        """per coarse cell of the torus: 0 unknown, 1 passed by beams, 2 hit"""
        hits = []
        for number, (member, pose) in enumerate(zip(submap.members, submap.poses, strict=True)):
            frame = keyframes[member]
            near = within(frame.points, pose, REACH)
            points = np.ascontiguousarray(frame.points[near])
            if len(points):
                normals = np.ascontiguousarray(frame.normals[near])
                self.surfels.insert(points, normals, pose)
                hits.append((self.surfels.slots(points, normals, pose), number))
                patch, x0, y0 = trace(pose, points, frame.silent[:0], frame.laser, COARSE, NOWHERE)
                overlay(self.seen, patch, x0, y0)
        self.levels = pyramid(self.surfels.field)
        self.seers = np.zeros((self.surfels.count, len(submap.members)), np.bool_)
        """(surfels, members) which members saw which surfel"""
        for slot, number in hits:
            self.seers[slot, number] = True


class TargetCache:
    """The last few targets; a target is a pure function of its submap, so the cache never shows in a result."""

    def __init__(self) -> None:
        self._targets: OrderedDict[int, Target] = OrderedDict()

    def get(self, number: int, submap: Submap, keyframes: list[Keyframe]) -> Target:
        if number in self._targets:
            self._targets.move_to_end(number)
            return self._targets[number]
        while len(self._targets) >= CACHED:
            self._targets.popitem(last=False)
        self._targets[number] = Target(submap, keyframes)
        return self._targets[number]

    def clear(self) -> None:
        self._targets.clear()

    def drop(self, number: int) -> None:
        self._targets.pop(number, None)


@njit(cache=True)
def within(points: Points, pose: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """Which points (n, 2) of the frame of `pose` (3,) lie within `reach` m of the origin."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    out = np.empty(len(points), np.bool_)
    for k in range(len(points)):
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        out[k] = abs(x) < reach and abs(y) < reach
    return out


@njit(cache=True)
def overlay(seen: NDArray[np.uint8], patch: NDArray[np.uint8], x0: int, y0: int) -> None:
    """Lay a patch of PASSED and HIT over a torus; the greater mark stays."""
    mask = len(seen) - 1
    for j in range(patch.shape[0]):
        for i in range(patch.shape[1]):
            row, column = (y0 + j) & mask, (x0 + i) & mask
            seen[row, column] = max(seen[row, column], patch[j, i])


@njit(cache=True)
def evidence(seen: NDArray[np.uint8], points: Points, pose: NDArray[np.float64]) -> tuple[int, int]:
    """How many points (n, 2) fall next to hits, and how many into space that beams have passed."""
    mask = len(seen) - 1
    c, s = np.cos(pose[2]), np.sin(pose[2])
    agree = conflict = 0
    for k in range(len(points)):
        i = int(np.floor((pose[0] + c * points[k, 0] - s * points[k, 1]) / COARSE))
        j = int(np.floor((pose[1] + s * points[k, 0] + c * points[k, 1]) / COARSE))
        hit = False
        for row in range(j - 1, j + 2):
            for column in range(i - 1, i + 2):
                hit = hit or seen[row & mask, column & mask] == 2
        if hit:
            agree += 1
        elif seen[j & mask, i & mask] == 1:
            conflict += 1
    return agree, conflict
