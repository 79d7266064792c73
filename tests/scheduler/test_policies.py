"""What holds for every policy."""

from __future__ import annotations

import numpy as np
import pytest
from scheduling_problems import problem

from common.errors import ConfigError, UsageError
from services.scheduler.policies import POLICIES, plan

SETTINGS = {"budget_s": 0.05, "kappa": 100, "tau": 10}


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(("robots", "edges"), [(0, 2), (1, 1), (2, 5), (9, 3), (16, 4)])
def test_no_plan_names_an_edge_out_of_reach(policy: str, robots: int, edges: int) -> None:
    for reach in (1.0, 0.6, 0.1):
        for placed in (False, True):
            task = problem(robots, edges, seed=robots + 7, reach=reach, placed=placed)
            assignment = plan(task, policy, **SETTINGS)
            rows = np.arange(robots)
            assert assignment.slam.shape == assignment.fuse.shape == (robots,)
            assert task.reachable[rows, assignment.slam].all()
            assert task.reachable[rows, assignment.fuse].all()


@pytest.mark.parametrize("policy", POLICIES)
def test_the_same_problem_and_seed_give_the_same_plan(policy: str) -> None:
    task = problem(12, 3, seed=4, placed=True)
    steps = iter(range(10**9))
    first = plan(task, policy, budget_s=1e9, kappa=50, tau=5, seed=3, clock=lambda: 1e7 * next(steps))
    steps = iter(range(10**9))
    again = plan(task, policy, budget_s=1e9, kappa=50, tau=5, seed=3, clock=lambda: 1e7 * next(steps))
    assert np.array_equal(first.slam, again.slam)
    assert np.array_equal(first.fuse, again.fuse)
    assert first.prediction.total == again.prediction.total
    assert first.reason == again.reason


def test_an_unknown_policy_is_refused_by_the_name_of_its_setting() -> None:
    with pytest.raises(ConfigError, match=r"scheduler\.policy.*'best'.*paper"):
        plan(problem(3, 2), "best", **SETTINGS)


def test_a_robot_that_reaches_no_edge_is_named() -> None:
    task = problem(3, 2)
    blocked = task.reachable.copy()
    blocked[1] = False
    with pytest.raises(UsageError, match="r1 reaches no edge"):
        type(task)(**{**task.__dict__, "reachable": blocked})


def test_paper_runs_and_fuses_each_robot_on_one_edge_in_equal_groups() -> None:
    assignment = plan(problem(17, 4), "paper", **SETTINGS)
    assert np.array_equal(assignment.slam, assignment.fuse)
    assert sorted(np.bincount(assignment.fuse)) == [4, 4, 4, 5]


def test_static_leaves_everybody_where_they_are() -> None:
    task = problem(10, 3, placed=True)
    assignment = plan(task, "static", **SETTINGS)
    assert np.array_equal(assignment.slam, task.current_slam)
