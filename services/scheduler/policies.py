"""From a problem to an assignment, by a policy chosen by name."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from services.scheduler.baselines import greedy_grouping, random_balanced_grouping, random_grouping, within_reach
from services.scheduler.completion import stages_of
from services.scheduler.costs import Floats, Ints, Prediction, Problem, predict
from services.scheduler.cut import least_cut
from services.scheduler.graph import Groups, cut, quantise
from services.scheduler.grouping import balanced_grouping
from services.scheduler.local_search import Found, descend, tournament
from services.scheduler.placement import edge_offloading
from services.scheduler.regrouping import closest
from services.scheduler.starts import placed, sized_groups
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
    spent: Callable[[], float]
    """used share of the time budget"""


@dataclass(frozen=True)
class Choice:
    """What a policy decides."""

    slam: Ints
    fuse: Ints
    reason: str
    alternative: str = ""


KICKS = 1000
POOL = 8
"""starts in all; random ones fill up"""
TIME_SHARE = 0.75
"""of the budget goes to the search for the least t_c, the rest to that for a smaller cut"""
START_SHARE = 0.2
"""of the search, after which no further start is descended from"""

SLACK = 0.1
"""share of the completion time, about what a prediction is good for, by which plans may differ and count as equal"""
GIVEN_UP = 0.03
"""share that `recslam` gives up for maps that overlap to be fused together, as long as the paper's plan is no better"""

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
    settings = Settings(kappa, tau, seed, lambda: (clock() - begin) / budget_s)
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


def cut_policy(problem: Problem, settings: Settings) -> Choice:
    """Equal groups of the least cut, placed as well as can be."""
    weights, rng = quantise(problem.weights), np.random.default_rng(settings.seed)
    found = least_cut(weights, len(problem.edges), rng, settings.spent)
    reason = f"groups of equal size with the {'least cut there is' if found.proven else 'smallest cut found'}"
    return together(problem, placed(problem, found.groups), f"{reason}, placed by exact bottleneck assignment")


def recslam_policy(problem: Problem, settings: Settings) -> Choice:
    """Of about the least predicted t_c, and of these the least cut; never worse than the paper's plan."""
    if not problem.robots:
        return static_policy(problem, settings)
    weights = quantise(problem.weights)
    groups = balanced_grouping(weights, len(problem.edges), settings.kappa, settings.tau)
    first = replace(settings, spent=lambda: settings.spent() / TIME_SHARE)
    choice, paper = least_time(problem, first, weights, groups)
    total = predict(problem, choice.slam, choice.fuse).total
    bound = max(total, min(total * (1 + GIVEN_UP), paper))
    return replace(choice, fuse=closest(problem, weights, choice.slam, choice.fuse, groups, bound, settings.spent))


def least_time(
    problem: Problem, settings: Settings, weights: NDArray[np.float64], groups: Groups
) -> tuple[Choice, float]:
    """The least predicted t_c that local search finds, and the paper's: it is one of several starts.

    `groups` are those of Algorithms 1 and 2 over `weights`, quantised.
    """
    rng = np.random.default_rng(settings.seed)
    groupings = {
        "paper": edge_offloading(paper_latencies(problem, weights, groups))[groups],
        "paper's groups, best placed": placed(problem, groups),
        "groups sized by edge": sized_groups(problem, weights, rng),
    }
    starts = {name: together(problem, edges, "") for name, edges in groupings.items()}
    starts["as it is"] = static_policy(problem, settings)
    times = {name: predict(problem, start.slam, start.fuse).total for name, start in starts.items()}
    stages = stages_of(problem)
    found: dict[str, Found] = {}
    for name in sorted(times, key=times.__getitem__):
        if found and settings.spent() >= START_SHARE:
            break
        found[name] = descend(stages, starts[name].slam, starts[name].fuse, settings.spent)
    pool = list(found.values())
    while len(pool) < POOL and settings.spent() < START_SHARE:
        edges = random_balanced_policy(problem, replace(settings, seed=settings.seed + len(pool))).fuse
        pool.append(descend(stages, edges, edges, settings.spent))
    best = tournament(stages, pool, KICKS, rng, settings.spent)
    return _verdict(problem, best, times, starts), times["paper"]


def _verdict(problem: Problem, best: Found, times: dict[str, float], starts: dict[str, Choice]) -> Choice:
    """The search's result, unless a start is better by the letter of the prediction."""
    total = predict(problem, best.slam, best.fuse).total
    name = min(times, key=times.__getitem__)
    others = ", ".join(f"{each} {seconds:.3f} s" for each, seconds in sorted(times.items(), key=lambda item: item[1]))
    if times[name] <= total:
        return Choice(starts[name].slam, starts[name].fuse, f"nothing better than {name!r} was found", others)
    return Choice(best.slam, best.fuse, "least predicted completion time found", others)


POLICIES: dict[str, Policy] = {
    "random": random_policy,
    "random-balanced": random_balanced_policy,
    "greedy": greedy_policy,
    "static": static_policy,
    "paper": paper_policy("intended"),
    "paper-printed": paper_policy("printed"),
    "cut": cut_policy,
    "recslam": recslam_policy,
}
