"""Finding loops: the latest keyframes against finished submaps nearby, searched, refined, judged, and agreed upon.

A wrong loop ruins a map and a missed one costs little, so a loop must convince: most points next to what the
submap has hit, few in space that it saw empty, no second place that fits about as well. One that would move the
robot further than its dead reckoning can have drifted waits until others, found apart from it, say the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose
from common.geometry.pose_graph import PoseGraph
from services.edge_worker.slam.graph.branch_and_bound import search
from services.edge_worker.slam.graph.certainty import carried
from services.edge_worker.slam.graph.holders import Query, holders
from services.edge_worker.slam.graph.icp import Alignment, align
from services.edge_worker.slam.graph.keyframe import Keyframe
from services.edge_worker.slam.graph.loop import SMALL_M, Loop, consistent
from services.edge_worker.slam.graph.settings import GraphSettings
from services.edge_worker.slam.graph.submap import Submap, Target, TargetCache, evidence
from services.edge_worker.slam.scan import Points

QUERY_KEYFRAMES = 5
"""latest keyframes that are matched together"""
QUERY_SPACING = 0.1
"""m between points of one keyframe in a query"""
SEARCH_POINTS = 120
BACK_M = 0.1
"""largest correction by a loop that was not searched for: ICP leads no further"""
BACK_SPACING = 0.05
"""m between points of the one old keyframe that is looked for"""
MATCH_POINTS = 400
NEAR_M = 2.5
"""a submap this near, give or take the drift, can be seen"""
TURN_BASE, TURN_GROWTH, TURN_MAX = 0.12, 0.006, 0.6
"""rad, rad per metre since the last loop, rad: how far the heading can be off"""
MIN_OVERLAP = 0.45
"""share of a query's points that must fall where the submap has looked"""
MAX_CONFLICT = 0.12
"""share of those points that may fall into space seen empty"""
MIN_SCORE = 0.45
"""mean likelihood below which a place is not refined"""
RIVAL_SHARE = 0.93
"""a second place with this share of the best one's score makes a loop ambiguous"""
RIVAL_M = 0.6
"""m between two places"""
WITNESSES = 2
"""loops that must agree on a large correction"""
MEMORY_KEYFRAMES = 40
"""how long a loop waits for another to agree"""
BENT_M, BENT_RAD = 0.02, 0.005
"""m, rad by which a correction must move a submap's keyframes to each other for the submap to be laid out anew"""
SLID_M = 0.1
"""m by which dead reckoning must have brought a pose back along a corridor for it to be refined anew"""
FLOOR = np.diag([0.01**2, 0.01**2, 0.003**2])
"""covariance that every loop has at least: rigid submaps are not quite what they were measured as"""
SCATTER = 0.03
"""share of the points that may seem to hold a loop along a corridor and do not: one door is like another"""
NOTHING = np.diag([1e-4, 1e-4, 1e-2])
"""information that even a loop has that holds nothing: it can be inverted"""
FREE_SIGMA = (2.0, 1.0)
"""m, rad: the prior of a loop's refinement, weak enough to leave it to the points"""


@dataclass
class LoopCloser:
    """Submaps so far and loops that wait for agreement."""

    settings: GraphSettings
    submaps: list[Submap] = field(default_factory=list)
    tried: list[int] = field(default_factory=list)
    """per submap, the last keyframe that was compared with it"""
    waiting: list[Loop] = field(default_factory=list)
    travelled: float = 0.0
    """m since the last loop"""
    torn: int = 0
    """first keyframe after the last break of tracking: what came before it is not rigid with what comes after"""
    cache: TargetCache = field(default_factory=TargetCache)

    def finish_submap(self, graph: PoseGraph, last: int) -> None:
        """Make a submap of the keyframes up to `last` and of those before it."""
        size = self.settings.submap_keyframes
        members = np.arange(max(last - 2 * size + 1, self.torn), last + 1)
        anchor = int(members[len(members) // 2])
        poses = between(graph.poses[anchor], graph.poses[members])
        self.submaps.append(Submap(anchor, tuple(int(m) for m in members), poses))
        self.tried.append(-1)

    def reshape(self, graph: PoseGraph) -> None:
        """Take over what a correction of the graph did to the insides of submaps, where it is more than a hair."""
        for number, submap in enumerate(self.submaps):
            poses = between(graph.poses[submap.anchor], graph.poses[list(submap.members)])
            off = np.abs(poses - submap.poses).max(axis=0)
            if max(off[0], off[1]) > BENT_M or off[2] > BENT_RAD:
                self.submaps[number] = Submap(submap.anchor, submap.members, poses)
                self.cache.drop(number)

    def renumber(self, heir: NDArray[np.int64], number: NDArray[np.int64]) -> None:
        """Forget keyframes that are gone (not their own heirs); those that stay get new numbers (k,)."""
        submaps, tried = [], []
        for submap, last in zip(self.submaps, self.tried, strict=True):
            members = np.array(submap.members)
            stay = heir[members] == members
            if not stay.any():
                continue
            members, poses = members[stay], submap.poses[stay]
            middle = int(np.argmin(np.abs(members - submap.anchor)))
            poses = between(poses[middle], poses)
            submaps.append(Submap(int(number[members[middle]]), tuple(number[members].tolist()), poses))
            tried.append(int(number[heir[last]]) if last >= 0 else -1)
        self.submaps, self.tried, self.torn = submaps, tried, int(number[heir[self.torn]])
        self.waiting = [
            replace(
                loop,
                anchor=int(number[loop.anchor]),
                keyframe=int(number[loop.keyframe]),
                latest=int(number[heir[loop.latest]]),
            )
            for loop in self.waiting
            if heir[loop.anchor] == loop.anchor and heir[loop.keyframe] == loop.keyframe
        ]
        self.cache.clear()

    def look(self, graph: PoseGraph, keyframes: list[Keyframe]) -> list[Loop]:
        """Loops between the latest keyframe and submaps that can be trusted now, none as a rule."""
        newest = len(keyframes) - 1
        number = self._candidate(graph, newest)
        if number < 0:
            return []
        self.tried[number] = newest
        loop = self._match(graph, keyframes, newest, number)
        if loop is None:
            return []
        if loop.small:
            self._settle([loop])
            return [loop]
        return self._agreed(graph, loop)

    @property
    def drift(self) -> float:
        """m by which the pose can be off."""
        settings = self.settings
        return min(settings.loop_radius_m + settings.loop_growth * self.travelled, settings.loop_radius_max_m)

    @property
    def turn(self) -> float:
        """rad by which the heading can be off."""
        return min(TURN_BASE + TURN_GROWTH * self.travelled, TURN_MAX)

    def _candidate(self, graph: PoseGraph, newest: int) -> int:
        """The submap to compare with: near, old, and not tried lately; -1 for none."""
        old = newest - self.settings.local_keyframes
        numbers = [n for n, submap in enumerate(self.submaps) if submap.members[-1] < old]
        if not numbers:
            return -1
        anchors = graph.poses[[self.submaps[n].anchor for n in numbers]]
        away = np.hypot(*(anchors[:, :2] - graph.poses[newest, :2]).T)
        rest = newest - np.array([self.tried[n] for n in numbers])
        cost = np.where((away < NEAR_M + self.drift) & (rest > 2), away - 0.2 * np.minimum(rest, 20), np.inf)
        best = int(np.argmin(cost))
        return numbers[best] if np.isfinite(cost[best]) else -1

    def _match(self, graph: PoseGraph, keyframes: list[Keyframe], newest: int, number: int) -> Loop | None:
        submap = self.submaps[number]
        query = self._query(graph, keyframes, newest)
        if len(query.points) < self.settings.min_points * 2:
            return None
        target = self.cache.get(number, submap, keyframes)
        guess = between(graph.poses[submap.anchor], graph.poses[newest])
        found = self._place(target, query.points, guess)
        return None if found is None else self._judged(target, submap, query, guess, found)

    def look_back(self, graph: PoseGraph, keyframes: list[Keyframe]) -> list[Loop]:
        """A loop the other way round: one keyframe of long ago, of those around, seen in the latest submap."""
        if not self.submaps:
            return []
        newest, number = len(keyframes) - 1, len(self.submaps) - 1
        submap = self.submaps[number]
        old = graph.poses[: max(submap.members[0] - self.settings.local_keyframes, 0), :2]
        around = np.flatnonzero(np.hypot(*(old - graph.poses[submap.anchor, :2]).T) < NEAR_M)
        if not len(around):
            return []
        k = int(around[newest % len(around)])
        query = Query.of(range(k, k + 1), np.zeros((1, 3)), keyframes, BACK_SPACING, MATCH_POINTS)
        if len(query.points) < self.settings.min_points * 2:
            return []
        target = self.cache.get(number, submap, keyframes)
        guess = between(graph.poses[submap.anchor], graph.poses[k])
        loop = self._judged(target, submap, query, guess, guess)
        return [loop] if loop is not None and loop.correction[0] <= BACK_M and loop.small else []

    def _judged(
        self,
        target: Target,
        submap: Submap,
        query: Query,
        guess: NDArray[np.float64],
        start: NDArray[np.float64],
    ) -> Loop | None:
        """The loop that a query makes with a submap, refined from the pose `start` (3,) in it."""
        pose, alignment = self._refined(target, query, guess, start)
        if np.hypot(*(pose - alignment.pose)[:2]) > SLID_M:
            pose, alignment = self._refined(target, query, guess, pose)
        agree, conflict = evidence(target.seen, query.points, pose)
        known, size = agree + conflict, len(query.points)
        inliers = alignment.inliers * size / max(known, 1)
        if known < MIN_OVERLAP * size or conflict > MAX_CONFLICT * known:
            return None
        if inliers < self.settings.loop_inliers:
            return None
        information = alignment.information + NOTHING
        covariance = np.asarray(np.linalg.inv(information), np.float64)
        latest, nearest = holders(target, submap, query, pose, covariance, SCATTER)
        there, off = query.poses[latest], between(guess, pose)
        return Loop(
            submap.members[nearest],
            query.keyframes[latest],
            query.keyframes[-1],
            between(submap.poses[nearest], compose(pose, there)),
            np.linalg.inv(np.linalg.inv(carried(information, there)) + FLOOR),
            (float(np.hypot(off[0], off[1])), abs(float(off[2]))),
        )

    def _refined(
        self, target: Target, query: Query, guess: NDArray[np.float64], start: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], Alignment]:
        """The pose (3,) refined from `start` (3,), but as dead reckoning has it where the points hold nothing.

        Along a corridor the search ends anywhere: what it says there is no correction. And which way is along is known
        within a degree or two only: from far away, the pose must be refined anew where it has been brought back to.
        """
        alignment = align(target.surfels, query.points, query.normals, start, start, FREE_SIGMA, scatter=SCATTER)
        prior = np.diag([self.drift**-2, self.drift**-2, self.turn**-2])
        off = between(alignment.pose, guess)
        return compose(alignment.pose, np.linalg.solve(alignment.information + prior, prior @ off)), alignment

    def _query(self, graph: PoseGraph, keyframes: list[Keyframe], newest: int) -> Query:
        """The latest keyframes in the frame of the newest."""
        numbers = range(max(newest - QUERY_KEYFRAMES + 1, self.torn), newest + 1)
        poses = between(graph.poses[newest], graph.poses[numbers.start : numbers.stop])
        return Query.of(numbers, poses, keyframes, QUERY_SPACING, MATCH_POINTS)

    def _place(self, target: Target, points: Points, guess: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """The lattice pose that fits best, if it is good and nothing else is about as good."""
        sample = points[:: max(len(points) // SEARCH_POINTS, 1)]
        turn = self.turn
        step, floor, nowhere = 0.025, MIN_SCORE, np.zeros(2)
        found, score = search(target.levels, sample, guess, self.drift, turn, step, floor, nowhere, 0.0)
        if score <= floor:
            return None
        if np.hypot(*(found - guess)[:2]) > SMALL_M:
            floor = RIVAL_SHARE * score
            _, rival = search(target.levels, sample, guess, self.drift, turn, step, floor, found[:2], RIVAL_M)
            if rival > floor:
                return None
        return found

    def _agreed(self, graph: PoseGraph, loop: Loop) -> list[Loop]:
        """The loop and those that it agrees with, once they are enough; else it joins those that wait."""
        self.waiting = [old for old in self.waiting if loop.keyframe - old.keyframe < MEMORY_KEYFRAMES]
        friends = [old for old in self.waiting if consistent(graph, old, loop)]
        self.waiting.append(loop)
        if len(friends) + 1 < WITNESSES:
            return []
        self.waiting.clear()
        self._settle([*friends, loop])
        return [*friends, loop]

    def _settle(self, loops: list[Loop]) -> None:
        """Begin anew to count the drift, if a loop holds the robot in all directions: a corridor's does not."""
        if any(loop.firm for loop in loops):
            self.travelled = 0.0
