"""How sure a scan's match is said to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.edge_worker.slam.graph.keyframe import Keyframe
from services.edge_worker.slam.graph.settings import GraphSettings
from services.edge_worker.slam.graph.tracker import DOUBTFUL_FLOOR, FLOOR, GOOD_INLIERS, Match, Tracker
from services.edge_worker.slam.scan import Points, Scan

ORIGIN = np.zeros(3)
SPACING = 0.05


def wall(start: tuple[float, float], end: tuple[float, float]) -> Points:
    """Points (n, 2) along a wall."""
    n = round(np.hypot(end[0] - start[0], end[1] - start[1]) / SPACING)
    return np.linspace(start, end, n, dtype=np.float32)


def seen(*walls: Points, moved: NDArray[np.float64] = ORIGIN) -> Scan:
    """A scan of these walls by a robot whose odometry tells that it has `moved` (3,)."""
    beams = np.concatenate([np.arange(len(each)) + 1000 * k for k, each in enumerate(walls)]).astype(np.int32)
    points = np.concatenate(walls)
    return Scan(0.0, moved, True, points=points, beams=beams, times=np.zeros(len(points), np.float32))


def matched(known: Scan, scan: Scan) -> Match:
    tracker = Tracker(GraphSettings())
    tracker.add([Keyframe.of(known)], ORIGIN[None])
    return tracker.match(scan, ORIGIN, np.zeros((3, 3)))


CORNER = wall((3, 2), (-2, 2)), wall((-2, 2), (-2, -1))
BEYOND = wall((-7, 4), (-7, -3.5))


def test_a_scan_that_sees_much_that_is_new_is_as_sure_as_what_it_knows_again() -> None:
    match = matched(seen(*CORNER), seen(*CORNER, BEYOND))
    assert match.matched
    assert np.abs(match.pose).max() < 0.01
    assert 0.4 < sum(map(len, CORNER)) / sum(map(len, (*CORNER, BEYOND))) < GOOD_INLIERS
    assert np.array_equal(match.floor, FLOOR)


def test_a_scan_that_fits_about_as_well_in_another_place_is_doubtful() -> None:
    aside = [each + np.float32([0.4, -0.4]) for each in CORNER]
    less = wall((2.3, 2), (-2, 2)), CORNER[1]
    match = matched(seen(*CORNER), seen(*less, *aside))
    assert match.matched
    assert np.array_equal(match.floor, DOUBTFUL_FLOOR)
