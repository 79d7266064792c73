"""Group robots without a cluster, by an overlap matrix or by planned routes: `recslam plan --matrix` or `--routes`."""

from __future__ import annotations

import itertools
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import BadFile, UsageError
from services.scheduler.costs import Problem
from services.scheduler.cut import SMALL, SURE
from services.scheduler.graph import Weights, quantise
from services.scheduler.policies import plan
from services.scheduler.routes_file import coverage, read_routes

COMPILE_LOOKS = 100.0
"""at the clock, after which a search ends that only compiles"""


@dataclass(frozen=True)
class OfflinePlan:
    """Groups of robot indices, one group an edge."""

    policy: str
    groups: tuple[tuple[int, ...], ...]
    cut: float
    """Eq. 5: sum of overlaps across groups, each pair once"""
    in_group: tuple[float, ...]
    """sum of overlaps within each group"""
    seconds: float
    """time to make the plan, compilation apart"""
    robots: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        return {
            "policy": self.policy,
            "groups": [list(group) for group in self.groups],
            "robots": list(self.robots),
            "sizes": [len(group) for group in self.groups],
            "cut": self.cut,
            "total_weight": self.cut + sum(self.in_group),
            "in_group": list(self.in_group),
            "seconds": self.seconds,
        }


def plan_matrix(
    path: Path,
    edges: int,
    policy: str,
    budget_s: float,
    *,
    kappa: int = 100,
    tau: int = 10,
    seed: int = 0,
    clock: Callable[[], float] = time.perf_counter,
) -> OfflinePlan:
    """Group the robots of a matrix file into `edges` groups by this policy; edges and robots are alike otherwise.

    Raises BadFile for a file that holds no overlap matrix, UsageError for edges < 1, ConfigError for an unknown policy.
    """
    weights = read_matrix(path)
    names = tuple(f"r{index}" for index in range(len(weights)))
    return _plan(uniform_problem(weights, edges), names, policy, budget_s, kappa, tau, seed, clock)


def plan_routes(
    path: Path,
    edges: int,
    policy: str,
    budget_s: float,
    *,
    kappa: int = 100,
    tau: int = 10,
    seed: int = 0,
    clock: Callable[[], float] = time.perf_counter,
) -> OfflinePlan:
    """Group the robots of a routes file (see routes_file.py) by what they will see; raises as `plan_matrix`."""
    planned = coverage(read_routes(path))
    problem = replace(uniform_problem(planned.overlap.weights, edges), footprints=planned.cells)
    return _plan(problem, planned.overlap.robots, policy, budget_s, kappa, tau, seed, clock)


def _plan(
    problem: Problem,
    names: tuple[str, ...],
    policy: str,
    budget_s: float,
    kappa: int,
    tau: int,
    seed: int,
    clock: Callable[[], float],
) -> OfflinePlan:
    compiled(problem, policy, kappa, tau)
    assignment = plan(problem, policy, budget_s=budget_s, kappa=kappa, tau=tau, seed=seed, clock=clock)
    groups = [np.flatnonzero(assignment.fuse == edge) for edge in range(len(problem.edges))]
    return OfflinePlan(
        policy=policy,
        groups=tuple(tuple(group.tolist()) for group in groups),
        cut=assignment.cut,
        in_group=tuple(float(problem.weights[np.ix_(group, group)].sum()) / 2 for group in groups),
        seconds=assignment.seconds,
        robots=names,
    )


def compiled(problem: Problem, policy: str, kappa: int, tau: int) -> None:
    """Plan for the first few robots, so that neither the budget nor the stated time holds what compiling takes.

    The sizes are those at which policy `cut` searches in other ways.
    """
    for count in sorted({min(len(problem.robots), size) for size in (SURE, 2 * SURE, SMALL + 1)}):
        looks = map(float, itertools.count())
        few = uniform_problem(problem.weights[:count, :count], len(problem.edges))
        plan(few, policy, budget_s=COMPILE_LOOKS, kappa=kappa, tau=tau, clock=looks.__next__)


def read_matrix(path: Path) -> Weights:
    """The overlap matrix of an npz file (array `weights`) or of a csv file (one row a line).

    Raises BadFile naming the file and what is wrong.
    """
    try:
        if path.stat().st_size == 0:
            raise BadFile(f"{path}: is empty")
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                matrix = arrays["weights"]
        elif path.suffix == ".csv":
            matrix = np.loadtxt(path, delimiter=",", ndmin=2)
        else:
            raise BadFile(f"{path}: an overlap matrix is read from .npz (array 'weights') or .csv")
        return quantise(matrix)
    except KeyError:
        raise BadFile(f"{path}: holds no array 'weights'; save it with np.savez(path, weights=matrix)") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise BadFile(f"{path}: {error}") from error
    except UsageError as error:
        raise error if isinstance(error, BadFile) else BadFile(f"{path}: {error}") from error


def uniform_problem(weights: Weights, edges: int) -> Problem:
    """Robots and edges that differ in nothing but overlaps.

    With no footprints, each robot map is given AREA cells of its own, of which it shares those that `weights` say with
    each neighbour, as far as they go: areas then follow overlaps, though not exactly where three maps meet.
    Raises UsageError for edges < 1.
    """
    if edges < 1:
        raise UsageError(f"edges: {edges} given; at least 1 is needed to group for")
    robots = len(weights)
    return Problem(
        robots=tuple(f"r{index}" for index in range(robots)),
        edges=tuple(f"e{index}" for index in range(edges)),
        weights=weights,
        footprints=shared_footprints(weights),
        reachable=np.ones((robots, edges), dtype=bool),
        robot_bandwidth=np.full((robots, edges), 5e6),
        edge_bandwidth=np.full(edges, 1e6),
        speed=np.ones(edges),
        cores=np.full(edges, 4),
        frame_bytes=np.full(robots, 1e6),
        slam_s=np.full(robots, 0.15),
        pack_s=np.full(robots, 0.05),
        current_slam=np.full(robots, -1),
        current_fuse=np.full(robots, -1),
        move_cost=np.zeros(robots),
    )


AREA = 100


def shared_footprints(weights: Weights) -> tuple[np.ndarray, ...]:
    """Per robot AREA cell ids, of which robots u < v share about 2 AREA w(u, v) while both have cells left."""
    cells: list[list[int]] = [[] for _ in range(len(weights))]
    fresh = 0
    rows, columns = np.nonzero(np.triu(weights))
    for at in np.argsort(-weights[rows, columns], kind="stable"):
        u, v = cells[rows[at]], cells[columns[at]]
        shared = min(round(2 * AREA * weights[rows[at], columns[at]]), AREA - len(u), AREA - len(v))
        u.extend(range(fresh, fresh + shared))
        v.extend(range(fresh, fresh + shared))
        fresh += max(shared, 0)
    for own in cells:
        missing = AREA - len(own)
        own.extend(range(fresh, fresh + missing))
        fresh += missing
    return tuple(np.array(own, dtype=np.int64) for own in cells)
