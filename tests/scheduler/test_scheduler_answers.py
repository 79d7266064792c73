"""The scheduler on a real bus, with its planning process: it answers while it plans, and tells what it would do."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from bench.synthetic_cluster import SyntheticCluster
from common.bus import Bus, keys
from common.config import SchedulerConfig
from common.errors import QueryFailed, UsageError
from common.wire import Plan, RobotProfile, Routes, SchedulerStatus
from services.command.plan import what_if
from services.scheduler.service import Scheduler

OpenBus = Callable[..., Awaitable[Bus]]
EDGES = ("e0", "e1", "e2")


@pytest.fixture
async def asker(open_bus: OpenBus) -> AsyncIterator[Bus]:
    """A bus beside a scheduler that plans for four seconds, with three edges and nine robots there."""
    model = SyntheticCluster(9, 3).fleet
    fleet = model.model_copy(update={"scheduler": SchedulerConfig(policy="recslam", interval_s=600, budget_s=4.0)})
    stop, bus = asyncio.Event(), await open_bus("cluster")
    running = asyncio.create_task(Scheduler(fleet, await open_bus("scheduler"), stop).run())
    for edge in EDGES:
        await bus.declare_alive(keys.edge_alive(edge))
    for number in range(9):
        robot = f"r{number}"
        reach = ("e1",) if number == 0 else None
        start = (6.0 * number, 0.0, 0.0)
        profile = RobotProfile(robot=robot, stream="a" * 32, start=start, range_max=8.0, edges=reach)
        await bus.latch(keys.robot_profile(robot), profile)
        await bus.declare_alive(keys.robot_alive(robot))
    async with asyncio.timeout(60):
        async for received in bus.watch(keys.SCHEDULER_ROUTES):
            if isinstance(received.message, Routes) and len(received.message.routes) == 9:
                break
        yield bus
    stop.set()
    await running


async def ask(bus: Bus, supposed: str) -> Plan:
    (answer,) = await bus.get(keys.SCHEDULER_PLAN, {"what_if": supposed}, timeout_s=60)
    assert isinstance(answer.message, Plan)
    return answer.message


async def test_the_status_is_answered_before_the_plan_is_ready(asker: Bus) -> None:
    planning = asyncio.create_task(ask(asker, "e2=down"))
    (answer,) = await asker.get(keys.SCHEDULER_STATUS)
    assert isinstance(answer.message, SchedulerStatus)
    assert not planning.done()
    plan = await planning
    assert set(plan.groups) == {"e0", "e1"}
    assert sorted(robot for robots in plan.groups.values() for robot in robots) == [f"r{n}" for n in range(9)]


async def test_a_question_changes_nothing_and_names_who_would_be_left_without_an_edge(asker: Bus) -> None:
    (before,) = await asker.get(keys.SCHEDULER_ROUTES)
    plan = await ask(asker, "e1=down")
    assert "r0" not in plan.slam
    assert "without an edge: r0" in plan.reason
    (after,) = await asker.get(keys.SCHEDULER_ROUTES)
    assert after.message == before.message
    with pytest.raises(QueryFailed, match="no such edge"):
        await ask(asker, "e7=down")


@pytest.mark.parametrize("supposed", ["e7=down", "e0=down,e1=down,e2=down", "e1", "e1=1e-320", "e1=inf", "e1=nan"])
async def test_a_question_that_cannot_be_answered_is_for_its_asker_to_mend(asker: Bus, supposed: str) -> None:
    with pytest.raises(UsageError, match="what if"):
        await what_if(asker, supposed)
