"""How many pairs are searched, and which, whatever a search costs: on fleets whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from common.fusion.cycles import Pair
from common.fusion.pairs import all_pairs
from common.fusion.settings import FusionSettings
from common.fusion.solve import solve
from common.fusion.survey import TRIES, survey
from common.fusion.verdicts import measurements
from common.geometry import between, compose
from common.geometry.se2 import Pose
from common.wire.edge import PairVerdict, VerdictKind

REACH_M = 12.5
"""robots nearer than this share something"""


@dataclass
class Fleet:
    """Robots at known places; what is alike, and what a search says, follows from how near they are."""

    poses: dict[str, Pose]
    lies: dict[Pair, Pose] = field(default_factory=dict)
    """what a search says although it is wrong"""
    searched: list[Pair] = field(default_factory=list)

    def shares(self, pair: Pair) -> bool:
        return bool(np.linalg.norm(self.poses[pair[0]][:2] - self.poses[pair[1]][:2]) < REACH_M)

    def likeness(self, pair: Pair) -> int:
        return 40 if self.shares(pair) or pair in self.lies else 3

    def pass_over(self, pair: Pair) -> PairVerdict:
        return told(pair, None)

    def verify(self, pair: Pair, pose: Pose) -> PairVerdict | None:
        near = np.hypot(pose[0], pose[1]) < REACH_M
        right = np.allclose(pose, between(self.poses[pair[0]], self.poses[pair[1]]), atol=0.3)
        if near and self.shares(pair) and right:
            return told(pair, pose)
        return None if near or self.likeness(pair) > 30 else told(pair, None)

    def search(self, pair: Pair) -> PairVerdict:
        self.searched.append(pair)
        truth = between(*(self.poses[robot] for robot in pair)) if self.shares(pair) else None
        return told(pair, self.lies.get(pair, truth), searched=True)


def told(pair: Pair, pose: Pose | None, *, searched: bool = False) -> PairVerdict:
    kind: VerdictKind = "no_overlap" if pose is None else "merged"
    transform = None if pose is None else (float(pose[0]), float(pose[1]), float(pose[2]))
    return PairVerdict(a=pair[0], b=pair[1], kind=kind, versions=(1, 1), transform=transform, searched=searched)


def line(robots: int, spacing_m: float) -> Fleet:
    rng = np.random.default_rng(robots)
    return Fleet({f"r{k:02}": np.array([spacing_m * k, 0.0, rng.uniform(-3, 3)]) for k in range(robots)})


def surveyed(fleet: Fleet) -> dict[Pair, PairVerdict]:
    return survey(all_pairs(fleet.poses), fleet, FusionSettings())


@pytest.mark.parametrize("robots", [6, 12, 24])
@pytest.mark.parametrize("spacing_m", [1.0, 5.0, 10.0])
def test_a_fleet_that_hangs_together_takes_a_search_a_robot(robots: int, spacing_m: float) -> None:
    fleet = line(robots, spacing_m)
    found = surveyed(fleet)
    assert len(fleet.searched) == robots - 1
    assert len(found) == robots * (robots - 1) // 2
    assert all((verdict.kind == "merged") == fleet.shares(pair) for pair, verdict in found.items())


def test_robots_that_nothing_joins_get_a_few_searches_each() -> None:
    fleet = line(24, 50.0)
    found = surveyed(fleet)
    assert 12 * TRIES <= len(fleet.searched) <= 24 * TRIES
    assert {verdict.kind for verdict in found.values()} == {"no_overlap"}


def test_small_fleets_are_searched_wholly_when_nothing_joins_them() -> None:
    fleet = line(4, 50.0)
    surveyed(fleet)
    assert fleet.searched == all_pairs(fleet.poses)


def test_a_lie_is_found_by_what_it_puts_together_and_what_it_tears_apart() -> None:
    for liar in [("r01", "r02"), ("r00", "r05"), ("r02", "r03")]:
        fleet = line(6, 5.0)
        fleet.lies[liar] = compose(between(*(fleet.poses[robot] for robot in liar)), (9.0, -4.0, 1.0))
        (component,) = solve(sorted(fleet.poses), measurements(surveyed(fleet).values()))
        for robot in fleet.poses:
            truth = between(fleet.poses["r00"], fleet.poses[robot])
            assert component.transforms[robot] == pytest.approx(truth, abs=0.05)


def test_what_was_searched_before_is_not_searched_again() -> None:
    fleet = line(6, 5.0)
    first = surveyed(fleet)
    fleet.searched.clear()
    kept = {pair: verdict for pair, verdict in first.items() if verdict.searched}
    assert survey(all_pairs(fleet.poses), fleet, FusionSettings(), kept=kept) == first
    assert fleet.searched == []
