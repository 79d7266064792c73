"""Robots come, go and are regrouped while a cluster runs."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path

import pytest
from harness import all_gone, cluster, fleet, has_children

from common.bus import keys
from common.wire import GlobalMapNotice, Routes

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(240)]


def by_room(routes: Routes) -> bool:
    fused = {robot: route.fuse_edge for robot, route in routes.routes.items()}
    if not {"r1", "r2", "r3", "r4"} <= set(fused):
        return False
    return fused["r1"] == fused["r2"] != fused["r3"] == fused["r4"]


async def test_the_robots_of_a_room_are_fused_at_one_edge_and_nobody_is_lost_by_coming_and_going(
    tmp_path: Path,
) -> None:
    # what a laser of 3.5 m sees of a room in so short a time may be ambiguous
    live = fleet(("r1", "r2", "r3", "r4", "r5"), duration_s=40.0, lidar="rplidar_a1", batch=False)
    async with cluster(live, tmp_path) as made:
        finals: list[set[str]] = []

        async def watch() -> None:
            async for received in made.bus.watch(keys.CLOUD_MAP):
                if isinstance(received.message, GlobalMapNotice) and received.message.final:
                    finals.append(set(received.message.covers))

        watching = asyncio.create_task(watch())
        await made.start_all("r5")
        await made.hear(keys.SCHEDULER_ROUTES, Routes, by_room)
        four = {"r1", "r2", "r3", "r4"}
        await made.hear(keys.CLOUD_MAP, GlobalMapNotice, lambda notice: notice.final and four <= set(notice.covers))
        assert await made.stop("r1") == [0]
        status = await made.scheduler_status(lambda status: status.robots.get("r1") == "gone")
        assert status.robots["r2"] == "alive"
        await made.start("r5")
        final = await made.final()
        assert set(final.covers) == four | {"r5"}
        assert all(one <= other for one, other in pairwise(finals))
        watching.cancel()
        assert set(await made.stop()) == {0}
        assert made.faults() == []


@pytest.mark.parametrize("name", ["cloud", "edge-1"])
async def test_a_service_that_is_stopped_while_its_workers_warm_up_ends_at_once(name: str, tmp_path: Path) -> None:
    async with cluster(fleet(), tmp_path) as made:
        await made.start(name)
        pid = made.processes[name].pid
        workers = await has_children(pid)
        assert await made.stop(name) == [0]
        assert await all_gone(workers)
        assert made.faults() == []
