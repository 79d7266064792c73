"""Completion times of the policies on many instances, as predicted and as they turn out.

`truth` is the world that the predictor does not know: every stage takes up to 30 % more or less time than it thinks.
Budgets are CPU seconds.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bench.results import show
from bench.scheduler_graphs import REGIMES, problem
from services.scheduler.costs import Problem, predict
from services.scheduler.graph import quantise
from services.scheduler.grouping import balanced_grouping
from services.scheduler.policies import Assignment, Settings, least_time, plan

KAPPA, TAU = 100, 10
SIZES = ((6, 3), (10, 3), (20, 4), (50, 5), (50, 8))
"""robots, edges"""
UNEQUAL = ((1, 1), (2, 5), (4, 10), (8, 20))
"""by what factor edges' speeds, and links, differ at most"""
COMPARED = ("random", "random-balanced", "greedy", "static", "paper-printed", "paper", "recslam")
ORDER = ("recslam", "paper", "greedy", "random")
"""from what should be the quickest to the slowest"""
SAMPLE = 10
"""every so manieth instance is searched for long"""
LONG_S = 1.0


class Scored(NamedTuple):
    """What one instance has shown of one policy."""

    predicted: float
    true: float
    stages: Counter[str]
    """seconds of each stage on the true critical path"""


def budget_s(robots: int) -> float:
    """CPU seconds that `recslam` may search for."""
    return 0.05 if robots <= 20 else 0.15


def planned(task: Problem, policy: str, budget: float, seed: int) -> Assignment:
    return plan(task, policy, budget_s=budget, kappa=KAPPA, tau=TAU, seed=seed, clock=time.process_time)


def completion(tasks: int = 100) -> list[dict[str, Any]]:
    """Mean t_c of each policy over that of recslam, and how often it is out of order, on `tasks` instances a cell."""
    rows = []
    for (robots, edges), (speeds, links) in itertools.product(SIZES, UNEQUAL):
        found = [measured(robots, edges, speeds, links, number) for number in range(tasks)]
        scores = {name: [scored[name] for scored, _ in found] for name in COMPARED}
        long = [(scored, best) for scored, best in found if best is not None]
        rows.append(
            {
                "robots": robots,
                "edges": edges,
                "speeds": speeds,
                "links": links,
                "tasks": tasks,
                "true": {name: _mean_over(each, scores["recslam"], "true") for name, each in scores.items()},
                "predicted": {name: _mean_over(each, scores["recslam"], "predicted") for name, each in scores.items()},
                "over_best": {
                    name: float(np.median([scored[name].predicted / best for scored, best in long]))
                    for name in COMPARED
                },
                "out_of_order": {
                    f"{one} > {two}": out_of_order(scores[one], scores[two]) for one, two in itertools.pairwise(ORDER)
                },
            }
        )
        show(rows[-1:])
    return rows


def measured(
    robots: int, edges: int, speeds: float, links: float, number: int
) -> tuple[dict[str, Scored], float | None]:
    """What each policy reaches on this instance; for a sample of them also the t_c that a long search predicts."""
    kinds = list(itertools.product(("floor", "floors"), REGIMES))
    family, regime = kinds[number % len(kinds)]
    task = problem(family, robots, edges, number, speeds=speeds, links=links, regime=regime)
    world = truth(task, np.random.default_rng(number))
    plans = {name: planned(task, name, budget_s(robots), number) for name in COMPARED}
    scored = {name: _scored(each, world) for name, each in plans.items()}
    if number % SAMPLE:
        return scored, None
    return scored, min(long_search(task, number), *(each.predicted for each in scored.values()))


def truth(task: Problem, rng: np.random.Generator) -> Problem:
    """The world as it turns out: each robot, link, edge and the cloud takes 0.7 to 1.3 times as long as predicted."""

    def off(values: Any) -> np.ndarray:
        return np.asarray(values * rng.uniform(0.7, 1.3, np.shape(values)))

    return dataclasses.replace(
        task,
        pack_s=off(task.pack_s),
        robot_bandwidth=1 / off(1 / task.robot_bandwidth),
        edge_bandwidth=1 / off(1 / task.edge_bandwidth),
        speed=1 / off(1 / task.speed),
        cloud_speed=float(1 / off(1 / task.cloud_speed)),
    )


def long_search(task: Problem, seed: int) -> float:
    """The least predicted t_c that LONG_S of search for nothing else find."""
    weights, begin = quantise(task.weights), time.process_time()
    settings = Settings(KAPPA, TAU, seed + 1, lambda: (time.process_time() - begin) / LONG_S)
    groups = balanced_grouping(weights, len(task.edges), KAPPA, TAU)
    choice, _ = least_time(task, settings, weights, groups)
    return predict(task, choice.slam, choice.fuse).total


def out_of_order(quick: list[Scored], slow: list[Scored]) -> dict[str, Any]:
    """How often the policy that should be quicker is not, and what the critical path then spends its time on."""
    wrong = [(one, two) for one, two in zip(quick, slow, strict=True) if one.true > two.true * (1 + 1e-9)]
    longer: Counter[str] = Counter()
    for one, two in wrong:
        differences = {stage: one.stages[stage] - two.stages[stage] for stage in one.stages}
        longer[max(differences, key=differences.__getitem__)] += 1
    return {
        "share": len(wrong) / len(quick),
        "share by prediction": _share(quick, slow, lambda one, two: one.predicted > two.predicted * (1 + 1e-9)),
        "slower by, median": float(np.median([one.true / two.true - 1 for one, two in wrong])) if wrong else 0.0,
        "stage": dict(longer.most_common()),
    }


def _share(quick: list[Scored], slow: list[Scored], wrong: Callable[[Scored, Scored], bool]) -> float:
    return sum(map(wrong, quick, slow)) / len(quick)


def _mean_over(scores: list[Scored], ours: list[Scored], what: str) -> float:
    """Mean time over mean time."""
    return float(np.mean([getattr(each, what) for each in scores]) / np.mean([getattr(each, what) for each in ours]))


def _scored(made: Assignment, world: Problem) -> Scored:
    true = predict(world, made.slam, made.fuse)
    stages: Counter[str] = Counter()
    for stage in true.critical:
        stages[stage.what] += stage.seconds
    return Scored(made.prediction.total, true.total, stages)
