"""The front end: where a scan lies in the map of the latest keyframes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.geometry import compose
from services.edge_worker.slam.correlate import correlate
from services.edge_worker.slam.graph_settings import GraphSettings
from services.edge_worker.slam.icp import Alignment, align
from services.edge_worker.slam.keyframe import Keyframe, normals, thin
from services.edge_worker.slam.scan import Points, Scan
from services.edge_worker.slam.surfels import SurfelMap

SIZE = 1024
"""cells of the local map's torus each way: 102 m, more than twice a scan's reach and the keyframes' spread"""
STALE_KEYFRAMES = 10
"""keyframes that may pile up over the window before the local map is rebuilt"""
SPACING = 0.05
"""m between the points of a scan that are matched"""
COARSE_POINTS = 90
TURN_STEP = 0.02
GOOD_INLIERS = 0.6
"""below this the match is sought again, far and wide"""
BETTER = 0.1
"""inlier share by which the wide match must be better to be believed"""
WIDE_M, WIDE_RAD, WIDE_STEP = 1.0, 0.6, 0.03
WIDE_SIGMA = (0.5, 0.5)
GUESS_M, GUESS_RAD = 0.4, 0.4
GUESS_SIGMA = (0.3, 0.3)
"""window (m, rad) and standard deviation of a motion that nothing measured"""
STILL_SIGMA = (0.01, 0.005)
"""m, rad of measured motion, however short"""
FLOOR = np.diag([0.005**2, 0.005**2, 0.002**2])
"""covariance that every matched motion has at least"""
DOUBTFUL_FLOOR = np.diag([0.1**2, 0.1**2, 0.03**2])
"""the same for a match with few inliers: another place may fit as well"""


class Match(NamedTuple):
    pose: NDArray[np.float64]
    """(3,) in the map's frame"""
    matched: bool
    information: NDArray[np.float64]
    """(3, 3) of the pose in its own frame"""


class Tracker:
    """Matches scans with the last keyframes."""

    def __init__(self, settings: GraphSettings) -> None:
        self.settings = settings
        self.local = SurfelMap(SIZE)
        self.first = 0
        """oldest keyframe in the local map"""

    def match(self, scan: Scan, pose: NDArray[np.float64]) -> Match:
        """Where the scan was taken, `pose` being where the frame before was."""
        predicted = compose(pose, scan.motion)
        moved, turned = float(np.hypot(scan.motion[0], scan.motion[1])), abs(float(scan.motion[2]))
        share = self.settings.odometry_share
        sigma = (STILL_SIGMA[0] + share * moved, STILL_SIGMA[1] + share * turned) if scan.measured else GUESS_SIGMA
        facing = normals(scan.points, scan.beams, scan.laser)
        kept = thin(scan.points, facing, SPACING, self.settings.match_points)
        if len(kept) < self.settings.min_points:
            return Match(predicted, False, _information(np.zeros((3, 3)), predicted, sigma))
        points, facing = scan.points[kept], facing[kept]
        reach = min(0.1 + 0.2 * moved, GUESS_M) if scan.measured else GUESS_M
        turn = min(0.05 + 0.2 * turned, GUESS_RAD) if scan.measured else GUESS_RAD
        found = self._align(points, facing, predicted, (reach, turn, TURN_STEP), sigma)
        if found.inliers < GOOD_INLIERS:
            found, sigma = self._search_wide(scan, pose, points, facing, found, sigma)
        if found.inliers < self.settings.min_inliers:
            return Match(predicted, False, _information(np.zeros((3, 3)), predicted, sigma))
        floor = FLOOR if found.inliers >= GOOD_INLIERS else DOUBTFUL_FLOOR
        return Match(found.pose, True, _information(found.information, found.pose, sigma, floor))

    def _search_wide(
        self,
        scan: Scan,
        pose: NDArray[np.float64],
        points: Points,
        facing: Points,
        found: Alignment,
        sigma: tuple[float, float],
    ) -> tuple[Alignment, tuple[float, float]]:
        """A better match than `found` far around, from each motion that the robot may have made, or `found`."""
        for motion in (scan.motion, *scan.alternatives):
            wide = self._align(points, facing, compose(pose, motion), (WIDE_M, WIDE_RAD, WIDE_STEP), WIDE_SIGMA)
            if wide.inliers > found.inliers + BETTER:
                found, sigma = wide, WIDE_SIGMA
            if found.inliers >= GOOD_INLIERS:
                break
        return found, sigma

    def add(self, keyframes: list[Keyframe], poses: NDArray[np.float64]) -> None:
        """Take the newest keyframe into the local map."""
        if len(keyframes) - self.first > self.settings.local_keyframes + STALE_KEYFRAMES:
            self.first = len(keyframes) - self.settings.local_keyframes
            self.rebuild(keyframes, poses)
        else:
            self.local.insert(keyframes[-1].points, keyframes[-1].normals, poses[-1])

    def rebuild(self, keyframes: list[Keyframe], poses: NDArray[np.float64]) -> None:
        """Lay the local map out anew: keyframes have moved, or some are to go."""
        self.local.clear()
        for keyframe, pose in zip(keyframes[self.first :], poses[self.first :], strict=True):
            self.local.insert(keyframe.points, keyframe.normals, pose)

    def _align(
        self,
        points: Points,
        facing: Points,
        predicted: NDArray[np.float64],
        window: tuple[float, float, float],
        sigma: tuple[float, float],
    ) -> Alignment:
        sample = points[:: max(len(points) // COARSE_POINTS, 1)]
        start, _ = correlate(self.local.field, sample, predicted, *window)
        return align(self.local, points, facing, start, predicted, sigma)


def _information(
    scan: NDArray[np.float64], pose: NDArray[np.float64], sigma: tuple[float, float], floor: NDArray[np.float64] = FLOOR
) -> NDArray[np.float64]:
    """Scan and prior together, turned from world axes into the pose's own, with `floor` added to the covariance."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    both = turn.T @ scan @ turn + np.diag([sigma[0] ** -2, sigma[0] ** -2, sigma[1] ** -2])
    return np.asarray(np.linalg.inv(np.linalg.inv(both) + floor), np.float64)
