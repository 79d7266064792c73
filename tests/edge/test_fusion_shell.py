"""What an edge's fusion lives through: maps that say nothing of themselves, and processes that die."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping

import numpy as np
import pytest
from edge_samples import cover, notice, routes

from common.bus import Bus, keys
from common.bus.tiles import tile_page
from common.config import Fleet
from common.grid import Grid
from common.grid.paging import counts_page
from common.grid.versions import first_version
from common.link import LinkMeter
from common.wire import EdgeMapNotice, FixedPose, Message, Placed, Transforms
from common.wire.base import Covers
from services.edge_worker.fusion import Fusion

OpenBus = Callable[..., Awaitable[Bus]]
WITHIN_S = 60.0


class Edge:
    """Fusion at e1 of the map of r1, which runs at e2; `covers` is what e2 says of the map."""

    def __init__(self, fusion: Fusion, heard: Bus) -> None:
        self.fusion, self._heard = fusion, heard
        self.covers: Covers = {"r1": cover(9)}
        self.grid = Grid(0.05, version=3)

    async def tiles(self, key: str, params: Mapping[str, str]) -> Message:
        return tile_page("robot/r1", "counts", counts_page(self.grid, 0, "", 10_000), self.covers, False, 0)

    def told(self, version: int) -> None:
        self.fusion.noticed(notice("r1", "e2", version))

    async def shown(self, wanted: Callable[[EdgeMapNotice], bool] = lambda _: True) -> EdgeMapNotice:
        async with asyncio.timeout(WITHIN_S):
            async for received in self._heard.watch(keys.edge_map("e1")):
                if isinstance(received.message, EdgeMapNotice) and wanted(received.message):
                    return received.message
        raise AssertionError("the bus has closed")


@pytest.fixture
async def edge(open_bus: OpenBus) -> AsyncIterator[Edge]:
    bus, other = await open_bus("e1"), await open_bus("e2")
    fusion = Fusion(Fleet(edge={"map_every_s": 0.05}), "e1", bus, LinkMeter())
    made = Edge(fusion, other)
    await other.serve(keys.edge_robot_map("e2", "r1"), made.tiles)
    await fusion.open()
    running = asyncio.create_task(fusion.run())
    try:
        fusion.routed(routes(1, {"r1": "e2"}, {"r1": "e1"}))
        made.told(1)
        await made.shown(lambda shown: shown.covers == made.covers)
        yield made
        assert not running.done(), "fusion has ended"
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        await fusion.close()


async def test_a_map_that_does_not_say_what_it_contains_is_not_fused_and_harms_nothing(edge: Edge) -> None:
    edge.covers = {}
    edge.told(2)
    placed = {"r1": Placed(transform=FixedPose.of(0.0, 0.0, 0.0), component="r1", version=1)}
    edge.fusion.world_seen(Transforms(world_epoch=4, final=False, resolution=0.05, robots=placed, components=()))
    await edge.shown(lambda shown: shown.world_epoch == 4)
    async with asyncio.timeout(WITHIN_S):
        while not edge.fusion.failures:
            await edge.shown()
    assert edge.fusion.state.held["r1"].notice.version == 1


async def test_a_map_that_cannot_be_fused_is_named_until_it_can(edge: Edge) -> None:
    sound = edge.grid
    edge.grid = Grid(0.05, version=first_version(9))
    edge.grid.replace(((far, far), np.ones((2, 64, 64), np.uint16)) for far in (0, 1000))
    edge.told(2)
    async with asyncio.timeout(WITHIN_S):
        while not edge.fusion.problems():
            await edge.shown()
        (problem,) = edge.fusion.problems()
        assert problem.startswith("robot/r1: its map is not fused: Unmergeable: a map of 64064 x 64064 cells")
        edge.grid = sound
        while edge.fusion.problems():
            await edge.shown()


async def test_a_fusion_process_that_dies_again_as_it_comes_up_is_started_once_more(edge: Edge) -> None:
    (first,) = edge.fusion.pids()
    os.kill(first, signal.SIGKILL)
    second = await another(edge.fusion, first)
    os.kill(second, signal.SIGKILL)
    await another(edge.fusion, second)
    edge.covers = {"r1": cover(11)}
    edge.told(2)
    await edge.shown(lambda shown: shown.covers == edge.covers)


async def another(fusion: Fusion, than: int) -> int:
    """The process that has taken the place of one that was killed."""
    async with asyncio.timeout(WITHIN_S):
        while fusion.pids() in ([], [than]):
            await asyncio.to_thread(os.sched_yield)
    return fusion.pids()[0]
