"""A robot's agent against a real router; the tests play its edge."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest
from agents import ENTRY, ROBOT, OpenBus, first, fleet_at, known, running
from list_source import ListSource, sweeps
from router_process import router_process

from common.bus import Bus, keys
from common.errors import PeerError, SpoolFull
from common.wire import Ack, EndOfStream, Frame, FramePage, RobotStatus, Route, Routes, decode
from common.wire.limits import MAX_PAGE_BYTES
from services.robot_agent.collector import Collector
from services.robot_agent.service import RobotAgent
from services.robot_agent.spool import Spool

pytestmark = pytest.mark.timeout(60)


class PlayedEdge:
    """What an edge does with one robot, each step on the test's word."""

    def __init__(self, bus: Bus, name: str = "e1", epoch: tuple[int, int] = (1, 1)) -> None:
        self.bus, self.name, self.epoch = bus, name, epoch
        self.frames = bus.subscribe(keys.robot_frames(ROBOT))

    async def next_frames(self, count: int) -> list[Frame]:
        return [await first(self.frames, Frame) for _ in range(count)]

    async def ack(self, stream: str, processed: int, durable: int = -1, window: int = 64) -> None:
        message = Ack(
            robot=ROBOT,
            edge=self.name,
            stream=stream,
            epoch=self.epoch,
            processed=processed,
            durable=durable,
            window=window,
        )
        await self.bus.latch(keys.edge_ack(self.name, ROBOT), message)

    async def backfill(self, **params: Any) -> list[Frame]:
        asked = {"from": params.pop("start", 0), **params}
        frames: list[Frame] = []
        async for page in self.bus.pages(keys.robot_backfill(ROBOT), asked):
            assert isinstance(page, FramePage)
            assert sum(len(data) for data in page.frames) <= MAX_PAGE_BYTES
            frames += [decode(data) for data in page.frames]  # type: ignore[misc]
        return frames


async def end_of(bus: Bus) -> EndOfStream:
    return await first(bus.watch(keys.robot_end(ROBOT)), EndOfStream)


async def status_when(bus: Bus, wanted: Callable[[RobotStatus], bool]) -> RobotStatus:
    return await first(bus.watch(keys.robot_status(ROBOT)), RobotStatus, wanted)


async def test_frames_arrive_in_order_and_no_farther_than_the_window(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    edge = PlayedEdge(bus)
    async with running(fleet_at(endpoint, root, window=8), tmp_path, sweeps(20)) as agent:
        profile = await known(bus)
        assert (profile.range_max, profile.start) == (8.0, (1.0, 2.0, 0.5))
        await status_when(bus, lambda status: status.sent == 8)
        assert not agent.state.collecting
        await edge.ack(profile.stream, 3, window=8)
        await status_when(bus, lambda status: status.sent == 12)
        await edge.ack(profile.stream, 11, window=100)
        assert (await end_of(bus)).last_seq == 19
        frames = {frame.seq: frame for frame in await edge.backfill(stream=profile.stream)}
        assert sorted(frames) == list(range(20))
        streamed = await edge.next_frames(8)
        assert [frame.seq for frame in streamed] == list(range(streamed[0].seq, streamed[0].seq + 8))


async def test_a_live_robot_is_never_blocked(endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path) -> None:
    bus = await open_bus()
    async with running(fleet_at(endpoint, root, window=2), tmp_path, sweeps(50), can_wait=False):
        assert (await end_of(bus)).last_seq == 49


async def test_who_has_seen_the_end_finds_a_status_that_counts_all_frames(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    async with running(fleet_at(endpoint, root), tmp_path, sweeps(30)):
        await end_of(bus)
        (answer,) = await bus.get(keys.robot_status(ROBOT))
        assert isinstance(answer.message, RobotStatus)
        assert (answer.message.sent, answer.message.ended) == (30, True)


async def test_the_whole_spool_is_backfilled_in_pages_of_bounded_size(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    given = sweeps(60, beams=8000)
    async with running(fleet_at(endpoint, root), tmp_path, given):
        await end_of(bus)
        edge = PlayedEdge(bus)
        frames = await edge.backfill()
        assert [frame.seq for frame in frames] == list(range(60))
        assert [frame.stamp for frame in frames] == [sweep.stamp for sweep in given]
        assert [frame.seq for frame in await edge.backfill(start=50, to=52)] == [50, 51, 52]
        assert await edge.backfill(start=60) == []
        status = await status_when(bus, lambda status: status.backfilled == 63)
        assert status.ended
        assert status.bytes_sent > 63 * 16000


@pytest.mark.parametrize(
    ("params", "reason"),
    [
        ({"stream": "f" * 32}, "streams"),
        ({"to": "x"}, "to='x' is no number of 0 to"),
        ({"start": -1}, "from='-1' is no number of 0 to"),
        ({"cursor": 2**63}, "cursor='9223372036854775808' is no number of 0 to"),
    ],
)
async def test_a_query_that_cannot_be_served_is_refused_with_the_reason(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path, params: dict[str, str], reason: str
) -> None:
    bus = await open_bus()
    async with running(fleet_at(endpoint, root), tmp_path, sweeps(3)):
        await known(bus)
        with pytest.raises(PeerError, match=reason):
            await PlayedEdge(bus).backfill(**params)


async def test_what_is_durable_leaves_the_spool_and_the_rest_stays(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    async with running(fleet_at(endpoint, root), tmp_path, sweeps(30)):
        end = await end_of(bus)
        edge = PlayedEdge(bus)
        await edge.ack(end.stream, processed=25, durable=9)
        status = await status_when(bus, lambda status: status.spooled == 20)
        assert (status.processed, status.dropped, status.edge) == (25, 0, "e1")
        assert [frame.seq for frame in await edge.backfill()] == list(range(10, 30))


async def test_a_disk_too_full_to_trim_does_not_end_the_robot(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(spool: Spool, durable: int) -> None:
        raise SpoolFull("disk is full")

    bus = await open_bus()
    async with running(fleet_at(endpoint, root), tmp_path, sweeps(30)):
        end = await end_of(bus)
        with monkeypatch.context() as full:
            full.setattr(Spool, "trim", refuse)
            await PlayedEdge(bus).ack(end.stream, processed=25, durable=9)
            await status_when(bus, lambda status: status.processed == 25)
        await PlayedEdge(bus).ack(end.stream, processed=26, durable=10)
        await status_when(bus, lambda status: status.spooled == 19)


async def test_a_spool_that_is_an_old_copy_is_told_to_the_operator(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bus = await open_bus()
    async with running(fleet_at(endpoint, root), tmp_path, sweeps(3)) as agent:
        end = await end_of(bus)
        await PlayedEdge(bus).ack(end.stream, processed=100)
        await until(lambda: agent.state.false_acks == 1)
    assert "move the spool away, so that a new stream begins" in caplog.text


async def test_after_a_hand_over_the_old_edge_is_not_heard_and_the_new_one_gets_all_that_it_lacks(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    async with running(fleet_at(endpoint, root), tmp_path, sweeps(30)) as agent:
        end = await end_of(bus)
        old, new = PlayedEdge(bus), PlayedEdge(bus, "e2", epoch=(1, 2))
        await old.ack(end.stream, processed=29, durable=9)
        await status_when(bus, lambda status: status.processed == 29)
        route = Route(slam_edge="e2", fuse_edge="e2", epoch=(1, 2))
        await bus.latch(keys.SCHEDULER_ROUTES, Routes(epoch=(1, 2), routes={ROBOT: route}))
        await status_when(bus, lambda status: status.edge == "e2")
        await old.ack(end.stream, processed=29, durable=29)
        await new.ack(end.stream, processed=9, durable=9)
        await status_when(bus, lambda status: status.processed == 9)
        assert agent.state.stale_acks == 1
        assert [frame.seq for frame in await new.backfill(start=10)] == list(range(10, 30))


async def test_a_robot_told_to_leaves_once_the_edge_has_everything(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    stop = asyncio.Event()
    with Spool(tmp_path / "s", ROBOT, 2**30) as spool:
        collector = Collector(ListSource(sweeps(10)), spool)
        agent = RobotAgent(fleet_at(endpoint, root), ENTRY, collector, spool, stop, exit_when_processed=True)
        task = asyncio.create_task(agent.run())
        end = await end_of(bus)
        assert not task.done()
        await PlayedEdge(bus).ack(end.stream, processed=9)
        await task


async def test_a_robot_alone_spools_and_streams_when_the_router_comes(root: str, tmp_path: Path) -> None:
    with router_process() as endpoint:
        pass
    async with running(fleet_at(endpoint, root, timeout_s=0.3), tmp_path, sweeps(10)) as agent:
        await until(lambda: agent.state.ended)
        with router_process(endpoint):
            async with await Bus.open(endpoint, name="e1", role="edge", root=root) as bus:
                assert (await end_of(bus)).last_seq == 9
                assert [frame.seq for frame in await PlayedEdge(bus).backfill()] == list(range(10))


async def test_a_router_that_is_killed_and_comes_back_costs_no_frame(root: str, tmp_path: Path) -> None:
    async with AsyncExitStack() as stack:
        with router_process() as endpoint:
            agent = await stack.enter_async_context(running(fleet_at(endpoint, root, window=8), tmp_path, sweeps(30)))
            await until(lambda: agent.status().sent == 8)
        with router_process(endpoint):
            async with await Bus.open(endpoint, name="e1", role="edge", root=root) as bus:
                edge = PlayedEdge(bus)
                await edge.ack((await known(bus)).stream, processed=7)
                assert (await end_of(bus)).last_seq == 29
                assert [frame.seq for frame in await edge.backfill()] == list(range(30))


async def until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110 - what is waited for happens inside the agent
        await asyncio.sleep(0.005)


async def test_a_probe_is_answered_with_so_many_bytes_that_count_as_no_frames(
    endpoint: str, root: str, open_bus: OpenBus, tmp_path: Path
) -> None:
    bus = await open_bus()
    async with running(fleet_at(endpoint, root), tmp_path, sweeps(3)) as agent:
        await end_of(bus)
        sent = agent.status().bytes_sent
        for asked, given in ((1000, 1000), (10**9, MAX_PAGE_BYTES - 4096)):
            (answer,) = await bus.get(keys.robot_backfill(ROBOT), {"probe": asked})
            assert isinstance(answer.message, FramePage)
            assert [len(data) for data in answer.message.frames] == [given]
        assert (agent.status().backfilled, agent.status().bytes_sent) == (0, sent)
