"""Assignments that a search for the least t_c starts from; (V,) edge indices, SLAM and fusion together."""

from __future__ import annotations

import numpy as np

from services.scheduler.bisection import recursive_bisection
from services.scheduler.costs import Floats, Ints, Problem, union_m2
from services.scheduler.descent import adjacency, swap_descent
from services.scheduler.graph import Groups, Weights
from services.scheduler.placement import bottleneck_assignment


def edge_times(problem: Problem, groups: Groups) -> Floats:
    """(N, E) s: when the map of group i would be at the cloud if edge j had it; infinite where one cannot reach j."""
    count = len(problem.edges)
    times = np.zeros((count, count))
    for group in range(count):
        members = np.flatnonzero(groups == group)
        if members.size == 0:
            continue
        area = union_m2(problem, members)
        crowd = np.maximum(1.0, members.size / problem.cores) / problem.speed
        moving = (problem.current_slam[members] >= 0)[:, None] & (
            problem.current_slam[members][:, None] != np.arange(count)
        )
        robots = problem.pack_s[members, None] + problem.slam_s[members, None] * crowd
        robots = robots + problem.frame_bytes[members, None] / problem.robot_bandwidth[members]
        robots = robots + moving * problem.move_cost[members, None] / problem.horizon
        fusing = problem.fusion.seconds(members.size, area) / problem.speed
        times[group] = robots.max(axis=0) + fusing + area * problem.map_bytes_per_m2 / problem.edge_bandwidth
        times[group, ~problem.reachable[members].all(axis=0)] = np.inf
    return times


def placed(problem: Problem, groups: Groups) -> Ints:
    """The groups on the edges by exact bottleneck assignment."""
    return bottleneck_assignment(edge_times(problem, groups))[groups]


def water_filled_sizes(problem: Problem) -> Ints:
    """(E,) robots for each edge: one by one, each to the edge that would be done with it first.

    Robots count as average ones, and an edge map as its share of what all robots cover together.
    """
    robots = len(problem.robots)
    per_robot = union_m2(problem, np.arange(robots)) / max(robots, 1)
    transfer = (problem.frame_bytes[:, None] / problem.robot_bandwidth).mean(axis=0)
    work, pack = problem.slam_s.mean(), problem.pack_s.mean()
    sizes = np.zeros(len(problem.edges), dtype=np.int64)
    for _ in range(robots):
        k = sizes + 1
        slam = work * np.maximum(1.0, k / problem.cores) / problem.speed
        fusing = problem.fusion.seconds(k, k * per_robot) / problem.speed
        upload = k * per_robot * problem.map_bytes_per_m2 / problem.edge_bandwidth
        sizes[np.argmin(pack + transfer + slam + fusing + upload)] += 1
    return sizes


def sized_groups(problem: Problem, weights: Weights, rng: np.random.Generator) -> Ints:
    """Water-filled sizes, and a small cut for them."""
    graph = adjacency(weights)
    groups = recursive_bisection(graph, water_filled_sizes(problem), rng)
    return swap_descent(graph, groups, len(problem.edges))
