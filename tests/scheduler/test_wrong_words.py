"""A robot or an edge that tells nonsense is named, and the scheduler plans for all others."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping

from common.bus import Bus, keys
from common.config import EdgeEntry, Fleet, SchedulerConfig
from common.wire import Cover, MapNotice, Message, RobotProfile, RobotStatus, SchedulerStatus, Tile, TilePage
from services.scheduler.service import Scheduler

OpenBus = Callable[..., Awaitable[Bus]]
STREAM = "a" * 32


async def come(bus: Bus, robot: str, start: tuple[float, float, float]) -> None:
    await bus.latch(keys.robot_profile(robot), RobotProfile(robot=robot, stream=STREAM, start=start, range_max=8.0))
    counts = {"sent": 0, "spooled": 0, "spool_bytes": 0, "dropped": 0, "backfilled": 0, "bytes_sent": 800}
    await bus.latch(keys.robot_status(robot), RobotStatus(robot=robot, stream=STREAM, processed=-1, **counts))
    await bus.declare_alive(keys.robot_alive(robot))


async def offer_nonsense(bus: Bus, edge: str, robot: str) -> None:
    """A robot map whose sketch is no tile."""
    cover = Cover(stream=STREAM, seq=0, epoch=(1, 1))

    async def page(asked: str, params: Mapping[str, str]) -> Message:
        tiles = (Tile(x=0, y=0, version=1, data=b"none"),)
        covers = {robot: cover}
        return TilePage(
            source=edge, kind="occupancy", resolution=0.05, version=1, tiles=tiles, covers=covers, final=False
        )

    key = keys.edge_robot_map(edge, robot)
    notice = MapNotice(robot=robot, edge=edge, epoch=(1, 1), version=1, resolution=0.05, cover=cover, final=False)
    await bus.latch(key, notice)
    await bus.serve(key, page)


async def test_nonsense_is_named_with_its_sender_and_does_not_end_planning(open_bus: OpenBus) -> None:
    fleet = Fleet(
        edges=(EdgeEntry(id="e1"), EdgeEntry(id="e2")), scheduler=SchedulerConfig(interval_s=0.2, budget_s=0.05)
    )
    stop, bus = asyncio.Event(), await open_bus("cluster")
    running = asyncio.create_task(Scheduler(fleet, await open_bus("scheduler"), stop).run())
    for edge in ("e1", "e2"):
        await bus.declare_alive(keys.edge_alive(edge))
        await offer_nonsense(bus, edge, "r1")
    for number in range(3):
        await come(bus, f"r{number}", (6.0 * number, 0.0, 0.0))
    await come(bus, "r3", (1e12, 0.0, 0.0))
    said: SchedulerStatus | None = None
    async with asyncio.timeout(60):
        async for received in bus.watch(keys.SCHEDULER_STATUS):
            assert not running.done()
            said = received.message if isinstance(received.message, SchedulerStatus) else None
            if said is not None and said.plans > 2:
                break
    assert said is not None
    assert any(problem.startswith(("edge/e1: sketch of r1", "edge/e2: sketch of r1")) for problem in said.problems)
    assert any(problem.startswith("robot/r3: ") for problem in said.problems)
    assert "plans failed" not in said.counters
    stop.set()
    await running
