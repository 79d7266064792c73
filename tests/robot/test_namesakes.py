"""Two robots of one name: one of them leaves, and says why."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import pytest
from agents import ENTRY, ROBOT, OpenBus, fleet_at, known, running
from list_source import ListSource, sweeps

from common.errors import UsageError
from services.robot_agent.collector import Collector
from services.robot_agent.service import RobotAgent
from services.robot_agent.spool import Spool

pytestmark = pytest.mark.timeout(60)


@pytest.mark.parametrize("spool", ["of its own", "copied"])
async def test_a_second_robot_of_the_same_name_is_refused(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path, spool: str
) -> None:
    bus = await open_bus()
    fleet = fleet_at(endpoint, root)
    if spool == "copied":  # as when two robots boot from copies of one disk
        Spool(tmp_path / "r1.spool", ROBOT, 2**30).close()
        shutil.copy(tmp_path / "r1.spool", tmp_path / "other")
    async with running(fleet, tmp_path, sweeps(3)) as agent:
        await known(bus)
        with Spool(tmp_path / "other", ROBOT, 2**30) as other, pytest.raises(ExceptionGroup) as refused:
            await RobotAgent(fleet, ENTRY, Collector(ListSource(sweeps(3)), other), other, asyncio.Event()).run()
        assert in_use(refused.value)
        assert (await known(bus)).stream == agent.state.stream


async def test_of_two_robots_of_one_name_that_come_at_once_one_is_refused(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    fleet, stop = fleet_at(endpoint, root), asyncio.Event()
    with Spool(tmp_path / "a", ROBOT, 2**30) as a, Spool(tmp_path / "b", ROBOT, 2**30) as b:
        agents = [RobotAgent(fleet, ENTRY, Collector(ListSource(sweeps(3)), spool), spool, stop) for spool in (a, b)]
        tasks = [asyncio.create_task(agent.run()) for agent in agents]
        (left,), _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        assert in_use(left.exception())
        (stays,) = (agent.state.stream for agent, task in zip(agents, tasks, strict=True) if task is not left)
        assert (await known(bus)).stream == stays
        stop.set()
        await asyncio.gather(*(task for task in tasks if task is not left))


def in_use(error: BaseException | None) -> bool:
    def is_that(leaf: BaseException) -> bool:
        return isinstance(leaf, UsageError) and "'r1' is in use" in str(leaf)

    return isinstance(error, BaseExceptionGroup) and error.subgroup(is_that) is not None
