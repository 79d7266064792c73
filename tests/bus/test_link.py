from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Mapping

import pytest
from probes import STREAM, OpenBus, Start, frame, freeze, hear, introduce, number, routes

from common.bus import Alive, Bus, Link, Router, keys
from common.errors import RouterUnreachable, UsageError
from common.wire import FramePage, Message

pytestmark = pytest.mark.timeout(40)


@pytest.mark.parametrize("listen", ["tcp/127.0.0.1:1", "tcp/no-such-host.invalid:7447"])
async def test_no_router_is_told_by_its_endpoint_in_time(listen: str) -> None:
    async with asyncio.timeout(3):
        with pytest.raises(RouterUnreachable, match=f"{listen} within 0.3 s"):
            await Bus.open(listen, name="a", role="test", timeout_s=0.3)


async def test_a_silent_router_is_told_in_time() -> None:
    server = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0)
    async with server, asyncio.timeout(5):
        listen = f"tcp/127.0.0.1:{server.sockets[0].getsockname()[1]}"
        with pytest.raises(RouterUnreachable, match=listen):
            await Bus.open(listen, name="a", role="test", timeout_s=0.3)
        server.close()


async def test_what_is_no_endpoint_is_told_at_once() -> None:
    with pytest.raises(UsageError, match="is no endpoint") as told:
        await Bus.open("localhost", name="a", role="test", timeout_s=1000)
    assert ".rs" not in str(told.value), "no place in a source that is not ours"


async def test_a_router_that_comes_late_is_found(start: Start, root: str) -> None:
    router, listen = start("route", "tcp/127.0.0.1:0", root)
    router.kill()
    router.wait()
    opening = asyncio.create_task(Bus.open(listen, name="a", role="test", root=root, timeout_s=30))
    await asyncio.sleep(0)
    start("route", listen, root)
    await (await opening).close()


async def test_a_cancelled_opening_leaves_nothing(start: Start, root: str) -> None:
    router, listen = start("route", "tcp/127.0.0.1:0", root)
    freeze(router)
    opening = asyncio.create_task(Bus.open(listen, name="a", role="test", root=root, timeout_s=1000))
    await asyncio.sleep(0.1)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening


async def test_a_port_in_use_is_told() -> None:
    async with await Router.open() as router:
        with pytest.raises(UsageError, match=r"cannot listen on .*Address already in use") as told:
            await Router.open(router.endpoint)
    assert ".rs" not in str(told.value)


async def page(key: str, params: Mapping[str, str]) -> Message:
    return FramePage(robot="r1", stream=STREAM, frames=(), oldest=0)


async def test_everything_recovers_when_the_router_is_killed_and_restarted(start: Start, root: str) -> None:
    router, listen = start("route", "tcp/127.0.0.1:0", root)
    async with (
        await Bus.open(listen, name="one", role="test", root=root) as one,
        await Bus.open(listen, name="other", role="test", root=root) as other,
    ):
        link, tokens = other.watch_link(), other.watch_alive("**")
        watched, stream = other.watch(keys.SCHEDULER_ROUTES), other.subscribe(keys.robot_frames("*"))
        await one.declare_alive(keys.robot_alive("r1"))
        await one.serve(keys.robot_backfill("r1"), page)
        await one.latch(keys.SCHEDULER_ROUTES, routes(1))
        assert number(await anext(watched)) == 1
        assert await anext(link) == Link(True)
        assert await anext(tokens) == Alive("robot/r1/alive", True)

        router.kill()
        router.wait()
        assert await anext(link) == Link(False)
        assert await anext(tokens) == Alive("robot/r1/alive", False)
        assert not other.connected
        while one.connected:  # noqa: ASYNC110  its own event, a moment later
            await asyncio.sleep(0.01)
        one.put(keys.robot_frames("r1"), frame("r1", 2))
        await one.latch(keys.SCHEDULER_ROUTES, routes(3))
        assert one.counters.unconnected == 2
        assert await other.get(keys.SCHEDULER_ROUTES, timeout_s=1000) == []

        start("route", listen, root)
        assert await anext(link) == Link(True)
        assert await anext(tokens) == Alive("robot/r1/alive", True)
        assert number(await anext(watched)) == 3  # latched while there was no router
        await hear(one, keys.robot_frames("r1"), frame("r1", 4), stream)
        assert [number(received) for received in await other.get(keys.SCHEDULER_ROUTES)] == [3]
        assert await other.get(keys.robot_backfill("r1"), {"x": 1})


async def test_a_killed_process_is_missed_within_a_second(
    open_bus: OpenBus, endpoint: str, root: str, start: Start
) -> None:
    watcher = await open_bus("watcher")
    tokens, link = watcher.watch_alive("**"), watcher.watch_link()
    holder, ready = start("hold", endpoint, root)
    assert ready == "ready"
    assert await anext(tokens) == Alive("robot/holder/alive", True)
    holder.kill()
    async with asyncio.timeout(1):
        assert await anext(tokens) == Alive("robot/holder/alive", False)
    assert await anext(link) == Link(True)
    assert len(link) == 0  # nobody else's business


async def test_a_frozen_process_is_missed_after_its_lease_and_seen_again(
    open_bus: OpenBus, endpoint: str, root: str, start: Start
) -> None:
    watcher = await open_bus("watcher")
    tokens = watcher.watch_alive("**")
    holder, _ = start("hold", endpoint, root)
    assert (await anext(tokens)).alive
    freeze(holder)
    async with asyncio.timeout(6):
        assert not (await anext(tokens)).alive
    os.kill(holder.pid, signal.SIGCONT)
    async with asyncio.timeout(6):
        assert (await anext(tokens)).alive


async def test_tokens_that_were_there_before_are_told(open_bus: OpenBus) -> None:
    one, other = await open_bus("one"), await open_bus("other")
    for n in range(3):
        await one.declare_alive(keys.edge_alive(f"e{n}"))
    tokens = other.watch_alive(keys.edge_alive("*"))
    assert {await anext(tokens) for _ in range(3)} == {Alive(keys.edge_alive(f"e{n}"), True) for n in range(3)}
    await one.close()
    assert {await anext(tokens) for _ in range(3)} == {Alive(keys.edge_alive(f"e{n}"), False) for n in range(3)}


async def test_a_stopped_watcher_does_not_hold_up_the_others(
    open_bus: OpenBus, endpoint: str, root: str, start: Start
) -> None:
    scheduler, watcher = await open_bus("scheduler"), await open_bus("watcher")
    stream = watcher.subscribe(keys.SCHEDULER_PLAN)
    latched = watcher.watch(keys.SCHEDULER_ROUTES)
    await introduce(scheduler, keys.SCHEDULER_PLAN, stream)
    holder, _ = start("hold", endpoint, root)
    freeze(holder)
    filler = FramePage(robot="r1", stream=STREAM, frames=(bytes(200_000),), oldest=0)
    for n in range(100):  # 20 MB: more than the buffers on the way hold
        scheduler.put(keys.robot_frames("r1"), filler)
        await scheduler.latch(keys.SCHEDULER_ROUTES, routes(n))
        async with asyncio.timeout(1):
            await hear(scheduler, keys.SCHEDULER_PLAN, routes(n), stream)
    while number(await anext(latched)) != 99:
        pass
    assert scheduler.connected
    assert watcher.connected
