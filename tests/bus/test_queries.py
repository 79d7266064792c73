from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest
import zenoh
from probes import STREAM, OpenBus, claims, number, routes

from common.bus import Bus, keys
from common.bus.server import MAX_PENDING, MAX_RUNNING
from common.bus.settings import node_config
from common.errors import QueryFailed, UsageError
from common.wire import FramePage, Message, decode
from common.wire.limits import MAX_MESSAGE_BYTES

pytestmark = pytest.mark.timeout(40)
BACKFILL = keys.robot_backfill("r1")


def page(data: bytes = b"", next_one: int | None = None) -> FramePage:
    return FramePage(robot="r1", stream=STREAM, frames=(data,), oldest=0, next=next_one)


async def paged(key: str, params: Mapping[str, str]) -> Message | None:
    """Ten pages of 256 KB, numbered."""
    n = int(params.get("cursor", params["from"]))
    return page(bytes([n]) * 256 * 1024, n + 1 if n < 9 else None)


async def test_pages_come_one_after_the_other_until_the_last(open_bus: OpenBus) -> None:
    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(keys.robot_backfill("r1"), paged)
    got = [one async for one in edge.pages(BACKFILL, {"from": 2})]
    assert [one.frames[0][0] for one in got if isinstance(one, FramePage)] == list(range(2, 10))
    assert robot.counters.served == 8


async def test_a_reply_of_the_largest_size_comes_through(open_bus: OpenBus) -> None:
    async def big(key: str, params: Mapping[str, str]) -> Message:
        return page(bytes(MAX_MESSAGE_BYTES - 1000))

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(BACKFILL, big)
    [received] = await edge.get(BACKFILL, {"x": 1})
    assert received.size > MAX_MESSAGE_BYTES - 1000


async def test_an_error_in_the_handler_reaches_the_asker_and_the_log(
    open_bus: OpenBus, caplog: pytest.LogCaptureFixture
) -> None:
    async def fails(key: str, params: Mapping[str, str]) -> Message:
        if "reason" in params:
            raise UsageError("no such stream")
        if "big" in params:
            return page(bytes(MAX_MESSAGE_BYTES))
        raise ZeroDivisionError("oops")

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(keys.robot_backfill("*"), fails)
    for params, reason in (
        ({"x": 1}, "robot/r1/backfill: ZeroDivisionError: oops"),
        ({"reason": 1}, "robot/r1/backfill: no such stream"),
        ({"big": 1}, "send it in pages"),
    ):
        with pytest.raises(QueryFailed, match=reason):
            await edge.get(BACKFILL, params)
        with pytest.raises(QueryFailed, match=reason):
            _ = [one async for one in edge.pages(BACKFILL, params)]
    assert robot.counters.failed == 6
    assert robot.counters.served == 0
    assert any(record.exc_info for record in caplog.records)


async def test_nobody_there_is_told_at_once(open_bus: OpenBus) -> None:
    edge = await open_bus("edge")
    assert await edge.get(BACKFILL, timeout_s=1000) == []
    with pytest.raises(QueryFailed, match="robot/r1/backfill: nobody answers"):
        _ = [one async for one in edge.pages(BACKFILL, {}, timeout_s=1000)]


async def test_an_answer_that_does_not_come_is_told_after_the_timeout(open_bus: OpenBus) -> None:
    async def never(key: str, params: Mapping[str, str]) -> Message:
        await asyncio.Event().wait()
        raise AssertionError

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(BACKFILL, never)
    with pytest.raises(QueryFailed, match=r"no answer within 0\.2 s"):
        await edge.get(BACKFILL, {"x": 1}, timeout_s=0.2)


async def test_an_owner_that_leaves_in_the_middle_is_told_at_once(open_bus: OpenBus) -> None:
    asked = asyncio.Event()

    async def never(key: str, params: Mapping[str, str]) -> Message:
        asked.set()
        await asyncio.Event().wait()
        raise AssertionError

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(BACKFILL, never)
    query = asyncio.create_task(edge.get(BACKFILL, {"x": 1}, timeout_s=1000))
    await asked.wait()
    await robot.close()
    assert await query == []


async def test_a_cancelled_query_ends_at_once_and_harms_nothing(open_bus: OpenBus) -> None:
    asked = asyncio.Event()

    async def slow(key: str, params: Mapping[str, str]) -> Message:
        if "quick" not in params:
            asked.set()
            await asyncio.Event().wait()
        return page()

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(BACKFILL, slow)
    query = asyncio.create_task(edge.get(BACKFILL, {"x": 1}, timeout_s=1000))
    await asked.wait()
    query.cancel()
    with pytest.raises(asyncio.CancelledError):
        await query
    assert await edge.get(BACKFILL, {"quick": 1})


async def test_handlers_run_side_by_side_but_not_without_bound(open_bus: OpenBus) -> None:
    running, peak, full, go = 0, 0, asyncio.Event(), asyncio.Event()

    async def busy(key: str, params: Mapping[str, str]) -> Message:
        nonlocal running, peak
        running += 1
        peak = max(peak, running)
        if running == MAX_RUNNING:
            full.set()
        await go.wait()
        running -= 1
        return page()

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(BACKFILL, busy)
    asks = [asyncio.create_task(edge.get(BACKFILL, {"x": n}, timeout_s=30)) for n in range(MAX_PENDING + 50)]
    await full.wait()
    while robot.counters.failed < 50:  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    go.set()
    answers = await asyncio.gather(*asks, return_exceptions=True)
    refused = [str(one) for one in answers if isinstance(one, QueryFailed)]
    assert peak == MAX_RUNNING
    assert len(refused) == 50
    assert all("busy" in one for one in refused)
    assert sum(isinstance(one, list) and len(one) == 1 for one in answers) == MAX_PENDING


@pytest.mark.parametrize("served_first", [True, False])
@pytest.mark.parametrize("key_expr", [keys.edge_map("e1"), keys.edge_map("*"), "edge/**"])
async def test_a_key_has_a_notice_for_a_plain_get_and_tiles_for_one_with_parameters(
    open_bus: OpenBus, served_first: bool, key_expr: str
) -> None:
    calls = 0

    async def tiles(key: str, params: Mapping[str, str]) -> Message:
        nonlocal calls
        calls += 1
        assert key == keys.edge_map("e1")
        return claims("e1", int(params["since"]))

    edge, cloud = await open_bus("edge"), await open_bus("cloud")
    if served_first:
        await edge.serve(key_expr, tiles)
    await edge.latch(keys.edge_map("e1"), claims("e1", 1))
    await edge.latch(keys.edge_map("e1"), claims("e1", 2))
    if not served_first:
        await edge.serve(key_expr, tiles)
    for everyone in (True, False):
        assert [number(one) for one in await cloud.get(keys.edge_map("e1"), everyone=everyone)] == [2]
        assert [number(one) for one in await cloud.get(keys.edge_map("e1"), {"since": 7}, everyone=everyone)] == [7]
    assert calls == 2
    assert [number(one) for one in await cloud.get("**", everyone=True)] == [2]


async def test_the_same_key_is_not_served_twice(open_bus: OpenBus) -> None:
    robot = await open_bus("robot")
    await robot.serve(BACKFILL, paged)
    with pytest.raises(UsageError, match="served already"):
        await robot.serve(BACKFILL, paged)


async def test_a_handler_with_nothing_to_give_gives_an_empty_answer(open_bus: OpenBus) -> None:
    async def nothing(key: str, params: Mapping[str, str]) -> None:
        return None

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(keys.robot_backfill("*"), nothing)
    assert await edge.get(BACKFILL, {"x": 1}) == []
    with pytest.raises(QueryFailed, match="ask for one key"):
        await edge.get(keys.robot_backfill("*"), {"x": 1})


async def test_parameters_arrive_as_they_were_given(open_bus: OpenBus) -> None:
    got: dict[str, str] = {}

    async def remember(key: str, params: Mapping[str, str]) -> Message:
        got.update(params)
        return page()

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(BACKFILL, remember)
    given = {"stream": STREAM, "from": 3, "to": -1, "cursor": "12:-3,4", "text": "a=b&c /%20é?", "empty": ""}
    await edge.get(BACKFILL, given)
    assert got == {name: str(value) for name, value in given.items()}
    for bad in ({"a": "x;y"}, {"a": "x|y"}, {"a;b": "x"}, {"": "x"}, {"a": "#"}):
        with pytest.raises(UsageError, match="leave out"):
            await edge.get(BACKFILL, bad)


async def test_pages_that_go_round_in_a_circle_are_left(open_bus: OpenBus) -> None:
    async def circle(key: str, params: Mapping[str, str]) -> Message:
        return page(next_one=1)

    robot, edge = await open_bus("robot"), await open_bus("edge")
    await robot.serve(BACKFILL, circle)
    with pytest.raises(QueryFailed, match="circle"):
        _ = [one async for one in edge.pages(BACKFILL, {"x": 1})]


async def test_an_answer_that_is_no_message_is_refused(open_bus: OpenBus, endpoint: str, root: str) -> None:
    edge = await open_bus("edge")
    with zenoh.open(node_config(endpoint, name="stranger", role="test", connect_s=2)) as stranger:

        def junk(query: zenoh.Query) -> None:
            with query:
                if "error" in query.parameters:
                    query.reply_err(b"junk")
                else:
                    query.reply(query.key_expr, b"junk")

        stranger.declare_queryable(f"{root}/{BACKFILL}", junk)
        await settled(edge)
        with pytest.raises(QueryFailed, match="not msgpack"):
            await edge.get(BACKFILL)
        with pytest.raises(QueryFailed, match="no Refusal"):
            await edge.get(BACKFILL, {"error": 1})
    assert edge.counters.refused == {"robot/r1": 1}


async def settled(edge: Bus) -> None:
    """Until the stranger's queryable is known."""
    while True:
        try:
            if await edge.get(BACKFILL, {"error": 1}):
                return
        except QueryFailed:
            return


async def test_a_stranger_reads_latched_values_and_refusals(open_bus: OpenBus, endpoint: str, root: str) -> None:
    scheduler = await open_bus("scheduler")
    await scheduler.latch(keys.SCHEDULER_ROUTES, routes(4))
    with zenoh.open(node_config(endpoint, name="stranger", role="test", connect_s=2)) as stranger:
        replies = await asyncio.to_thread(lambda: list(stranger.get(f"{root}/{keys.SCHEDULER_ROUTES}")))
        assert [decode(reply.ok.payload.to_bytes()) for reply in replies if reply.ok] == [routes(4)]
