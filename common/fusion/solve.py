"""Transforms of all robots from merged pairs: components of a pose graph, solved robustly.

Pairs that break a cycle are left out and named. What is left is solved by Gauss-Newton with Huber's weights, in
sorted order, so that the answer depends on nothing but the pairs. Known start poses join the graph as pairs with
the world. A component's frame is that of its first robot, or the world's; anchors (transforms published before)
turn the whole component so that what has been published stays where it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import networkx as nx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.fusion.cycles import Measured, Measurement, Pair, contradicted, pair_graph, spanning_tree, step
from common.fusion.settings import FusionSettings
from common.geometry.se2 import IDENTITY, Pose, between, compose, inverse, wrap

WORLD = ""
"""node of the world in the graph; sorts before every robot"""
START_INFORMATION = np.diag([25.0, 25.0, 400.0])
"""a start pose is good to 0.2 m and 3 degrees"""
HUBER = 3.0
ITERATIONS = 30
SAME_FRAME_M, SAME_FRAME_RAD = 0.5, 0.1


@dataclass(frozen=True)
class Solved:
    """Robots whose relative transforms are known."""

    id: str
    """name of its first robot in sorted order"""
    robots: tuple[str, ...]
    transforms: dict[str, Pose]
    """robot map frame in the component's frame"""
    in_world: bool = False
    """the frame is the world's, by start poses or anchors"""
    left_out: dict[Pair, str] = field(default_factory=dict)
    """pairs of these robots that cycles contradict, with the reason (told by the component of the pair's first)"""


def solve(
    robots: Sequence[str],
    pairs: Mapping[Pair, Measured],
    *,
    starts: Mapping[str, ArrayLike] = {},
    anchors: Mapping[str, ArrayLike] = {},
    settings: FusionSettings | None = None,
) -> list[Solved]:
    """Components of the robots, sorted by id, from pairs (a, b) whose transform is the pose of b's frame in a's.

    `starts` are poses of robot map frames in the world as told, `anchors` as published before.
    """
    left_out = contradicted(pairs, settings or FusionSettings())
    edges: dict[Pair, Measured] = {pair: pairs[pair] for pair in sorted(pairs) if pair not in left_out}
    for robot in sorted(starts):
        if robot in robots:
            edges[WORLD, robot] = Measurement(np.asarray(starts[robot], np.float64), START_INFORMATION)
    graph = pair_graph(edges)
    graph.add_nodes_from(sorted(robots))
    components = []
    for nodes in nx.connected_components(graph):
        names = tuple(sorted(nodes - {WORLD}))
        poses = _relax(graph.subgraph(sorted(nodes)), edges)
        frame = _anchored_frame(poses, anchors)
        transforms = {name: compose(frame, poses[name]) if frame is not None else poses[name] for name in names}
        told = {pair: reason for pair, reason in left_out.items() if pair[0] in nodes}
        components.append(Solved(names[0], names, transforms, WORLD in nodes or frame is not None, told))
    return sorted(components, key=lambda component: component.id)


def _relax(graph: nx.Graph, pairs: Mapping[Pair, Measured]) -> dict[str, Pose]:
    """Poses of all nodes, the first in sorted order at the identity."""
    names = sorted(graph)
    poses: dict[str, Pose] = {names[0]: IDENTITY}
    for a, b in nx.bfs_edges(spanning_tree(graph), names[0], sort_neighbors=sorted):
        poses[b] = compose(poses[a], step(a, b, graph, pairs))
    index = {name: k for k, name in enumerate(names)}
    edges = sorted(graph.edges[edge]["pair"] for edge in graph.edges)
    if len(edges) < len(names):
        return poses
    ends = np.array([(index[a], index[b]) for a, b in edges])
    measured = np.array([np.asarray(pairs[edge].transform, np.float64) for edge in edges])
    information = np.array([pairs[edge].information for edge in edges])
    solved = _gauss_newton(np.array([poses[name] for name in names]), ends, measured, information)
    return dict(zip(names, solved, strict=True))


def _gauss_newton(
    poses: NDArray[np.float64],
    ends: NDArray[np.int64],
    measured: NDArray[np.float64],
    information: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Poses (n, 3) that fit pairs `ends` (m, 2) with `measured` (m, 3); row 0 stays."""
    poses = poses.copy()
    n = len(poses)
    for _ in range(ITERATIONS):
        hessian, gradient = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
        for (a, b), target, weight in zip(ends, measured, information, strict=True):
            residual = between(poses[a], poses[b]) - target
            residual[2] = wrap(residual[2])
            distance = float(np.sqrt(residual @ weight @ residual))
            robust = weight * (1.0 if distance <= HUBER else HUBER / distance)
            jacobian = np.concatenate(difference_by(poses[a], poses[b]), axis=1)
            at = np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
            hessian[np.ix_(at, at)] += jacobian.T @ robust @ jacobian
            gradient[at] += jacobian.T @ robust @ residual
        move = np.linalg.solve(hessian[3:, 3:], gradient[3:]).reshape(-1, 3)
        poses[1:] -= move
        if np.abs(move).max() < 1e-10:
            break
    poses[:, 2] = wrap(poses[:, 2])
    return poses


def difference_by(a: Pose, b: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives (3, 3) of `between(a, b)` by a and by b."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    by_a = np.array([[-c, -s, -s * dx + c * dy], [s, -c, -c * dx - s * dy], [0.0, 0.0, -1.0]])
    by_b = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return by_a, by_b


def _anchored_frame(poses: Mapping[str, Pose], anchors: Mapping[str, ArrayLike]) -> Pose | None:
    """The frame that leaves most of the anchored robots where they were; of equals, by the first robot's name."""
    frames = [compose(anchors[name], inverse(poses[name])) for name in sorted(poses) if name in anchors]
    if not frames:
        return None
    votes = [sum(_same_frame(frame, other) for other in frames) for frame in frames]
    return frames[int(np.argmax(votes))]


def _same_frame(p: Pose, q: Pose) -> bool:
    gap = p - q
    return bool(np.hypot(gap[0], gap[1]) < SAME_FRAME_M and abs(wrap(gap[2])) < SAME_FRAME_RAD)
