"""Fusing together what overlaps, where it costs next to nothing."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scheduling_problems import problem

from services.scheduler.costs import predict
from services.scheduler.graph import cut
from services.scheduler.policies import plan
from services.scheduler.regrouping import closer


@pytest.mark.parametrize("seed", range(6))
def test_the_cut_falls_and_the_time_stays_within_its_bound_and_reach(seed: int) -> None:
    task = problem(12, 3, seed=seed, reach=0.7)
    fuse = np.array([np.flatnonzero(row)[seed % row.sum()] for row in task.reachable])
    bound = predict(task, fuse, fuse).total * 1.1
    closest = closer(task, task.weights, fuse, fuse, bound, lambda: 0.0)
    assert cut(task.weights, closest) <= cut(task.weights, fuse)
    assert predict(task, fuse, closest).total <= bound
    assert task.reachable[np.arange(12), closest].all()


def test_nothing_is_left_that_one_move_or_swap_would_better() -> None:
    task = problem(7, 2, seed=3)
    start = np.arange(7) % 2
    closest = closer(task, task.weights, start, start, np.inf, lambda: 0.0)
    least = cut(task.weights, closest)
    for robot in range(7):
        tried = closest.copy()
        tried[robot] = 1 - tried[robot]
        assert cut(task.weights, tried) >= least - 1e-9
    for one, two in itertools.combinations(range(7), 2):
        tried = closest.copy()
        tried[one], tried[two] = closest[two], closest[one]
        assert cut(task.weights, tried) >= least - 1e-9


def test_two_rooms_on_fast_links_are_fused_room_by_room() -> None:
    rooms = np.zeros((4, 4))
    rooms[0, 2] = rooms[2, 0] = rooms[1, 3] = rooms[3, 1] = 0.4
    task = problem(4, 2, seed=0, spread=1.0)
    floor = np.arange(100)
    cells = (floor, floor + 1000, floor + 20, floor + 1020)
    task = dataclasses.replace(task, weights=rooms, footprints=cells, edge_bandwidth=np.full(2, 1.25e8))
    made = plan(task, "recslam", budget_s=1.0, kappa=100, tau=10)
    assert made.fuse[0] == made.fuse[2] != made.fuse[1] == made.fuse[3]


@pytest.mark.parametrize("seed", range(4))
def test_what_is_given_up_never_makes_it_worse_than_the_papers_plan(seed: int) -> None:
    task = problem(10, 3, seed=seed)
    ours = plan(task, "recslam", budget_s=0.5, kappa=100, tau=10).prediction.total
    paper = plan(task, "paper", budget_s=0.5, kappa=100, tau=10).prediction.total
    assert ours <= paper * (1 + 1e-12)
