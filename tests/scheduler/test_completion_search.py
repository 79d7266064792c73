"""Policy `recslam`: its fast evaluation is the prediction itself, and it is never worse than the paper's plan."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scheduling_problems import problem

from services.scheduler.completion import EVENNESS, cells_alone, cells_new, evaluate, plan_of, relocate, stages_of
from services.scheduler.costs import predict
from services.scheduler.local_search import descend, kicked_search
from services.scheduler.moves import best_move
from services.scheduler.policies import GIVEN_UP, plan
from services.scheduler.starts import edge_times, water_filled_sizes
from services.scheduler.swaps import best_swap, latest_two


def never() -> float:
    return 0.0


def steps(budget: int):
    """A clock that goes on by one with each look, so that a search ends after so many."""
    ticks = iter(range(10**9))
    return {"clock": lambda: float(next(ticks)), "budget_s": float(budget), "kappa": 100, "tau": 10}


def score(task, slam, fuse) -> float:
    prediction = predict(task, slam, fuse)
    arrivals = (prediction.edges + prediction.uploads)[np.bincount(fuse, minlength=len(task.edges)) > 0]
    return prediction.total + EVENNESS * arrivals.mean()


@settings(max_examples=40, deadline=None)
@given(
    robots=st.integers(1, 14),
    edges=st.integers(1, 5),
    seed=st.integers(0, 10**6),
    reach=st.sampled_from([0.2, 0.7, 1.0]),
    placed=st.booleans(),
)
def test_recslam_is_never_worse_than_the_paper_by_the_prediction(robots, edges, seed, reach, placed) -> None:
    task = problem(robots, edges, seed=seed, reach=reach, placed=placed)
    ours = plan(task, "recslam", **steps(30))
    assert ours.prediction.total <= plan(task, "paper", **steps(30)).prediction.total
    assert ours.prediction.total <= plan(task, "static", **steps(30)).prediction.total * (1 + GIVEN_UP)
    assert task.reachable[np.arange(robots), ours.slam].all()
    assert task.reachable[np.arange(robots), ours.fuse].all()


@pytest.mark.parametrize("seed", range(4))
def test_the_running_plan_evaluates_to_the_prediction(seed: int) -> None:
    task = problem(13, 4, seed=seed, placed=seed % 2 == 0)
    rng = np.random.default_rng(seed)
    stages = stages_of(task)
    running = plan_of(stages, rng.integers(0, 4, 13), rng.integers(0, 4, 13))
    for _ in range(30):
        relocate(stages, running, int(rng.integers(13)), int(rng.integers(4)), int(rng.integers(4)))
        total, _ = evaluate(stages, running, np.empty(4))
        assert total == pytest.approx(predict(task, running.slam, running.fuse).total, rel=1e-12)
    fresh = plan_of(stages, running.slam, running.fuse)
    for name in ("running", "maps", "covered", "cover", "crowd", "linked"):
        assert np.array_equal(getattr(fresh, name), getattr(running, name))


@pytest.mark.parametrize("seed", range(4))
def test_a_change_is_priced_as_if_it_were_made(seed: int) -> None:
    task = problem(9, 3, seed=seed, placed=True)
    rng = np.random.default_rng(seed)
    slam, fuse = rng.integers(0, 3, 9), rng.integers(0, 3, 9)
    stages, arrivals = stages_of(task), np.empty(3)
    running = plan_of(stages, slam, fuse)
    evaluate(stages, running, arrivals)
    latest, owner = latest_two(stages, running)
    mark = np.full(running.cover.shape[1], -1)
    for u in range(9):
        mark[stages.cells[stages.first[u] : stages.first[u + 1]]] = u
        alone = cells_alone(stages, running, u)
        for edge in range(3):
            added = alone if edge == fuse[u] else cells_new(stages, running, u, edge)
            found, to_slam, to_fuse = best_move(stages, running, u, edge, alone, added, arrivals, np.inf)
            if to_slam >= 0:
                moved_slam, moved_fuse = slam.copy(), fuse.copy()
                moved_slam[u], moved_fuse[u] = to_slam, to_fuse
                assert found == pytest.approx(score(task, moved_slam, moved_fuse), rel=1e-12)
            if edge != fuse[u]:
                found, v = best_swap(stages, running, u, edge, alone, added, mark, arrivals, latest, owner, np.inf)
                if v >= 0:
                    moved_slam, moved_fuse = slam.copy(), fuse.copy()
                    moved_slam[[u, v]], moved_fuse[[u, v]] = slam[[v, u]], fuse[[v, u]]
                    assert found == pytest.approx(score(task, moved_slam, moved_fuse), rel=1e-12)


def test_the_search_finds_the_best_of_all_assignments_of_a_small_problem() -> None:
    for seed in range(3):
        task = problem(6, 2, seed=seed, spread=6.0)
        every = (np.array([(code >> robot) & 1 for robot in range(6)]) for code in range(64))
        together = min(predict(task, edges, edges).total for edges in every)
        assert plan(task, "recslam", **steps(2000)).prediction.total <= together * (1 + GIVEN_UP)


def test_kicks_never_lose_what_was_found() -> None:
    task = problem(20, 4, seed=1)
    stages, start = stages_of(task), np.arange(20) % 4
    found = descend(stages, start, start, never)
    better = kicked_search(stages, found, 50, np.random.default_rng(0), never)
    assert found.total <= predict(task, start, start).total
    assert better.total <= found.total
    assert better.total == pytest.approx(predict(task, better.slam, better.fuse).total, rel=1e-12)


def test_a_faster_edge_is_given_more_robots() -> None:
    task = problem(24, 3, spread=1.0)
    task = dataclasses.replace(task, speed=np.array([0.25, 1.0, 4.0]))
    sizes = water_filled_sizes(task)
    assert sizes.sum() == 24
    assert sizes[0] < sizes[1] < sizes[2]
    assert np.bincount(plan(task, "recslam", **steps(500)).fuse, minlength=3).argmax() == 2


def test_moving_is_not_worth_a_small_gain_when_it_is_dear() -> None:
    task = problem(16, 3, seed=2, placed=True)
    dear = dataclasses.replace(task, move_cost=np.full(16, 1e4))
    cheap = dataclasses.replace(task, move_cost=np.zeros(16))
    assert np.array_equal(plan(dear, "recslam", **steps(500)).slam, task.current_slam)
    assert not np.array_equal(plan(cheap, "recslam", **steps(500)).slam, task.current_slam)


def test_placing_a_group_is_priced_like_the_prediction() -> None:
    task = problem(12, 3, seed=3, placed=True)
    task = dataclasses.replace(task, current_fuse=np.full(12, -1))
    groups = np.arange(12) % 3
    times, prediction = edge_times(task, groups), predict(task, groups, groups)
    assert np.allclose(times.diagonal(), prediction.edges + prediction.uploads, rtol=1e-12)
