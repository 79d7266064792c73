"""The front end: where a scan lies in the map of the latest keyframes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose
from services.edge_worker.slam.graph.certainty import alone, holds, posterior, turned
from services.edge_worker.slam.graph.correlate import correlate
from services.edge_worker.slam.graph.icp import KNOWN, Alignment, Sweep, align
from services.edge_worker.slam.graph.keyframe import Keyframe, normals, thin
from services.edge_worker.slam.graph.settings import GraphSettings
from services.edge_worker.slam.graph.surfels import SurfelMap
from services.edge_worker.slam.scan import Points, Scan

SIZE = 1024
"""cells of the local map's torus each way: 102 m, more than twice a scan's reach and the keyframes' spread"""
STALE_KEYFRAMES = 10
"""keyframes that may pile up over the window before the local map is rebuilt"""
SPACING = 0.05
"""m between the points of a scan that are matched, on average"""
COARSE_POINTS = 90
TURN_STEP = 0.02
GOOD_INLIERS = 0.6
"""below this the match is sought again, far and wide"""
BETTER = 0.1
"""inlier share by which the wide match must be better to be believed"""
MUCH_BETTER = 0.3
"""the same where it contradicts the odometry: a scan of new places agrees with more of the map where it is not"""
SAME_PLACE = (0.1, 0.1, 0.01)
"""m, m, rad: a wide match that ends nearer than this to the first one has found no other place"""
WIDE_WINDOW = (1.0, 0.6, 0.03)
WIDE_SIGMA = (0.5, 0.5)
GUESS_M, GUESS_RAD = 0.4, 0.4
GUESS_SIGMA = (0.3, 0.3)
"""window (m, rad) and standard deviation of a motion that nothing measured"""
SLIP_SIGMA = (0.3, 0.8)
TURN_SLIP_MEASURED = 0.02
"""m/s, rad/s by which the velocity in a sweep differs from that between the scans; the turn, from the gyro's"""
SHORTEST_S, LONGEST_S = 0.02, 0.6
"""s between scans that tell a velocity"""
STILL_SIGMA = (0.01, 0.005)
"""m, rad of measured motion, however short"""
GYRO_SIGMA = 0.001
"""rad of any rotation that a gyro measured"""
SWERVE = 0.05
"""rad per metre, standard deviation of odometry's heading: turns that cancel out between two scans err all the same"""
FLOOR = np.diag([0.005**2, 0.005**2, 0.002**2])
"""covariance that every matched motion has at least"""
DOUBTFUL_FLOOR = np.diag([0.1**2, 0.1**2, 0.03**2])
"""the same for a match with few inliers where another place fits about as well; else it only sees much that is new"""


class Match(NamedTuple):
    pose: NDArray[np.float64]
    """(3,) in the map's frame"""
    matched: bool
    covariance: NDArray[np.float64]
    """(3, 3) of the pose, against the last keyframe, in its own frame"""
    floor: NDArray[np.float64] = FLOOR
    """(3, 3) covariance to be added to that, as matches err alike"""
    slip: NDArray[np.float64] | None = None
    """(3,) what a guessed velocity was off by during the sweep, m/s, m/s, rad/s; None where it was not guessed"""
    firm: bool = False
    """the scan alone says how far the robot went"""
    heading_sigma: float = np.inf
    """rad, standard deviation of the heading by the scan alone"""


class Query(NamedTuple):
    """The points of a scan that are matched."""

    points: Points
    normals: Points
    sweep: Sweep


class Tracker:
    """Matches scans with the last keyframes."""

    def __init__(self, settings: GraphSettings) -> None:
        self.settings = settings
        self.local = SurfelMap(SIZE)
        self.first = 0
        """oldest keyframe in the local map"""

    def match(self, scan: Scan, pose: NDArray[np.float64], slack: NDArray[np.float64]) -> Match:
        """Where the scan was taken; the frame before was at `pose`, with covariance `slack` (3, 3) in its own frame."""
        slack = turned(slack, scan.motion[2])
        facing = normals(scan.points, scan.beams, scan.laser)
        kept = thin(scan.points, facing, scan.laser, SPACING, self.settings.match_points)
        predicted, (window, prior) = compose(pose, scan.motion), self._uncertainty(scan)
        lost = Match(predicted, False, posterior(np.zeros((3, 3)), prior, slack))
        if len(kept) < self.settings.min_points:
            return lost
        guessed = scan.velocity is not None and bool(scan.times.any())
        query = Query(scan.points[kept], facing[kept], self._sweep(scan, kept, pose) if guessed else KNOWN)
        found, sigma, unrivalled = self._found(query, scan, pose, window, prior)
        if found.inliers < self.settings.min_inliers:
            return lost
        good, known = found.inliers >= GOOD_INLIERS, alone(found.information)
        return Match(
            found.pose,
            True,
            posterior(found.information, sigma, slack),
            FLOOR if good or unrivalled else DOUBTFUL_FLOOR,
            found.slip if good and guessed else None,
            good and holds(known, scan.motion),
            float(np.sqrt(known[2, 2] + FLOOR[2, 2])),
        )

    def _found(
        self,
        query: Query,
        scan: Scan,
        pose: NDArray[np.float64],
        window: tuple[float, float, float],
        prior: tuple[float, float],
    ) -> tuple[Alignment, tuple[float, float], bool]:
        """The best match near where dead reckoning has the scan, or far and wide where that is poor.

        With it the standard deviation (m, rad) of where it was looked for, and whether a wide search ended there, too.
        """
        found, sigma, unrivalled = self._align(query, compose(pose, scan.motion), window, prior), prior, False
        if found.inliers >= GOOD_INLIERS:
            return found, sigma, unrivalled
        for k, motion in enumerate((scan.motion, *scan.alternatives)):
            wide = self._align(query, compose(pose, motion), WIDE_WINDOW, WIDE_SIGMA)
            if wide.inliers > found.inliers + (BETTER if k == 0 else MUCH_BETTER):
                found, sigma, unrivalled = wide, WIDE_SIGMA, False
            elif k == 0:
                unrivalled = bool((np.abs(between(found.pose, wide.pose)) < SAME_PLACE).all())
            if found.inliers >= GOOD_INLIERS:
                break
        return found, sigma, unrivalled

    def _sweep(self, scan: Scan, kept: NDArray[np.int64], pose: NDArray[np.float64]) -> Sweep:
        """How the motion in this sweep was guessed."""
        assert scan.velocity is not None
        rate = 1.0 / scan.dt if SHORTEST_S <= scan.dt <= LONGEST_S else 0.0
        rates = np.array([rate, rate, 0.0 if scan.turn_measured else rate])
        sigma = (SLIP_SIGMA[0], TURN_SLIP_MEASURED if scan.turn_measured else SLIP_SIGMA[1])
        return Sweep(scan.times[kept], scan.velocity, pose, rates, sigma)

    def _uncertainty(self, scan: Scan) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Search window (m, rad, step in rad) and standard deviation (m, rad) of the scan's predicted motion."""
        moved, turned = float(np.hypot(scan.motion[0], scan.motion[1])), abs(float(scan.motion[2]))
        share = self.settings.odometry_share
        reach, sigma_m = GUESS_M, GUESS_SIGMA[0]
        if scan.measured:
            reach = min(0.1 + 0.2 * moved + scan.surge, GUESS_M)
            sigma_m = STILL_SIGMA[0] + share * moved + scan.surge
        turn, sigma_rad = GUESS_RAD, GUESS_SIGMA[1]
        if scan.turn_measured:
            turn, sigma_rad = min(0.05 + 0.2 * turned, GUESS_RAD), GYRO_SIGMA + scan.turn_sigma
        elif scan.measured:
            swerve = SWERVE * moved
            turn, sigma_rad = min(0.05 + 0.2 * turned + 2 * swerve, GUESS_RAD), STILL_SIGMA[1] + share * turned + swerve
        return (reach, turn, TURN_STEP), (sigma_m, sigma_rad)

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
        query: Query,
        predicted: NDArray[np.float64],
        window: tuple[float, float, float],
        sigma: tuple[float, float],
    ) -> Alignment:
        sample = query.points[:: max(len(query.points) // COARSE_POINTS, 1)]
        start, _ = correlate(self.local.field, sample, predicted, *window)
        return align(self.local, query.points, query.normals, start, predicted, sigma, query.sweep)
