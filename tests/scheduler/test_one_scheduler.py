"""A fleet has one scheduler at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from common.bus import Bus, keys
from common.config import EdgeEntry, Fleet
from common.errors import UsageError
from common.wire import SchedulerStatus
from services.scheduler.service import Scheduler

OpenBus = Callable[..., Awaitable[Bus]]
FLEET = Fleet(edges=(EdgeEntry(id="e1"),))


async def has_begun(bus: Bus) -> None:
    async with asyncio.timeout(60):
        async for received in bus.watch(keys.SCHEDULER_STATUS):
            if isinstance(received.message, SchedulerStatus):
                return


async def test_a_second_scheduler_is_refused_until_the_first_has_gone(open_bus: OpenBus) -> None:
    stop, bus, first = asyncio.Event(), await open_bus("cluster"), await open_bus("first")
    running = asyncio.create_task(Scheduler(FLEET, first, stop).run())
    await has_begun(bus)
    second = await open_bus("second")
    with pytest.RaisesGroup(pytest.RaisesExc(UsageError, match="another scheduler is there")):
        await Scheduler(FLEET, second, asyncio.Event()).run()
    stop.set()
    await running
    await first.close()
    stop = asyncio.Event()
    running = asyncio.create_task(Scheduler(FLEET, second, stop).run())
    await has_begun(bus)
    stop.set()
    await running
