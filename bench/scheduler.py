"""Scheduling: cuts, run times, completion times of the policies, overlaps, and answers while planning.

Run: python -m bench.scheduler [--quick] [--part NAME] [--tasks N]. Times are CPU seconds of this process, compilation
apart. Each part is put into results/scheduler.json beside the others.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.lines import draw_lines
from bench.overlap_error import overlap_error
from bench.responsiveness import responsiveness
from bench.results import RESULTS, append, show
from bench.scheduler_cuts import cuts, long_cuts, methods, timed
from bench.scheduler_graphs import graph, problem
from bench.scheduler_times import KAPPA, TAU, completion, planned
from services.scheduler.grouping import initial_grouping
from services.scheduler.policies import POLICIES
from services.scheduler.tabu import tabu_search


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


def latency(quick: bool) -> list[dict[str, Any]]:
    """CPU time of a whole plan by policy `paper`, with prediction and reasons."""
    rows = []
    for robots, edges in ((10, 3), (20, 4), (50, 5)):
        task = problem("floor", robots, edges, 0, speeds=4, links=4)
        spent = [timed(planned, task, "paper", 1.0, 0)[1] for _ in range(5 if quick else 25)]
        rows.append({"robots": robots, "edges": edges, "paper plan ms": 1e3 * float(np.median(spent))})
        show(rows[-1:])
    return rows


def overlaps(quick: bool) -> list[dict[str, Any]]:
    """Overlap degrees out of robot maps against true footprints, in the apartment."""
    rows = []
    for lidar, seconds in (
        (("rplidar_a1", 30.0),) if quick else itertools.product(("lds01", "rplidar_a1"), (20.0, 60.0))
    ):
        rows.append(overlap_error(6, seconds, lidar))
        show(rows[-1:])
    return rows


def answers(quick: bool) -> list[dict[str, Any]]:
    """Wall time of status queries while plans are made in the worker, with a real router and bus."""
    rows = []
    for robots, edges, policy in ((50, 5, "paper"), (1000, 40, "paper"), (1000, 40, "recslam")):
        rows.append(asyncio.run(responsiveness(robots, edges, policy)))
        show(rows[-1:])
    return rows


def completion_times(quick: bool, tasks: int) -> list[dict[str, Any]]:
    """Mean t_c of each policy over that of recslam, and how often the policies are out of order."""
    return completion(min(tasks, 6) if quick else tasks)


PARTS: dict[str, Callable[..., list[dict[str, Any]]]] = {
    "latency": latency,
    "growth": growth,
    "best-cuts": long_cuts,
    "cuts": cuts,
    "overlaps": overlaps,
    "responsiveness": answers,
    "completion": completion_times,
}


def warm_up() -> None:
    """Compile everything, so that no figure holds it."""
    for robots in (10, 20, 140):
        for method in methods(robots).values():
            method(graph("floor", robots, 99), 3)
    for name in POLICIES:
        for robots in (8, 20):
            planned(problem("floor", robots, 3, 99, speeds=2, links=2), name, 0.2, 0)


def plot_growth(rows: list[dict[str, Any]]) -> None:
    """results/scheduler-growth.png: CPU time over robots, both logarithmic."""
    lines = {
        what: [(row["robots"], max(row[f"{what} ms"], 1e-3)) for row in rows] for what in ("algorithm 1", "algorithm 2")
    }
    draw_lines(lines, "robots", "CPU ms", RESULTS / "scheduler-growth.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer sizes and seeds: about two minutes")
    parser.add_argument("--part", choices=PARTS, action="append", help="only this; may be given again")
    parser.add_argument("--tasks", type=int, default=100, help="instances in each cell of the completion table")
    options = parser.parse_args()
    warm_up()
    for name in options.part or PARTS:
        print(f"\n{name}: {PARTS[name].__doc__}")
        extra = {"tasks": options.tasks} if name == "completion" else {}
        rows = PARTS[name](options.quick, **extra)
        if name == "growth":
            plot_growth(rows)
        print(f"written to {append('scheduler', {name: rows, 'kappa': KAPPA, 'tau': TAU})}")


if __name__ == "__main__":
    main()
