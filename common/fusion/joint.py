"""Joint correction: all robots of a component in one pose graph, which straightens maps that a rigid merge cannot fit.

Each robot's way is an elastic chain of keyframes (common.fusion.keyframes); wherever two maps overlap, their walls tie
a keyframe of one robot to one of the other (common.fusion.ties). What comes out is a warp a map. It depends on nothing
but final maps, trajectories and rigid transforms, taken in sorted order; and it is taken back where it does not make
more walls agree: maps that differ by less than walls are told apart by are not bent, and correcting them would only
pass their noise around.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from common.fusion.keyframes import Keyframes, keyframes
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.fusion.straighten import bent_by, warp
from common.fusion.ties import FLOOR, Tie, ties
from common.geometry.pose_graph import PoseGraph
from common.geometry.se2 import Pose, apply, between, compose, inverse
from common.grid.grid import UNKNOWN
from common.grid.warp import shifts
from common.wire.cloud import Warp

ITERATIONS = 20
WORTH = 0.01
"""share of the walls that must come to agree: of some thousand walls, twice what chance makes of it"""
BOTH_WAYS = 0.5
"""a pair is tied from either side: together they count once"""

Pair = tuple[str, str]


class Robot(NamedTuple):
    """A robot as joint correction takes it."""

    map: MatchMap
    trajectory: NDArray[np.float64]
    """(n, 4) stamp s, x m, y m, theta rad in the map's frame"""
    placed: Pose
    """(3,) the map's frame in the world, by the rigid solve"""


class Joint(NamedTuple):
    """The outcome: warps of the robots that were corrected, none when it was taken back."""

    warps: dict[str, Warp]
    before: float
    after: float
    """share of walls that lie within the tolerance of the other map's, placed rigidly and corrected"""
    moved_m: float
    """most that any wall was moved by"""

    @property
    def told(self) -> str:
        """In words."""
        agree = f"walls that agree {self.before:.1%} -> {self.after:.1%}"
        if not self.warps:
            return f"rigid transforms stay: {agree}, by up to {self.moved_m:.2f} m"
        return f"{len(self.warps)} maps corrected by up to {self.moved_m:.2f} m: {agree}"


def correct(robots: Mapping[str, Robot], pairs: Iterable[Pair], settings: FusionSettings | None = None) -> Joint:
    """Correct robots together by the merged `pairs` among them."""
    settings = settings or FusionSettings()
    pairs = sorted(pair for pair in pairs if set(pair) <= robots.keys())
    chains = {name: keyframes(robots[name].trajectory) for name in sorted(robots) if len(robots[name].trajectory)}
    tied = {
        (a, b): ties(robots[a].map, robots[b].map, between(robots[a].placed, robots[b].placed), settings)
        for pair in pairs
        for a, b in (pair, pair[::-1])
        if set(pair) <= chains.keys()
    }
    graph = nx.Graph(pair for pair, found in tied.items() if found)
    warps: dict[str, Warp] = {}
    for names in sorted(sorted(group) for group in nx.connected_components(graph)):
        moved = _relaxed({name: chains[name] for name in names}, robots, tied)
        warps |= {name: warp(robots[name].map, chains[name].poses, moved[name]) for name in names}
    most = max((_furthest(robots[name].map, each) for name, each in warps.items()), default=0.0)
    before, after = (_agreement(robots, pairs, each, settings.tolerance_m) for each in ({}, warps))
    kept = after - before >= WORTH and most <= settings.max_bend_m
    return Joint(warps if kept else {}, before, after, most)


def _relaxed(
    chains: Mapping[str, Keyframes], robots: Mapping[str, Robot], tied: Mapping[Pair, list[Tie]]
) -> dict[str, NDArray[np.float64]]:
    """Keyframes' poses (k, 3) in their own map's frame once chains and ties have settled."""
    ends = np.cumsum([0, *(len(chain.poses) for chain in chains.values())])
    first = dict(zip(chains, ends[:-1].tolist(), strict=True))
    found = [
        (_tie(chains[a], chains[b], tie), first[a], first[b])
        for (a, b), several in sorted(tied.items())
        if a in chains and b in chains
        for tie in several
    ]
    graph = PoseGraph()
    graph.poses = np.concatenate([compose(robots[name].placed, chain.poses) for name, chain in chains.items()])
    pairs = [chain.pairs + first[name] for name, chain in chains.items()]
    graph.pairs = np.concatenate([*pairs, [(a + i, b + j) for (i, j, _, _), a, b in found]])
    graph.measured = np.concatenate([*(chain.measured for chain in chains.values()), [tie[2] for tie, _, _ in found]])
    graph.information = np.concatenate(
        [*(chain.information for chain in chains.values()), [tie[3] for tie, _, _ in found]]
    )
    graph.loops = np.zeros(len(graph.pairs), np.uint8)
    graph.loops[-len(found) :] = 1
    graph.optimise(ITERATIONS, len(found))
    return {
        name: between(robots[name].placed, graph.poses[begin:end])
        for name, begin, end in zip(chains, ends[:-1], ends[1:], strict=True)
    }


def _tie(a: Keyframes, b: Keyframes, tie: Tie) -> tuple[int, int, NDArray[np.float64], NDArray[np.float64]]:
    """Keyframe of a, keyframe of b, pose (3,) of the second in the first, and its information (3, 3) in the second."""
    i, j = a.nearest(apply(tie.pose, tie.middle[None])[0]), b.nearest(tie.middle)
    seen = compose(tie.pose, b.poses[j])
    x, y = seen[:2] - tie.pose[:2]
    lever = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    c, s = np.cos(seen[2]), np.sin(seen[2])
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ lever
    return i, j, between(a.poses[i], seen), BOTH_WAYS * np.linalg.inv(turn @ tie.covariance @ turn.T + FLOOR)


def _furthest(map_: MatchMap, warp: Warp) -> float:
    """Most metres that a wall of the map is moved by."""
    return float(np.hypot(*shifts(warp, map_.sample.points).T).max(initial=0.0))


def _agreement(
    robots: Mapping[str, Robot], pairs: Iterable[Pair], warps: Mapping[str, Warp], tolerance_m: float
) -> float:
    """Share of the walls of each map, of those that lie where the other is known, that find a wall this near."""
    agreeing = known = 0
    for pair in pairs:
        for a, b in (pair, pair[::-1]):
            target, points = robots[a].map, robots[b].map.sample.points
            if b in warps:
                points = points + shifts(warps[b], points)
            points = apply(compose(inverse(robots[a].placed), robots[b].placed), points)
            if a in warps:
                points = bent_by(warps[a], points)
            x, y = np.floor((points - target.origin) / target.resolution).astype(int).T
            inside = (x >= 0) & (y >= 0) & (x < target.occupancy.shape[1]) & (y < target.occupancy.shape[0])
            inside[inside] = target.occupancy[y[inside], x[inside]] != UNKNOWN
            known += int(inside.sum())
            agreeing += int((target.nearest.distance(y[inside], x[inside]) <= tolerance_m).sum())
    return agreeing / known if known else 0.0
