"""Who comes late to a large fleet hears of all of it."""

from __future__ import annotations

import asyncio
import time

from probes import OpenBus

from common.bus import keys
from common.wire import RobotProfile

ROBOTS = 1000


async def test_a_consumer_that_is_slow_just_then_gets_the_latched_values_of_a_thousand_robots(
    open_bus: OpenBus,
) -> None:
    fleet, edge = await open_bus(), await open_bus()
    latched = [RobotProfile(robot=f"r{number}", stream="0" * 32) for number in range(ROBOTS)]
    await asyncio.gather(*(fleet.latch(keys.robot_profile(each.robot), each) for each in latched))
    watched = edge.watch(keys.robot_profile(keys.ANY))
    seen: set[str] = set()
    async with asyncio.timeout(20):
        async for received in watched:
            if not seen:
                time.sleep(0.3)  # noqa: ASYNC251 - holds the loop up, as a large message does
            seen.add(received.key)
            if len(seen) == ROBOTS:
                break
    assert edge.counters.dropped == 0
