"""What an edge goes on doing while one of its workers does nothing."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping

import pytest
from edge_samples import STREAM, frame, profile, routes

from common.bus import Bus, keys
from common.config import Fleet
from common.wire import FramePage, MapNotice, Message, encode
from services.edge_worker.service import EdgeWorker

OpenBus = Callable[..., Awaitable[Bus]]
HOST = "tests.edge.stubborn_host:StuckHost"


@pytest.fixture
async def edge(open_bus: OpenBus) -> AsyncIterator[EdgeWorker]:
    """Two workers that stick at their first scan."""
    fleet, stop = Fleet(edge={"map_every_s": 0.05, "scan_limit_s": 1e6, "probe_every_s": 0}), asyncio.Event()
    edge = EdgeWorker(fleet, "e1", await open_bus("e1"), 2, stop)
    edge._pool._target = HOST
    running = asyncio.create_task(edge.run())
    yield edge
    stop.set()
    await running


async def test_a_worker_that_is_stuck_on_a_scan_holds_up_no_maps_of_other_workers(
    edge: EdgeWorker, open_bus: OpenBus
) -> None:
    fleet, sent = await open_bus("fleet"), asyncio.Event()

    async def spool(key: str, params: Mapping[str, str]) -> Message:
        frames = () if not sent.is_set() or keys.robot_of(key) != "r1" else (encode(frame(0, "r1")),)
        return FramePage(robot=keys.robot_of(key), stream=STREAM, frames=frames, oldest=0)

    await fleet.serve(keys.robot_backfill(keys.ANY), spool)
    for robot in ("r1", "r2"):
        await fleet.latch(keys.robot_profile(robot), profile(robot))
    await fleet.latch(keys.SCHEDULER_ROUTES, routes(1, {"r1": "e1", "r2": "e1"}, {"r1": "e9", "r2": "e9"}))
    stuck: list[int] = []
    async with asyncio.timeout(60):
        async for received in fleet.watch(keys.edge_robot_map("e1", "r2")):
            assert isinstance(received.message, MapNotice)
            sent.set()
            if edge.state.instances["r1"].in_flight:
                stuck.append(received.message.version)
            if len(stuck) > 5:
                break
    assert stuck == sorted(set(stuck))
