"""Keeping the number of keyframes bounded: where many look alike, some go, and what hung on them moves to others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose, inverse
from common.geometry.pose_graph import PoseGraph

PLACE_M = 1.0
PLACE_RAD = np.pi / 2
"""keyframes in one square of this side, heading into one sector of this width, are views of one place"""


def crowded(poses: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """`count` keyframes of `poses` (n, 3) that can go, rising: every second view of the most crowded places first.

    Places are taken wider until there are enough. The first keyframe holds the map's frame and always stays.
    """
    size = PLACE_M
    gone = _spare(poses, size)
    while len(gone) < min(count, len(poses) // 4):
        size *= 2
        gone = _spare(poses, size)
    return np.sort(gone[:count])


def _spare(poses: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    """Every second view of each place of `size` m, views of the most crowded places first."""
    squares = np.floor(poses[:, :2] / size).astype(np.int64)
    sectors = np.floor(poses[:, 2] / PLACE_RAD).astype(np.int64)
    keys = np.column_stack([squares, sectors])
    _, place, views = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    place = place.ravel()
    order = np.argsort(place, kind="stable")
    rank = np.empty(len(poses), np.int64)
    rank[order] = np.arange(len(poses)) - np.searchsorted(place[order], place[order])
    spare = np.flatnonzero((rank % 2 == 1) & (np.arange(len(poses)) > 0))
    return spare[np.argsort(-views[place[spare]], kind="stable")]


def heirs(nodes: int, gone: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each node (n,) the one that stays and takes over what hangs on it: itself, or the last before it."""
    stays = np.ones(nodes, bool)
    stays[gone] = False
    return np.maximum.accumulate(np.where(stays, np.arange(nodes), 0))


def numbers(heir: NDArray[np.int64]) -> NDArray[np.int64]:
    """The new number (n,) of each node that stays, when those that go are left out."""
    return np.cumsum(heir == np.arange(len(heir))) - 1


def eliminate(graph: PoseGraph, heir: NDArray[np.int64]) -> None:
    """Take the nodes out of the graph that are not their own heirs; nodes are numbered anew.

    Edges of a node that goes are carried over to its heir by the poses as they are now; links between keyframes of
    one heir vanish, and of loops between the same two the latest stays. Information is carried along, not added to:
    a bridge is as uncertain as its links together.
    """
    ends = heir[graph.pairs]
    kept = (ends[:, 0] != ends[:, 1]) & ~_repeated(ends, graph.loops)
    to_i = between(graph.poses[ends[:, 0]], graph.poses[graph.pairs[:, 0]])
    to_j = between(graph.poses[ends[:, 1]], graph.poses[graph.pairs[:, 1]])
    measured = compose(compose(to_i, graph.measured), inverse(to_j))
    covariance = np.asarray(np.linalg.inv(graph.information), np.float64)
    _add_bridges(graph, heir, covariance)
    covariance = _moved(covariance, to_j)
    graph.pairs = numbers(heir)[ends[kept]]
    graph.measured = measured[kept]
    graph.information = np.linalg.inv(covariance[kept])
    graph.loops = graph.loops[kept]
    graph.poses = graph.poses[heir == np.arange(len(heir))]


def _repeated(ends: NDArray[np.int64], loops: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which loop edges (e,) have a later one between the same nodes."""
    rows = np.column_stack([ends, loops])[::-1]
    _, latest = np.unique(rows, axis=0, return_index=True)
    repeated = np.ones(len(ends), bool)
    repeated[len(ends) - 1 - latest] = False
    return repeated & (loops == 1)


def _add_bridges(graph: PoseGraph, heir: NDArray[np.int64], covariance: NDArray[np.float64]) -> None:
    """Give the link that leaves a run of nodes for the next one the uncertainty of the links within the run, too."""
    gone = heir != np.arange(len(heir))
    touched = np.flatnonzero((graph.loops == 0) & gone[graph.pairs].any(axis=1))
    within: dict[int, NDArray[np.float64]] = {}
    for edge in touched.tolist():
        i, j = graph.pairs[edge].tolist()
        run = int(heir[i])
        if run in within:
            covariance[edge] += _moved(within[run][None], between(graph.poses[j], graph.poses[i])[None])[0]
        within[run] = covariance[edge]


def _moved(covariance: NDArray[np.float64], by: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariances (n, 3, 3) of poses, as seen from frames in which these have the poses `by` (n, 3)."""
    c, s = np.cos(by[:, 2]), np.sin(by[:, 2])
    adjoint = np.zeros((len(by), 3, 3))
    adjoint[:, 0, 0], adjoint[:, 0, 1], adjoint[:, 0, 2] = c, -s, by[:, 1]
    adjoint[:, 1, 0], adjoint[:, 1, 1], adjoint[:, 1, 2] = s, c, -by[:, 0]
    adjoint[:, 2, 2] = 1.0
    return adjoint @ covariance @ adjoint.transpose(0, 2, 1)
