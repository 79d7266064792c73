from __future__ import annotations

import asyncio
import threading

import pytest
import zenoh
from probes import OpenBus, Start, claims, frame, freeze, hear, introduce, number, real, routes

from common.bus import Bus, Received, Stream, keys
from common.bus.settings import node_config
from common.errors import BadMessage, UsageError
from common.wire import Frame, FramePage
from common.wire.limits import MAX_MESSAGE_BYTES

pytestmark = pytest.mark.timeout(40)


async def test_what_is_put_is_heard_under_its_key(open_bus: OpenBus) -> None:
    robot, edge = await open_bus("robot"), await open_bus("edge")
    stream = edge.subscribe(keys.robot_frames("*"))
    await introduce(robot, keys.robot_frames("r1"), stream)
    robot.put(keys.robot_frames("r1"), frame("r1", 7, 3000))
    received = await real(stream)
    assert received.key == "robot/r1/frames"
    assert isinstance(received.message, Frame)
    assert received.message.seq == 7
    assert received.size > 3000
    assert robot.counters.sent_bytes > 3000
    assert edge.counters.received >= 2


async def test_two_clusters_on_one_router_do_not_hear_each_other(open_bus: OpenBus, root: str) -> None:
    ours, theirs = await open_bus("ours"), await open_bus("theirs", root=f"{root}x")
    within = await open_bus("within", root=f"{root}/robot")
    streams = [bus.watch("**") for bus in (ours, theirs, within)]
    for n, bus in enumerate((ours, theirs, within)):
        await bus.latch(keys.SCHEDULER_ROUTES, routes(n))
    firsts = [await anext(stream) for stream in streams]
    assert [number(first) for first in firsts] == [0, 1, 2]
    assert [first.key for first in firsts] == [keys.SCHEDULER_ROUTES] * 3
    assert await theirs.get("robot/**", everyone=True) == []


async def test_a_slow_consumer_loses_the_oldest_counted_and_stalls_nobody(open_bus: OpenBus) -> None:
    robot, edge = await open_bus("robot"), await open_bus("edge")
    slow = edge.subscribe(keys.robot_frames("*"), depth=16)
    quick = edge.subscribe(keys.edge_pose("e1", "*"))
    await introduce(robot, keys.robot_frames("r1"), slow)
    await introduce(robot, keys.edge_pose("e1", "r1"), quick)
    for seq in range(2000):
        robot.put(keys.robot_frames("r1"), frame("r1", seq))
        if seq % 20 == 0:  # in step with the other stream: it is never behind, however full the slow one is
            await hear(robot, keys.edge_pose("e1", "r1"), claims("e1", seq), quick)
    assert slow.dropped > 1000
    while edge.counters.dropped != slow.dropped:  # noqa: ASYNC110  told on the loop, a turn later
        await asyncio.sleep(0)
    assert quick.dropped == 0
    assert len(slow) == 16
    kept = [(await real(slow)).message for _ in range(16)]
    assert [message.seq for message in kept if isinstance(message, Frame)] == sorted(
        message.seq for message in kept if isinstance(message, Frame)
    )
    assert isinstance(kept[-1], Frame)
    assert kept[-1].seq > 1900


async def test_a_bad_payload_is_counted_named_and_skipped(
    open_bus: OpenBus, endpoint: str, root: str, caplog: pytest.LogCaptureFixture
) -> None:
    robot, edge = await open_bus("robot"), await open_bus("edge")
    stream = edge.subscribe(keys.robot_frames("*"))
    await introduce(robot, keys.robot_frames("r1"), stream)
    stranger = zenoh.open(node_config(endpoint, name="stranger", role="test", connect_s=2))
    try:
        for payload in (b"", b"junk", bytes(MAX_MESSAGE_BYTES + 1)):
            stranger.put(f"{root}/robot/bad/frames", payload, congestion_control=zenoh.CongestionControl.BLOCK)
        stranger.delete(f"{root}/robot/bad/frames", congestion_control=zenoh.CongestionControl.BLOCK)
        while edge.counters.refused["robot/bad"] < 4 or not edge.counters.refused["robot/r1"]:
            robot.put(keys.robot_frames("r1"), frame("r2", 0))
            await hear(robot, keys.robot_frames("r1"), frame("r1", 1), stream)
    finally:
        stranger.close()
    assert set(edge.counters.refused) == {"robot/bad", "robot/r1"}
    assert any("over the limit" in problem for problem in edge.problems)
    assert any("'r2'" in problem for problem in edge.problems)
    assert sum("robot/bad" in record.getMessage() for record in caplog.records) == 1


async def test_a_put_never_waits_for_a_stopped_reader(
    open_bus: OpenBus, endpoint: str, root: str, start: Start
) -> None:
    robot, edge = await open_bus("robot"), await open_bus("edge")
    healthy = edge.subscribe(keys.robot_frames("*"))
    await introduce(robot, keys.robot_frames("r1"), healthy)
    holder, ready = start("hold", endpoint, root)
    assert ready == "ready"
    freeze(holder)
    for seq in range(400):  # 40 MB: more than all buffers on the way to the stopped reader
        await hear(robot, keys.robot_frames("r1"), frame("r1", seq, 100_000), healthy)
    assert robot.connected
    assert edge.connected


async def test_a_flood_leaves_the_loop_to_others(open_bus: OpenBus) -> None:
    edge = await open_bus("edge")
    stream = Stream(asyncio.get_running_loop(), 10_000, lambda n: n, lambda lost: None)
    for n in range(10_000):
        stream.push(n)
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    task = asyncio.create_task(other())
    for n in range(10_000):
        assert await anext(stream) == n
    task.cancel()
    assert turns > 100
    assert edge.connected


async def test_a_closed_stream_ends_and_leaves_the_others(open_bus: OpenBus) -> None:
    bus = await open_bus()
    one, other = bus.watch("**"), bus.watch("**")
    one.close()
    one.close()
    assert [received async for received in one] == []
    await bus.latch(keys.SCHEDULER_ROUTES, routes(1))
    assert number(await anext(other)) == 1


async def test_closing_the_bus_ends_all_streams_and_threads(endpoint: str, root: str) -> None:
    before = set(threading.enumerate())

    async def count(stream: Stream[Received]) -> int:
        return len([received async for received in stream])

    for _ in range(20):
        async with await Bus.open(endpoint, name="a", role="test", root=root) as bus:
            streams = [bus.subscribe("**"), bus.watch("**"), bus.watch("edge/**")]
            events = [bus.watch_alive("**"), bus.watch_link()]
            await bus.latch(keys.SCHEDULER_ROUTES, routes(1))
            await bus.declare_alive(keys.SCHEDULER_ALIVE)
            counts = [asyncio.create_task(count(stream)) for stream in [*streams, *events]]  # type: ignore[list-item]
            await asyncio.sleep(0)
        await bus.close()
        await asyncio.gather(*counts)
    left = [thread.name for thread in set(threading.enumerate()) - before if not thread.name.startswith("asyncio")]
    assert left == []


async def test_a_closed_bus_says_so(open_bus: OpenBus) -> None:
    bus = await open_bus()
    await bus.close()
    with pytest.raises(UsageError, match="closed"):
        bus.put("cloud/map", routes(1))
    with pytest.raises(UsageError, match="closed"):
        await bus.get("cloud/map")
    with pytest.raises(UsageError, match="closed"):
        bus.subscribe("cloud/map")


async def test_a_message_over_the_limit_is_not_sent(open_bus: OpenBus) -> None:
    bus = await open_bus()
    page = FramePage(robot="r1", stream="0" * 32, frames=(bytes(MAX_MESSAGE_BYTES),), oldest=0)
    with pytest.raises(BadMessage, match="send it in pages"):
        bus.put(keys.robot_frames("r1"), page)
    assert bus.counters.sent == 0
