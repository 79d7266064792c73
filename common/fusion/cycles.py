"""Cycle consistency: going round any cycle of right pairs leads back to where it began.

Every triangle and every cycle that one pair closes over the spanning tree of the firmest pairs is walked. While
cycles fail, the pair that fails most often (net of the cycles it closes) is taken out, the least firm of equals.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, pairwise
from typing import NamedTuple, Protocol

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from common.fusion.settings import FusionSettings
from common.geometry.se2 import IDENTITY, Pose, compose, inverse

Pair = tuple[str, str]


class Measured(Protocol):
    """What is known about a pair (a, b)."""

    @property
    def transform(self) -> Pose | None:
        """(3,) pose of b's frame in a's, None when not merged"""

    @property
    def information(self) -> NDArray[np.float64]:
        """(3, 3) inverse covariance of the transform's x, y (m) and theta (rad)"""


class Measurement(NamedTuple):
    """A measured pair, by default as certain as a merged pair of rooms usually is: 5 cm and 0.5 degrees."""

    transform: Pose | None
    information: NDArray[np.float64] = np.diag([400.0, 400.0, 13_000.0])


def firmness(pair: Measured) -> float:
    """How firmly a pair holds in its weakest direction: the least eigenvalue of its information."""
    return float(np.linalg.eigvalsh(pair.information)[0])


def pair_graph(pairs: Mapping[Pair, Measured]) -> nx.Graph:
    """Robots joined by the pairs that have a transform; built in sorted order, so that ties break alike."""
    graph = nx.Graph()
    for a, b in sorted(pairs):
        if pairs[a, b].transform is not None:
            graph.add_edge(a, b, pair=(a, b), firmness=firmness(pairs[a, b]))
    return graph


def spanning_tree(graph: nx.Graph) -> nx.Graph:
    """The tree (or forest) of the firmest pairs."""
    return nx.maximum_spanning_tree(graph, weight="firmness")


def contradicted(pairs: Mapping[Pair, Measured], settings: FusionSettings) -> dict[Pair, str]:
    """The pairs to leave out so that all cycles close, each with the reason."""
    left_out: dict[Pair, str] = {}
    graph = pair_graph(pairs)
    while True:
        gaps = {cycle: closure(cycle, graph, pairs) for cycle in cycles(graph)}
        failing = [cycle for cycle, gap in gaps.items() if not _closes(gap, len(cycle), settings)]
        if not failing:
            return left_out
        blame: dict[Pair, int] = {}
        for cycle in gaps:
            for edge in _edges(cycle, graph):
                blame[edge] = blame.get(edge, 0) + (1 if cycle in failing else -1)
        suspects = {edge for cycle in failing for edge in _edges(cycle, graph)}
        worst = min(suspects, key=lambda edge: (-blame[edge], graph.edges[edge]["firmness"], edge))
        cycle = next(c for c in failing if worst in _edges(c, graph))
        gap = gaps[cycle]
        left_out[worst] = (
            f"the cycle {' - '.join((*cycle, cycle[0]))} misses its start by "
            f"{np.hypot(gap[0], gap[1]):.2f} m and {np.degrees(abs(gap[2])):.1f} degrees"
        )
        graph.remove_edge(*worst)


def cycles(graph: nx.Graph) -> list[tuple[str, ...]]:
    """All triangles, and for each edge outside of the spanning tree the cycle it closes; robots in order."""
    found: dict[frozenset[str], tuple[str, ...]] = {}
    for a in sorted(graph):
        later = sorted(n for n in graph[a] if n > a)
        for b, c in combinations(later, 2):
            if graph.has_edge(b, c):
                found[frozenset((a, b, c))] = (a, b, c)
    tree = spanning_tree(graph)
    for a, b in sorted(tuple(sorted(edge)) for edge in graph.edges):
        if not tree.has_edge(a, b):
            path = tuple(nx.shortest_path(tree, a, b))
            found.setdefault(frozenset(path), path)
    return list(found.values())


def closure(cycle: tuple[str, ...], graph: nx.Graph, pairs: Mapping[Pair, Measured]) -> Pose:
    """(3,) where going round the cycle leads, seen from its start; the identity when it closes."""
    pose: Pose = IDENTITY
    for a, b in pairwise((*cycle, cycle[0])):
        pose = compose(pose, step(a, b, graph, pairs))
    return pose


def step(a: str, b: str, graph: nx.Graph, pairs: Mapping[Pair, Measured]) -> Pose:
    """The pose of b's frame in a's, whichever way round the pair was measured."""
    pair = graph.edges[a, b]["pair"]
    transform = pairs[pair].transform
    assert transform is not None
    return np.asarray(transform, np.float64) if pair[0] == a else inverse(transform)


def _edges(cycle: tuple[str, ...], graph: nx.Graph) -> list[Pair]:
    return [graph.edges[a, b]["pair"] for a, b in pairwise((*cycle, cycle[0]))]


def _closes(gap: Pose, length: int, settings: FusionSettings) -> bool:
    """Longer cycles may gather more error than triangles, as errors that are independent do."""
    slack = (length / 3) ** 0.5
    return bool(
        np.hypot(gap[0], gap[1]) <= settings.max_cycle_m * slack and abs(gap[2]) <= settings.max_cycle_rad * slack
    )
