"""A plan is followed for what it is better by than noise; below that, overlap decides and SLAM stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scheduling_problems import problem

from services.scheduler.costs import Problem, predict
from services.scheduler.graph import cut, quantise
from services.scheduler.grouping import balanced_grouping
from services.scheduler.noise import Noise
from services.scheduler.policies import plan
from services.scheduler.settling import Settled, blur, settle

LOUD = {"slam": 2.0, "transfer": 2.0, "fuse": 2.0}


def two_rooms(present: list[int], **fields: object) -> Problem:
    """r0 and r1 share a room, r2 and r3 another, r4 has seen both; two edges alike."""
    weights = np.zeros((5, 5))
    for a, b, w in ((0, 1, 0.49), (2, 3, 0.48), (0, 4, 0.29), (1, 4, 0.29), (2, 4, 0.36), (3, 4, 0.36)):
        weights[a, b] = weights[b, a] = w
    alike = problem(5, 2, seed=1, spread=1.0)
    edges = np.array(present)
    given = {"weights": quantise(weights), "current_slam": edges, "current_fuse": edges.copy()}
    return replace(alike, **{**given, **fields})


def settled(this: Problem, noise: dict[str, float]) -> Settled:
    made = plan(this, "recslam", budget_s=0.05, kappa=20, tau=5)
    weights = quantise(this.weights)
    groups = balanced_grouping(weights, len(this.edges), 20, 5)
    return settle(this, weights, made.slam, made.fuse, lambda: groups, noise, 0.1, lambda: 0.0)


@pytest.mark.parametrize("present", [[0, 1, 0, 1, 0], [0, 1, 1, 0, 1], [0, 1, 0, 1, 1]])
def test_within_the_noise_robots_of_a_room_are_fused_together_and_slam_stays(present: list[int]) -> None:
    this = two_rooms(present, slam_s=np.array([0.4, 0.2, 0.3, 0.5, 0.1]))
    found = settled(this, LOUD)
    assert found.slam.tolist() == present
    assert found.fuse[0] == found.fuse[1] != found.fuse[2] == found.fuse[3]
    assert np.bincount(found.fuse, minlength=2).max() == 3, "least cut is no reason to crowd one edge"


def test_a_grouping_by_overlap_is_kept_when_measurements_differ_within_their_noise() -> None:
    rng = np.random.default_rng(0)
    present = [0, 0, 1, 1, 1]
    for _ in range(5):
        slam_s = 0.3 * np.exp(rng.normal(0, 0.3, 5))
        found = settled(two_rooms(present, slam_s=slam_s), {"slam": 0.5, "transfer": 0.3, "fuse": 0.3})
        assert (found.slam.tolist(), found.fuse.tolist()) == (present, present)
        assert found.why.startswith("kept")


def test_what_is_better_than_noise_is_done() -> None:
    slowed = two_rooms([0, 0, 1, 1, 1], speed=np.array([1.0, 0.05]), horizon=100.0)
    now = predict(slowed, slowed.current_slam, slowed.current_fuse).total
    found = settled(slowed, {"slam": 0.1, "transfer": 0.1, "fuse": 0.1})
    assert predict(slowed, found.slam, found.fuse).total < 0.5 * now
    assert (found.slam == 0).sum() > 2


def test_what_settles_is_within_the_noise_of_the_plan_or_no_worse_than_now() -> None:
    for seed in range(6):
        this = problem(9, 3, seed=seed, placed=True)
        made = plan(this, "recslam", budget_s=0.02, kappa=20, tau=5)
        noise = {"slam": 0.2, "transfer": 0.1, "fuse": 0.2}
        found = settled(this, noise)
        best = predict(this, made.slam, made.fuse)
        now = predict(this, this.current_slam, this.current_fuse).total
        bound = max(now, best.total + max(0.1 * now, blur(best, noise)))
        assert predict(this, found.slam, found.fuse).total <= bound * 1.05
        if found.why:
            weights = quantise(this.weights)
            assert cut(weights, found.fuse) <= cut(weights, this.current_fuse)


def test_noise_is_what_reports_differ_by_and_a_change_for_good_is_none() -> None:
    rng, noise = np.random.default_rng(1), Noise()
    for report in range(400):
        level = 1.0 if report < 200 else 20.0
        for robot in range(3):
            noise.took("slam", robot, level * np.exp(rng.normal(0, 0.2)))
    assert noise.shares()["slam"] == pytest.approx(0.2, rel=0.2)
    steady = Noise()
    for _ in range(9):
        steady.took("slam", "r1", 1.0)
    assert steady.shares() == {}, "the same report again tells nothing"
