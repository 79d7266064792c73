"""How sure a scan's match is said to be."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from graph_cases import driven, robot
from numpy.typing import NDArray

from common.geometry import apply, wrap
from services.edge_worker.slam.graph.graph_slam import GraphSlam
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


def seen(*walls: Points) -> Scan:
    """A scan of these walls by a robot whose odometry tells that it has not moved."""
    beams = np.concatenate([np.arange(len(each)) + 1000 * k for k, each in enumerate(walls)]).astype(np.int32)
    points = np.concatenate(walls)
    return Scan(0.0, ORIGIN, True, points=points, beams=beams, times=np.zeros(len(points), np.float32))


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


@pytest.mark.parametrize("turned", [-0.03, 0.03])
def test_a_doubtful_match_turns_the_robot_less_than_sure_odometry_speaks_against_it(turned: float) -> None:
    off = np.array([0.0, 0.0, turned])
    aside = [each + np.float32([0.4, -0.4]) for each in CORNER]
    less = wall((2.3, 2), (-2, 2)), CORNER[1]
    doubtful = matched(seen(*CORNER), seen(*(apply(off, each).astype(np.float32) for each in (*less, *aside))))
    assert np.array_equal(doubtful.floor, DOUBTFUL_FLOOR)
    assert abs(doubtful.pose[2]) < 0.01
    sure = matched(seen(*CORNER), seen(*(apply(off, each).astype(np.float32) for each in CORNER)))
    assert sure.pose[2] == pytest.approx(-turned, abs=0.002)


@cache
def headings_off(noise: str) -> NDArray[np.float64]:
    """Rotation from keyframe to keyframe less the true one (n,), rad, of a robot without a gyro."""
    frames, truth = driven("prototype", imu=False, noise=noise), robot("prototype", imu=False, noise=noise)
    kernel, taken = GraphSlam.create({}, 0), []
    for frame in frames:
        kernel.process(frame)
        taken += [frame.stamp] * (len(kernel.keyframes) - len(taken))
    there = truth.poses(np.array(taken))
    return np.asarray(wrap(np.diff(kernel.graph.poses[:, 2]) - np.diff(there[:, 2])))


def test_what_wheels_err_by_within_a_sweep_does_not_bend_it() -> None:
    """A turn that wheels tell wrong skews what the laser sees on the way, and with it the heading at the stamp."""
    assert headings_off("worn").std() < 1.5 * headings_off("none").std() + 0.002
