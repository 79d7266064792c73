"""Joint correction straightens maps that no rigid placement fits, and leaves alone what it cannot better."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from drawn_worlds import apartment, mapped
from numpy.typing import NDArray
from test_bend import AWAY, HOME, WIDTH_M, drifted

from common.fusion.joint import Joint, Robot, correct
from common.fusion.keyframes import keyframes
from common.fusion.settings import FusionSettings
from common.geometry import between, compose
from common.grid.warp import straightened

CURVATURE = 0.003
MIDDLE_M = 5.0


def way(curvature: float) -> NDArray[np.float64]:
    """(n, 3) poses along the building and back, as a robot takes them for whose heading drifts."""
    there = np.linspace(2.0, WIDTH_M - 2.0, 200)
    x, theta = np.r_[there, there[::-1]], np.r_[np.zeros(200), np.full(200, np.pi)]
    along = np.maximum(x - WIDTH_M / 2, 0)
    return np.stack([x, MIDDLE_M - 0.5 * curvature * along**2, theta - curvature * along], axis=1)


def robot(curvature: float, frame: NDArray[np.float64], seed: int) -> Robot:
    world = apartment(3, width_m=WIDTH_M)
    map_ = mapped(drifted(world, curvature) if curvature else world, frame, seed=seed)
    poses = between(frame, way(curvature))
    return Robot(map_, np.column_stack([np.arange(len(poses)) / 2, poses]), frame)


def gaps(robots: Mapping[str, Robot], joint: Joint) -> NDArray[np.float64]:
    """(n,) m between where two robots that were at one place believe to have been."""
    ants, bees = (
        compose(robots[name].placed, straightened(joint.warps.get(name), robots[name].trajectory[:, 1:]))
        for name in ("ant", "bee")
    )
    return np.asarray(np.hypot(*(ants - bees)[:, :2].T))


@pytest.fixture(scope="module")
def bent() -> dict[str, Robot]:
    return {"ant": robot(0.0, HOME, 1), "bee": robot(CURVATURE, AWAY, 2)}


@pytest.fixture(scope="module")
def corrected(bent: dict[str, Robot]) -> Joint:
    return correct(bent, [("ant", "bee")])


def test_a_bent_map_is_straightened_onto_the_other(bent: dict[str, Robot], corrected: Joint) -> None:
    rigid = gaps(bent, Joint({}, 0.0, 0.0, 0.0))
    assert rigid.max() > 0.4
    assert gaps(bent, corrected).max() < 0.1
    assert corrected.after - corrected.before > 0.05


def test_the_order_of_robots_and_pairs_does_not_matter(bent: dict[str, Robot], corrected: Joint) -> None:
    cat = Robot(mapped(apartment(9), HOME), bent["ant"].trajectory, np.array([500.0, 0.0, 0.0]))
    shuffled = {"cat": cat, **dict(reversed(bent.items()))}
    again = correct(shuffled, [("bee", "cat"), ("ant", "bee")])
    assert again.warps == corrected.warps, "a robot that overlaps with nobody must change nothing"


def test_robots_without_a_common_wall_stay_as_they_are(bent: dict[str, Robot]) -> None:
    apart = {"ant": bent["ant"], "bee": bent["bee"]._replace(placed=np.array([500.0, 0.0, 0.0]))}
    assert correct(apart, [("ant", "bee")]) == Joint({}, 0.0, 0.0, 0.0)
    assert correct(bent, []).warps == {}


def test_a_correction_beyond_what_drift_can_do_is_taken_back(bent: dict[str, Robot]) -> None:
    strict = correct(bent, [("ant", "bee")], FusionSettings(max_bend_m=0.05))
    assert strict.warps == {}
    assert "rigid transforms stay" in strict.told


def test_straight_maps_are_left_alone() -> None:
    straight = {"ant": robot(0.0, HOME, 1), "bee": robot(0.0, AWAY, 2)}
    joint = correct(straight, [("ant", "bee")])
    assert joint.warps == {}
    assert joint.moved_m < 0.05


def test_keyframes_follow_the_way_and_hold_where_it_comes_back() -> None:
    found = keyframes(np.column_stack([np.arange(400) / 2, way(0.0)]))
    assert 0.4 < 72.0 / len(found.poses) < 0.6
    chain, again = found.pairs[: len(found.poses) - 1], found.pairs[len(found.poses) - 1 :]
    assert (np.diff(chain, axis=1) == 1).all()
    away = found.poses[again[:, 0], :2] - found.poses[again[:, 1], :2]
    assert len(again) > 20
    assert np.median(np.hypot(*away.T)) < 0.3
    assert keyframes(np.array([[1.0, 2.0, 3.0, 0.5]])).pairs.shape == (0, 2)
