"""Scheduling: cuts, run times, and completion times of the policies. Run: python -m bench.scheduler [--quick].

Times are CPU seconds of this process, compilation apart; ratios are medians over seeds. Writes results/scheduler.json.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.scheduler_graphs import FAMILIES, REGIMES, graph, problem
from bench.scheduler_peers import kernighan_lin, metis
from services.scheduler.baselines import greedy_grouping, random_balanced_grouping
from services.scheduler.costs import FusionModel, Problem, predict
from services.scheduler.cut import least_cut
from services.scheduler.graph import Groups, Weights, cut
from services.scheduler.grouping import balanced_grouping, initial_grouping
from services.scheduler.policies import POLICIES, plan
from services.scheduler.tabu import tabu_search

KAPPA, TAU = 100, 10
SEARCH_S = 0.5
LONG_S = 4.0
Grouping = Callable[[Weights, int], Groups]


def timed(work: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    begin = time.process_time()
    return work(*arguments), time.process_time() - begin


def within(budget_s: float) -> Callable[[Weights, int], Groups]:
    """Policy `cut` with this budget."""

    def search(weights: Weights, count: int) -> Groups:
        begin = time.process_time()
        rng = np.random.default_rng(0)
        return least_cut(weights, count, rng, lambda: (time.process_time() - begin) / budget_s).groups

    return search


def methods(robots: int) -> dict[str, Grouping]:
    budget = 0.1 if robots <= 50 else 0.5 if robots <= 200 else 5.0
    found: dict[str, Grouping] = {
        "random-balanced": lambda w, n: random_balanced_grouping(len(w), n, np.random.default_rng(0)),
        "greedy": lambda w, n: greedy_grouping(w, n, np.random.default_rng(0)),
        "algorithm 1": initial_grouping,
        "paper": lambda w, n: balanced_grouping(w, n, KAPPA, TAU),
        "paper-intended": lambda w, n: balanced_grouping(w, n, 10 * KAPPA, len(w), "intended"),
        "metis": metis,
        "cut": within(budget),
    }
    if robots <= 50:
        found["kernighan-lin"] = kernighan_lin
    return found


def cuts(quick: bool) -> list[dict[str, Any]]:
    """Each method's cut over the smallest seen, by family and size; both plus 0.1 % of all overlap, as 0 occurs."""
    sizes = [(10, 3), (20, 4), (50, 5)] + ([] if quick else [(200, 20), (1000, 50)])
    rows = []
    for (robots, edges), family in itertools.product(sizes, FAMILIES):
        ratios: dict[str, list[float]] = {}
        seconds: dict[str, list[float]] = {}
        for seed in range(3 if quick or robots > 50 else 8):
            weights = graph(family, robots, seed)
            found = {name: timed(method, weights, edges) for name, method in methods(robots).items()}
            values = {name: cut(weights, groups) for name, (groups, _) in found.items()}
            if robots <= 200:
                values["long"] = cut(weights, within(LONG_S if robots > 50 else SEARCH_S)(weights, edges))
            best, least = min(values.values()), 5e-4 * float(weights.sum())
            for name, (_, spent) in found.items():
                ratios.setdefault(name, []).append((values[name] + least) / (best + least))
                seconds.setdefault(name, []).append(spent)
        for name in ratios:
            rows.append(
                {
                    "family": family,
                    "robots": robots,
                    "edges": edges,
                    "method": name,
                    "over_best": float(np.median(ratios[name])),
                    "worst": float(max(ratios[name])),
                    "cpu_ms": 1e3 * float(np.median(seconds[name])),
                }
            )
        show(rows[-len(ratios) :])
    return rows


def growth(quick: bool) -> list[dict[str, Any]]:
    """CPU time of the paper's algorithms by the number of robots, ten robots an edge."""
    rows = []
    for robots in (10, 20, 50, 100, 200, 500) if quick else (10, 20, 50, 100, 200, 500, 1000, 2000, 5000):
        weights, edges = graph("random", robots, 0), max(3, robots // 10)
        repeats = 1 if robots > 500 else 9
        start = initial_grouping(weights, edges)
        one = [timed(initial_grouping, weights, edges)[1] for _ in range(repeats)]
        two = [timed(tabu_search, weights, start, KAPPA, TAU)[1] for _ in range(repeats)]
        rows.append(
            {
                "robots": robots,
                "edges": edges,
                "algorithm 1 ms": 1e3 * float(np.median(one)),
                "algorithm 2 ms": 1e3 * float(np.median(two)),
            }
        )
        show(rows[-1:])
    return rows


def perturbed(task: Problem, rng: np.random.Generator) -> Problem:
    """The world as it turns out: every stage takes up to 30 % more or less than the predictor thinks."""

    def off(values: np.ndarray) -> np.ndarray:
        return np.asarray(values * rng.uniform(0.7, 1.3, np.shape(values)))

    model = FusionModel(*(float(off(np.array(each))) for each in dataclasses.astuple(task.fusion)))
    return dataclasses.replace(
        task,
        robot_bandwidth=off(task.robot_bandwidth),
        edge_bandwidth=off(task.edge_bandwidth),
        speed=off(task.speed),
        slam_s=off(task.slam_s),
        pack_s=off(task.pack_s),
        fusion=model,
    )


def completion(quick: bool) -> list[dict[str, Any]]:
    """t_c of each policy over that of a long search, as predicted and as it turns out, by how unequal the edges are."""
    sizes = [(6, 3), (10, 3), (20, 4), (50, 5)] + ([] if quick else [(50, 8)])
    unequal = [(1, 1), (2, 5), (4, 10), (8, 20)]
    regimes = ["balanced"] if quick else list(REGIMES)
    rows = []
    for (robots, edges), (speeds, links) in itertools.product(sizes, unequal):
        guessed: dict[str, list[float]] = {}
        true: dict[str, list[float]] = {}
        for number, (family, regime) in enumerate(itertools.product(("floor", "floors"), regimes)):
            task = problem(family, robots, edges, number, speeds=speeds, links=links, regime=regime)
            world = perturbed(task, np.random.default_rng(number))
            plans = {name: planned(task, name, SEARCH_S) for name in POLICIES}
            best = min(planned(task, "recslam", LONG_S / 2, seed).prediction.total for seed in (1, 2))
            best = min([best, *(each.prediction.total for each in plans.values())])
            ours = predict(world, plans["recslam"].slam, plans["recslam"].fuse).total
            for name, each in plans.items():
                guessed.setdefault(name, []).append(each.prediction.total / best)
                true.setdefault(name, []).append(predict(world, each.slam, each.fuse).total / ours)
        for name in guessed:
            rows.append(
                {
                    "robots": robots,
                    "edges": edges,
                    "speeds": speeds,
                    "links": links,
                    "policy": name,
                    "predicted_over_best": float(np.median(guessed[name])),
                    "true_over_recslam": float(np.median(true[name])),
                }
            )
        show(rows[-len(guessed) :])
    return rows


def planned(task: Problem, policy: str, budget_s: float, seed: int = 0) -> Any:
    return plan(task, policy, budget_s=budget_s, kappa=KAPPA, tau=TAU, seed=seed, clock=time.process_time)


def latency(quick: bool) -> list[dict[str, Any]]:
    """CPU time of a whole plan by policy `paper`, with prediction and reasons."""
    rows = []
    for robots, edges in ((10, 3), (20, 4), (50, 5)):
        task = problem("floor", robots, edges, 0, speeds=4, links=4)
        spent = [timed(planned, task, "paper", 1.0)[1] for _ in range(5 if quick else 25)]
        rows.append({"robots": robots, "edges": edges, "paper plan ms": 1e3 * float(np.median(spent))})
        show(rows[-1:])
    return rows


PARTS = {"latency": latency, "growth": growth, "cuts": cuts, "completion": completion}


def warm_up() -> None:
    """Compile everything, so that no figure holds it."""
    for robots in (10, 20, 140):
        for method in methods(robots).values():
            method(graph("floor", robots, 99), 3)
    for name in POLICIES:
        planned(problem("floor", 8, 3, 99, speeds=2, links=2), name, 0.2)


def show(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        print(
            "  ".join(
                f"{key} {value:.3f}" if isinstance(value, float) else f"{value!s:>6}" for key, value in row.items()
            )
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer sizes and seeds: about two minutes")
    parser.add_argument("--part", choices=PARTS, action="append", help="only this; may be given again")
    options = parser.parse_args()
    warm_up()
    results: dict[str, Any] = {"quick": options.quick, "kappa": KAPPA, "tau": TAU}
    for name in options.part or PARTS:
        print(f"\n{name}: {PARTS[name].__doc__}")
        results[name] = PARTS[name](options.quick)
    out = Path("results") / "scheduler.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(results, indent=1))
    print(f"\nwritten to {out}")


if __name__ == "__main__":
    main()
