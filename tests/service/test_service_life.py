"""How a service on the bus begins, works and ends."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from common.bus import Bus, keys
from common.bus.intake import Received
from common.service import Service
from common.wire import Claims, RobotProfile

OpenBus = Callable[..., Awaitable[Bus]]
PATIENCE_S = 20.0


class Told(Service):
    """Notes what happens to it."""

    def __init__(self, bus: Bus, stop: asyncio.Event, opening_s: float = 0.0) -> None:
        super().__init__(bus, stop)
        self.notes: asyncio.Queue[str] = asyncio.Queue()
        self._opening_s = opening_s

    async def _open(self) -> None:
        self.notes.put_nowait("opening")
        await asyncio.sleep(self._opening_s)

    def _begin(self) -> None:
        self.notes.put_nowait("begun")
        self._follow(keys.robot_profile(keys.ANY))
        self._tell_status(keys.edge_claims("e1"), lambda: Claims(edge="e1", claims={}, epoch=(1, 1)))

    async def _close(self) -> None:
        self.notes.put_nowait("closed")

    def _heard(self, received: Received) -> None:
        assert isinstance(received.message, RobotProfile)
        self.notes.put_nowait(received.message.robot)

    def repeat(self, seconds: float, do: Callable[[], Awaitable[None] | None]) -> None:
        self._every(seconds, do, "again")

    async def wait_for(self, *notes: str) -> None:
        async with asyncio.timeout(PATIENCE_S):
            for note in notes:
                assert await self.notes.get() == note


async def test_a_service_opens_hears_tells_its_status_and_closes_when_it_is_stopped(open_bus: OpenBus) -> None:
    bus, stop = await open_bus("test"), asyncio.Event()
    await bus.latch(keys.robot_profile("r1"), RobotProfile(robot="r1", stream="a" * 32))
    service = Told(await open_bus("service"), stop)
    running = asyncio.create_task(service.run())
    await service.wait_for("opening", "begun", "r1")
    await bus.latch(keys.robot_profile("r2"), RobotProfile(robot="r2", stream="b" * 32))
    await service.wait_for("r2")
    (answer,) = await bus.get(keys.edge_claims("e1"))
    assert answer.message == Claims(edge="e1", claims={}, epoch=(1, 1))
    stop.set()
    await running
    await service.wait_for("closed")


async def test_a_service_that_is_stopped_while_it_opens_does_not_begin_and_closes(open_bus: OpenBus) -> None:
    stop = asyncio.Event()
    service = Told(await open_bus("service"), stop, opening_s=1000.0)
    running = asyncio.create_task(service.run())
    await service.wait_for("opening")
    stop.set()
    await running
    await service.wait_for("closed")


async def test_a_task_that_fails_ends_its_service_which_closes_and_tells_why(open_bus: OpenBus) -> None:
    service = Told(await open_bus("service"), asyncio.Event())
    running = asyncio.create_task(service.run())
    await service.wait_for("opening", "begun")

    def fail() -> None:
        raise KeyError("oops")

    service.repeat(0.0, fail)
    with pytest.raises(ExceptionGroup, match="unhandled"):
        await running
    await service.wait_for("closed")


async def test_what_is_to_be_done_again_and_again_is_done_one_after_the_other(open_bus: OpenBus) -> None:
    stop, at_once, most = asyncio.Event(), 0, 0

    async def work() -> None:
        nonlocal at_once, most
        at_once += 1
        most = max(most, at_once)
        await asyncio.sleep(0.01)
        at_once -= 1
        service.notes.put_nowait("done")

    service = Told(await open_bus("service"), stop)
    running = asyncio.create_task(service.run())
    await service.wait_for("opening", "begun")
    service.repeat(0.0, work)
    await service.wait_for("done", "done", "done")
    assert most == 1
    stop.set()
    await running
