"""Agents of robot r1 for tests, and what is heard of them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TypeVar

from list_source import ListSource

from common.bus import Bus, Stream, keys
from common.bus.intake import Received
from common.config import BusConfig, EdgeConfig, Fleet, RobotConfig, RobotEntry, SimSource
from common.sweep import Sweep
from common.wire import Message, RobotProfile
from services.robot_agent.collector import Collector
from services.robot_agent.service import RobotAgent
from services.robot_agent.spool import Spool

M = TypeVar("M", bound=Message)
OpenBus = Callable[..., Awaitable[Bus]]
ROBOT = "r1"
ENTRY = RobotEntry(id=ROBOT, source=SimSource(scene="apartment"), start=(1.0, 2.0, 0.5))


def fleet_at(endpoint: str, root: str, window: int = 64, timeout_s: float = 5.0) -> Fleet:
    return Fleet(
        bus=BusConfig(endpoint=endpoint, root=root, timeout_s=timeout_s),
        edge=EdgeConfig(window=window),
        robot=RobotConfig(linger_s=0.05),
    )


@asynccontextmanager
async def running(
    fleet: Fleet, folder: Path, given: Sequence[Sweep], can_wait: bool = True
) -> AsyncIterator[RobotAgent]:
    """An agent that has been stopped, and has not failed, when the block is left."""
    stop = asyncio.Event()
    with Spool(folder / "r1.spool", ROBOT, 2**30) as spool:
        agent = RobotAgent(fleet, ENTRY, Collector(ListSource(given, can_wait), spool), spool, stop)
        task = asyncio.create_task(agent.run())
        try:
            yield agent
        finally:
            stop.set()
            await task


async def first(stream: Stream[Received], kind: type[M], wanted: Callable[[M], bool] = lambda _: True) -> M:
    """The first message of the kind that is wanted."""
    async for received in stream:
        if isinstance(received.message, kind) and wanted(received.message):
            return received.message
    raise AssertionError("the stream has ended")


async def known(bus: Bus) -> RobotProfile:
    return await first(bus.watch(keys.robot_profile(ROBOT)), RobotProfile)
