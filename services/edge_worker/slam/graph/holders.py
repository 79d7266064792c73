"""Which keyframes hold a loop: those whose own points tell where it lies, in all directions in which it is held.

A query and a submap are some keyframes each, taken for rigid. Along bare walls they are not: wheels that slip there go
unnoticed. A loop that is held along the corridor only by an end wall, which the query saw before the slip, says nothing
of the keyframe after it. So a loop is told of the two keyframes that saw what holds it, and what lies between these and
others stays with the edges of the graph.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.edge_worker.slam.graph.icp import NARROW_M, likely
from services.edge_worker.slam.graph.keyframe import Keyframe, thin
from services.edge_worker.slam.graph.loop import FIRM_M
from services.edge_worker.slam.graph.submap import Submap, Target
from services.edge_worker.slam.graph.surfels import met
from services.edge_worker.slam.scan import Points

ENOUGH = 0.5
"""share of what the best keyframe holds that makes another one as good"""
TINY = 1e-9


class Query(NamedTuple):
    """Keyframes that are looked for together, in the frame of the last of them."""

    keyframes: tuple[int, ...]
    poses: NDArray[np.float64]
    """(k, 3) of these keyframes"""
    points: Points
    """(n, 2) on walls"""
    normals: Points
    """(n, 2)"""
    owner: NDArray[np.int64]
    """(n,) place in `keyframes` of the one that saw each point"""

    @classmethod
    def of(
        cls, numbers: range, poses: NDArray[np.float64], keyframes: list[Keyframe], spacing: float, most: int
    ) -> Query:
        """Of the keyframes `numbers`, which lie at `poses` (k, 3): up to `most` points, `spacing` m apart in each."""
        points, normals, counts = [], [], []
        for number, pose in zip(numbers, poses, strict=True):
            frame = keyframes[number]
            kept = thin(frame.points, frame.normals, frame.laser, spacing, most)
            points.append(move(frame.points[kept], pose))
            normals.append(move(frame.normals[kept], np.array([0.0, 0.0, pose[2]])))
            counts.append(len(kept))
        joined, facing, owner = (
            np.concatenate(points),
            np.concatenate(normals),
            np.repeat(np.arange(len(counts)), counts),
        )
        chosen = np.arange(most) * len(joined) // most if len(joined) > most else slice(None)
        return cls(tuple(numbers), poses, joined[chosen], facing[chosen], owner[chosen])


def holders(
    target: Target,
    submap: Submap,
    query: Query,
    pose: NDArray[np.float64],
    covariance: NDArray[np.float64],
    scatter: float,
) -> tuple[int, int]:
    """Places in `query` and in `submap` of the keyframes that hold the query at `pose` (3,) in the submap.

    Only directions count in which the pose, of `covariance` (3, 3) in its own frame, is held, and nothing that the
    `scatter` of normals (rad^2) can make up. The latest keyframe of the query is told of if it holds enough, and so is
    the nearest of the submap.
    """
    surfels = target.surfels
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    told, seen = shares(
        surfels.index,
        surfels.sums,
        surfels.chain,
        target.seers,
        *query[2:],
        len(query.poses),
        pose,
        axes[:, 0],
        scatter,
    )
    held = variances < FIRM_M**2
    away = np.hypot(*(submap.poses - pose)[:, :2].T)
    latest = int(np.flatnonzero(enough(told[:, held]))[-1])
    return latest, int(np.argmin(np.where(enough(seen[:, held]), away, np.inf)))


def enough(known: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which keyframes (k,) know about as much as the best one, of what is `known` (k, d) in some directions."""
    share = (known / np.maximum(known.max(axis=0), TINY)).min(axis=1, initial=1.0)
    return np.asarray(share >= ENOUGH * share.max())


@njit(cache=True)
def shares(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    chain: NDArray[np.int32],
    seers: NDArray[np.bool_],
    points: Points,
    normals: Points,
    owner: NDArray[np.int64],
    owners: int,
    pose: NDArray[np.float64],
    axis: NDArray[np.float64],
    scatter: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What points (n, 2) at `pose` (3,) know along and across `axis`, a unit vector (2,) in their frame.

    By who saw them (owners, 2), and by who saw the walls that they meet (members, 2).
    """
    told, seen = np.zeros((owners, 2)), np.zeros((seers.shape[1], 2))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ax, ay = c * axis[0] - s * axis[1], s * axis[0] + c * axis[1]
    for k in range(len(points)):
        px, py, bx, by = points[k, 0], points[k, 1], normals[k, 0], normals[k, 1]
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        slot, nx, ny, off = met(index, sums, chain, x, y, c * bx - s * by, s * bx + c * by)
        if slot < 0:
            continue
        weight = likely(off, NARROW_M)
        along = (nx * ax + ny * ay) ** 2
        for way, square in enumerate((along, 1.0 - along)):
            known = weight * max(square - scatter, 0.0)
            told[owner[k], way] += known
            for m in range(len(seen)):
                if seers[slot, m]:
                    seen[m, way] += known
    return told, seen


@njit(cache=True)
def move(points: Points, pose: NDArray[np.float64]) -> Points:
    """Points (n, 2) of the frame of `pose` (3,) in the frame that it is given in."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    out = np.empty_like(points)
    for k in range(len(points)):
        out[k, 0] = pose[0] + c * points[k, 0] - s * points[k, 1]
        out[k, 1] = pose[1] + s * points[k, 0] + c * points[k, 1]
    return out
