from __future__ import annotations

from collections.abc import Mapping

import pytest
from probes import OpenBus, claims, hear, number, routes

from common.bus import keys

pytestmark = pytest.mark.timeout(40)
KEY = keys.SCHEDULER_ROUTES


async def test_a_late_joiner_gets_the_last_value_and_then_the_new_ones(open_bus: OpenBus) -> None:
    scheduler, late = await open_bus("scheduler"), await open_bus("late")
    for n in range(5):
        await scheduler.latch(KEY, routes(n))
    stream = late.watch("scheduler/*")
    assert number(await anext(stream)) == 4
    await scheduler.latch(KEY, routes(5))
    assert number(await anext(stream)) == 5


async def test_one_who_came_before_the_publisher_gets_its_first_value(open_bus: OpenBus) -> None:
    early = await open_bus("early")
    stream = early.watch("scheduler/*")
    await (await open_bus("scheduler")).latch(KEY, routes(1))
    assert number(await anext(stream)) == 1


async def test_a_restarted_publisher_is_heard_again(open_bus: OpenBus) -> None:
    watcher, first = await open_bus("watcher"), await open_bus("first")
    stream = watcher.watch(KEY)
    for n in range(3):
        await first.latch(KEY, routes(n))
        assert number(await anext(stream)) == n
    await first.close()
    second = await open_bus("second")
    await second.latch(KEY, routes(10))
    assert number(await anext(stream)) == 10


async def test_a_plain_get_reads_the_last_value(open_bus: OpenBus) -> None:
    scheduler, reader = await open_bus("scheduler"), await open_bus("reader")
    for n in range(3):
        await scheduler.latch(KEY, routes(n))
        assert [number(received) for received in await reader.get(KEY)] == [n]


async def test_a_wildcard_get_reads_the_values_of_all(open_bus: OpenBus) -> None:
    reader = await open_bus("reader")
    for n in range(3):
        edge = await open_bus(f"e{n}")
        await edge.latch(keys.edge_claims(f"e{n}"), claims(f"e{n}", n))
        await edge.latch(keys.edge_status(f"e{n}"), claims(f"e{n}", 10 + n))
    received = await reader.get(keys.edge_claims("*"), everyone=True)
    assert sorted((one.key, number(one)) for one in received) == [(keys.edge_claims(f"e{n}"), n) for n in range(3)]


async def test_one_who_watches_hears_plain_puts_too(open_bus: OpenBus) -> None:
    sender, watcher = await open_bus("sender"), await open_bus("watcher")
    await hear(sender, KEY, routes(1), watcher.watch(KEY))


async def test_a_value_that_is_gone_with_its_owner_is_read_no_more(open_bus: OpenBus) -> None:
    scheduler, reader = await open_bus("scheduler"), await open_bus("reader")
    await scheduler.latch(KEY, routes(1))
    assert await reader.get(KEY)
    await scheduler.close()
    while await reader.get(KEY):
        pass


@pytest.mark.parametrize("served", [True, False])
async def test_a_value_taken_back_is_found_no_more_and_can_be_set_again(open_bus: OpenBus, served: bool) -> None:
    async def nothing(key: str, params: Mapping[str, str]) -> None:
        return None

    edge, reader = await open_bus("edge"), await open_bus("reader")
    if served:
        await edge.serve("scheduler/**", nothing)
    await edge.latch(KEY, routes(1))
    await edge.latch(keys.SCHEDULER_PLAN, routes(2))
    await edge.unlatch(KEY)
    await edge.unlatch(KEY)
    assert await reader.get(KEY) == []
    stream = reader.watch("scheduler/*")
    assert number(await anext(stream)) == 2
    await edge.latch(KEY, routes(3))
    assert number(await anext(stream)) == 3
    assert [number(received) for received in await reader.get(KEY)] == [3]
