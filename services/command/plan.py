"""`recslam plan`: group robots out of a file, explain the plan of a running cluster, or ask it `what if`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from common.bus import Bus, keys
from common.errors import QueryFailed, UsageError
from common.wire import OverlapMatrix, Plan, SchedulerStatus
from common.wire.codec import plain
from services.command import collect
from services.scheduler.what_if import WhatIf

WHAT_IF_S = 60.0
"""a plan for very many robots takes its time"""


def offline(matrix: Path | None, routes: Path | None, edges: int, policy: str, budget_ms: float) -> dict[str, Any]:
    """A plan out of exactly one of the files, as data. Raises UsageError, BadFile or ConfigError."""
    from services.scheduler.offline import plan_matrix, plan_routes

    if budget_ms <= 0:
        raise UsageError(f"budget: {budget_ms:g} ms given; it must be above 0")
    if matrix is not None and routes is None:
        return plan_matrix(matrix, edges, policy, budget_ms / 1e3).to_dict()
    if routes is not None and matrix is None:
        return plan_routes(routes, edges, policy, budget_ms / 1e3).to_dict()
    raise UsageError("name one of --matrix FILE, --routes FILE, --what-if EDGE=down, or say `recslam plan why`")


def offline_lines(found: dict[str, Any]) -> Iterator[str]:
    names = found["robots"]
    for number, (group, inside) in enumerate(zip(found["groups"], found["in_group"], strict=True), 1):
        robots = ", ".join(names[index] for index in group) or "nobody"
        yield f"group {number} ({len(group)}, overlap within {inside:.3f}): {robots}"
    across = f"overlap across groups {found['cut']:.3f} of {found['total_weight']:.3f} in all"
    yield f"{across}; policy {found['policy']}, {1e3 * found['seconds']:.1f} ms"


async def why(bus: Bus) -> tuple[Plan, OverlapMatrix | None]:
    """The plan that holds. Raises QueryFailed when none has been made."""
    plan = await collect.one(bus, keys.SCHEDULER_PLAN, Plan)
    if plan is None:
        raise QueryFailed(
            "no plan yet: one is made every few seconds once two robots and two edges are there, "
            "in topologies recslam and edge-only alone",
            keys.SCHEDULER_PLAN,
        )
    return plan, await collect.one(bus, keys.SCHEDULER_OVERLAP, OverlapMatrix)


async def what_if(bus: Bus, supposed: str) -> Plan:
    """What would be planned; the cluster goes on as it is.

    Raises UsageError for what cannot be supposed, QueryFailed when there is no scheduler or it cannot tell.
    """
    asked = WhatIf.parse(supposed)
    status = await collect.one(bus, keys.SCHEDULER_STATUS, SchedulerStatus)
    if status is not None:
        asked.check(sorted(edge for edge, word in status.edges.items() if word == "alive"))
    answers = await bus.get(keys.SCHEDULER_PLAN, {"what_if": supposed}, timeout_s=WHAT_IF_S)
    for answer in answers:
        if isinstance(answer.message, Plan):
            return answer.message
    raise QueryFailed("no scheduler answers; is it up? see `recslam doctor`", keys.SCHEDULER_PLAN)


def as_data(plan: Plan, overlap: OverlapMatrix | None) -> dict[str, Any]:
    return {**plain(plan), "across": {f"{a} - {b}": w for a, b, w in across(plan, overlap)}}


def across(plan: Plan, overlap: OverlapMatrix | None) -> Iterator[tuple[str, str, float]]:
    """Sum of overlaps between the groups of every two edges."""
    if overlap is None:
        return
    weights = overlap.weights.reshape(len(overlap.robots), -1)
    index = {robot: at for at, robot in enumerate(overlap.robots)}
    members = {edge: [index[r] for r in robots if r in index] for edge, robots in plan.groups.items()}
    for one, two in itertools.combinations(sorted(members), 2):
        yield one, two, float(weights[np.ix_(members[one], members[two])].sum())


def lines(plan: Plan, overlap: OverlapMatrix | None) -> Iterator[str]:
    """For people: who goes where, why, at what times, and what was not chosen."""
    yield f"plan for table {plan.epoch[0]}.{plan.epoch[1]}, policy {plan.policy}, made in {1e3 * plan.seconds:.1f} ms"
    yield f"reason: {plan.reason}"
    for edge, robots in sorted(plan.groups.items()):
        yield f"  {edge} fuses {', '.join(robots) or 'nobody'} (overlap within {plan.in_group.get(edge, 0.0):.3f})"
    apart = [
        f"{robot} runs at {slam}"
        for edge, robots in sorted(plan.groups.items())
        for robot in robots
        if (slam := plan.slam.get(robot, edge)) != edge
    ]
    if apart:
        yield f"  SLAM elsewhere: {', '.join(apart)}"
    yield f"overlap across groups: {plan.cut:.3f}"
    for one, two, weight in across(plan, overlap):
        yield f"  {one} - {two}: {weight:.3f}"
    yield f"predicted for one round: {1e3 * plan.predicted.get('t_c', 0.0):.1f} ms to the global map, of which"
    for stage, seconds in plan.predicted.items():
        if stage not in ("t_c", "cloud"):
            yield f"  {stage}: {1e3 * seconds:.1f} ms"
    yield f"not taken: {plan.alternative or 'nothing else was weighed'}"
