"""From a problem to an assignment, by a policy chosen by name."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from services.scheduler.baselines import greedy_grouping, random_balanced_grouping, random_grouping, within_reach
from services.scheduler.costs import Floats, Ints, Prediction, Problem, predict
from services.scheduler.graph import Groups, cut, quantise
from services.scheduler.grouping import balanced_grouping
from services.scheduler.placement import edge_offloading
from services.scheduler.tabu import TabuMode


@dataclass(frozen=True)
class Assignment:
    """A plan: edges are indices into `Problem.edges`."""

    slam: Ints
    """(V,) edge that runs each robot's SLAM"""
    fuse: Ints
    """(V,) edge that fuses each robot's map"""
    prediction: Prediction
    cut: float
    """Eq. 5 over the groups that are fused together"""
    policy: str
    reason: str
    alternative: str
    """what else was weighed, with its predicted time"""
    seconds: float
    """time to make the plan"""


@dataclass(frozen=True)
class Settings:
    """What a policy may use besides the problem."""

    kappa: int
    tau: int
    seed: int
    time_is_up: Callable[[], bool]


@dataclass(frozen=True)
class Choice:
    """What a policy decides."""

    slam: Ints
    fuse: Ints
    reason: str
    alternative: str = ""


Policy = Callable[[Problem, Settings], Choice]


def plan(
    problem: Problem,
    policy: str,
    *,
    budget_s: float,
    kappa: int,
    tau: int,
    seed: int = 0,
    clock: Callable[[], float] = time.perf_counter,
) -> Assignment:
    """The assignment that this policy makes; it searches for at most about `budget_s` by `clock`.

    The same arguments give the same assignment as long as the budget does not end the search.
    Raises ConfigError naming scheduler.policy for an unknown one.
    """
    if policy not in POLICIES:
        raise ConfigError(f"scheduler.policy: {policy!r} is unknown; choose one of {', '.join(POLICIES)}")
    begin = clock()
    settings = Settings(kappa, tau, seed, lambda: clock() - begin >= budget_s)
    choice = POLICIES[policy](problem, settings)
    return Assignment(
        slam=choice.slam,
        fuse=choice.fuse,
        prediction=predict(problem, choice.slam, choice.fuse),
        cut=cut(quantise(problem.weights), choice.fuse),
        policy=policy,
        reason=choice.reason,
        alternative=choice.alternative,
        seconds=clock() - begin,
    )


def together(problem: Problem, edges: Ints, reason: str) -> Choice:
    """SLAM and fusion of each robot on the same edge; what is out of reach is mended, and said."""
    mended = within_reach(problem.reachable, edges)
    stray = [problem.robots[robot] for robot in np.flatnonzero(mended != edges)]
    if stray:
        reason = f"{reason}; sent to an edge within reach: {', '.join(stray)}"
    return Choice(mended, mended, reason)


def random_policy(problem: Problem, settings: Settings) -> Choice:
    rng = np.random.default_rng(settings.seed)
    edges = random_grouping(len(problem.robots), len(problem.edges), rng)
    return together(problem, edges, "each robot to a random edge")


def random_balanced_policy(problem: Problem, settings: Settings) -> Choice:
    rng = np.random.default_rng(settings.seed)
    edges = random_balanced_grouping(len(problem.robots), len(problem.edges), rng)
    return together(problem, edges, "random groups of equal size")


def greedy_policy(problem: Problem, settings: Settings) -> Choice:
    rng = np.random.default_rng(settings.seed)
    groups = greedy_grouping(quantise(problem.weights), len(problem.edges), rng)
    return together(problem, groups, "random equal groups after one pass of swaps for overlap")


def static_policy(problem: Problem, settings: Settings) -> Choice:
    slam = within_reach(problem.reachable, problem.current_slam)
    fuse = np.where(problem.current_fuse >= 0, problem.current_fuse, slam)
    reason = "robots stay where they are; new ones go to the edge with the fewest robots"
    return Choice(slam, within_reach(problem.reachable, fuse), reason)


def paper_policy(mode: TabuMode) -> Policy:
    """Algorithms 1, 2 (in this reading) and 3."""

    def choose(problem: Problem, settings: Settings) -> Choice:
        weights, count = quantise(problem.weights), len(problem.edges)
        groups = balanced_grouping(weights, count, settings.kappa, settings.tau, mode)
        theta = edge_offloading(paper_latencies(problem, weights, groups))
        reason = f"{count} groups of equal size by overlap (Algorithms 1 and 2, {mode}), placed by Algorithm 3"
        return together(problem, theta[groups], reason)

    return choose


def paper_latencies(problem: Problem, weights: NDArray[np.float64], groups: Groups) -> Floats:
    """(N, E) s: L_j(P_i) + D(P_i) / B_j of Algorithm 3.

    L is the computing latency alone: SLAM of the slowest robot and fusion, as printed. D is the output size by
    inclusion-exclusion over pairs, clamped to what is possible, since truncated there it can be negative.
    """
    count = len(problem.edges)
    latencies = np.zeros((count, count))
    for group in range(count):
        members = np.flatnonzero(groups == group)
        if members.size == 0:
            continue
        areas = problem.map_m2[members]
        shared = (weights[np.ix_(members, members)] * (areas[:, None] + areas[None, :])).sum() / 2
        area = max(areas.sum() - shared, areas.max())
        crowding = np.maximum(1.0, members.size / problem.cores)
        computing = problem.slam_s[members].max() * crowding + problem.fusion.seconds(members.size, area)
        latencies[group] = computing / problem.speed + area * problem.map_bytes_per_m2 / problem.edge_bandwidth
        latencies[group, ~problem.reachable[members].all(axis=0)] = np.inf
    return latencies


POLICIES: dict[str, Policy] = {
    "random": random_policy,
    "random-balanced": random_balanced_policy,
    "greedy": greedy_policy,
    "static": static_policy,
    "paper": paper_policy("printed"),
    "paper-intended": paper_policy("intended"),
}
