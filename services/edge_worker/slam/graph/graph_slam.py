"""Graph SLAM: scans tracked in a sliding local map, keyframes in a pose graph, loops through submaps.

Per frame: dead reckoning predicts, a correlative search makes the prediction safe, point-to-line ICP makes it
exact. Per keyframe: the local map grows, a loop is looked for. Loops correct the graph, and everything that
hangs on keyframes (local map, robot map, trajectory) follows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose
from common.geometry.pose_graph import PoseGraph
from common.grid import Grid
from common.wire import Frame
from services.edge_worker.slam.corrections import Corrections
from services.edge_worker.slam.graph import snapshot, thinning
from services.edge_worker.slam.graph.keyframe import Keyframe, View
from services.edge_worker.slam.graph.loop_closer import LoopCloser
from services.edge_worker.slam.graph.rendering import Rendering
from services.edge_worker.slam.graph.settings import GraphSettings
from services.edge_worker.slam.graph.tracker import Match, Tracker
from services.edge_worker.slam.graph.trajectory import Trajectory
from services.edge_worker.slam.kernel import Estimate
from services.edge_worker.slam.scan import Scan, ScanReader, unslipped
from services.edge_worker.slam.settings import read_settings

OPTIMISE_EVERY = 20
"""loops between optimisations, if none moves much; every other one, as a rule, looks back"""
MOVES_M, MOVES_RAD = 0.1, 0.02
"""a loop that moves its keyframe further is worked in at once"""
ITERATIONS = 2
FINAL_ITERATIONS = 15
THIN_SHARE = 0.1
"""of the keyframes, dropped at once when there are too many"""
LOST_SHARE = 5.0
"""keyframe distances that dead reckoning bridges before a scan without a match becomes a keyframe"""
VIEWS = 2
"""scans between two keyframes that are drawn as well, evenly spread: far walls need more looks than matching does"""


class GraphSlam:
    """One robot's SLAM; keeps services.edge_worker.slam.kernel.Kernel."""

    def __init__(self, settings: GraphSettings) -> None:
        self.settings = settings
        self.reader = ScanReader(settings.range_m, settings.clear_m)
        self.tracker = Tracker(settings)
        self.graph = PoseGraph()
        self.keyframes: list[Keyframe] = []
        self.views: list[View] = []
        """of scans since the last keyframe, in its frame; they will hang on the next one"""
        self.closer = LoopCloser(settings)
        self.rendering = Rendering(settings.resolution_m)
        self.track = Trajectory()
        self.pose = np.zeros(3)
        self.slack = np.zeros((3, 3))
        """covariance of the pose against the last keyframe, in the robot's frame"""
        self.pending = 0
        """loops that wait for an optimisation"""

    @classmethod
    def create(cls, settings: Mapping[str, Any], seed: int) -> GraphSlam:
        """A new kernel; `seed` is not used, as nothing is random. Raises ConfigError naming the field."""
        return cls(read_settings(GraphSettings, settings))

    @property
    def corrections(self) -> Corrections:
        return self.rendering.corrections

    def process(self, frame: Frame) -> Estimate:
        scan = self.reader.read(frame)
        if not self.keyframes:
            self._add_keyframe(scan, None)
            self.track.append(scan.stamp, 0, np.zeros(3))
            return Estimate(self.pose.copy(), len(scan.points) >= self.settings.min_points)
        match = self.tracker.match(scan, self.pose, self.slack)
        self.slack = match.covariance
        motion = between(self.pose, match.pose)
        self.reader.reckoning.learn(motion, match.matched, match.firm, match.heading_sigma)
        self.pose = match.pose
        if match.slip is not None:
            self.reader.reckoning.slipped(match.slip)
            scan = unslipped(scan, match.slip)
        moved = self._moved(match)
        if moved > (1.0 if match.matched else LOST_SHARE):
            self._add_keyframe(scan, match)
            self._close_loops()
            if len(self.keyframes) > self.settings.max_keyframes:
                self._thin()
        elif match.matched and len(self.views) < VIEWS and moved > (len(self.views) + 1) / (VIEWS + 1):
            self.views.append(View.of(scan, between(self.graph.poses[-1], self.pose)))
        newest = len(self.keyframes) - 1
        self.track.append(scan.stamp, newest, between(self.graph.poses[newest], self.pose))
        return Estimate(self.pose.copy(), match.matched)

    def finish(self) -> None:
        self._correct(FINAL_ITERATIONS)

    def prepare(self, seconds: float) -> bool:
        return self.rendering.prepare(self.keyframes, self.graph.poses, seconds)

    def map(self) -> Grid:
        return self.rendering.update(self.keyframes, self.graph.poses)

    def trajectory(self) -> NDArray[np.float64]:
        return self.track.rows(self.graph.poses)

    def snapshot(self) -> bytes:
        return snapshot.write(self)

    def restore(self, data: bytes) -> None:
        snapshot.read(data, self)

    def _moved(self, match: Match) -> float:
        """Share of a keyframe's distance that lies behind: at 1 a scan becomes one.

        A scan that did not match must not fork the map before it has to.
        """
        moved = between(self.graph.poses[-1], match.pose)
        share = max(np.hypot(moved[0], moved[1]) / self.settings.keyframe_m, abs(moved[2]) / self.settings.keyframe_rad)
        return float(share)

    def _add_keyframe(self, scan: Scan, match: Match | None) -> None:
        back = between(self.pose, self.graph.poses[-1]) if match is not None else np.zeros(3)
        keyframe = Keyframe.of(scan, [replace(view, pose=compose(back, view.pose)) for view in self.views])
        self.views = []
        node = self.graph.add_node(self.pose)
        self.keyframes.append(keyframe)
        if match is not None:
            measured = between(self.graph.poses[node - 1], self.pose)
            information = np.asarray(np.linalg.inv(match.covariance + match.floor), np.float64)
            self.graph.add_edge(node - 1, node, measured, information, loop=False)
            self.slack = np.zeros((3, 3))
            self.closer.travelled += float(np.hypot(measured[0], measured[1]))
            if not match.matched:
                self.closer.torn = node
        self.tracker.add(self.keyframes, self.graph.poses)
        if len(self.keyframes) % self.settings.submap_keyframes == 0:
            self.closer.finish_submap(self.graph, node)

    def _close_loops(self) -> None:
        loops = self.closer.look(self.graph, self.keyframes)
        loops += self.closer.look_back(self.graph, self.keyframes)
        for loop in loops:
            self.graph.add_edge(loop.anchor, loop.keyframe, loop.measured, loop.information, loop=True)
        self.pending += len(loops)
        far = any(loop.correction[0] > MOVES_M or loop.correction[1] > MOVES_RAD for loop in loops)
        if far or self.pending >= OPTIMISE_EVERY:
            self._correct(ITERATIONS)

    def _correct(self, iterations: int) -> None:
        if not self.keyframes or not self.pending:
            return
        relative, before = between(self.graph.poses[-1], self.pose), self.graph.poses.copy()
        self.graph.optimise(iterations, self.pending)
        refuted = self.graph.drop_refuted(self.pending)
        if refuted:
            # Rooms alike, say, that were taken for one: what they had pulled at must come back as if they never were.
            self.graph.poses = before
            if refuted < self.pending:
                self.graph.optimise(iterations, self.pending - refuted)
        self.pose = compose(self.graph.poses[-1], relative)
        self.tracker.rebuild(self.keyframes, self.graph.poses)
        self.closer.reshape(self.graph)
        self.pending = 0

    def _thin(self) -> None:
        """Drop a share of the keyframes outside the local map, and have others take over what hangs on them."""
        self._correct(ITERATIONS)
        gone = thinning.crowded(self.graph.poses[: self.tracker.first], int(THIN_SHARE * len(self.keyframes)))
        heir = thinning.heirs(len(self.keyframes), gone)
        number = thinning.numbers(heir)
        self.rendering.forget(self.keyframes, gone)
        self.track.rehang(self.graph.poses, heir, number)
        self.closer.renumber(heir, number)
        thinning.eliminate(self.graph, heir)
        self.keyframes = [self.keyframes[k] for k in np.flatnonzero(heir == np.arange(len(heir)))]
        self.tracker.first -= len(gone)
