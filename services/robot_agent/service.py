"""A robot's agent: acks, routes, queries and finished work become events; what the state decides is carried out."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import AsyncIterator, Mapping

from common.bus import Bus, keys
from common.bus.parameters import number
from common.config import Fleet, RobotEntry
from common.errors import RouterUnreachable, SpoolFull, UsageError
from common.service import living, open_bus, tell_status
from common.telemetry import process_stats
from common.wire import Ack, EndOfStream, FramePage, Message, RobotProfile, RobotStatus, Routes
from common.wire.limits import MAX_PAGE_BYTES
from services.robot_agent.collector import Collector
from services.robot_agent.spool import Spool
from services.robot_agent.state import (
    AckReceived,
    AgentState,
    AnnounceEnd,
    BackfillServed,
    Collect,
    Collected,
    Event,
    Finish,
    Instruction,
    Linger,
    LingerOver,
    RouteChanged,
    SourceEnded,
    Started,
    Trim,
)

PAGE_BYTES = MAX_PAGE_BYTES - 4096
"""frames in one backfill page, so that the page with its other fields stays below the limit"""

log = logging.getLogger(__name__)


class RobotAgent:
    """One robot: collects and spools from the start, streams and serves while there is a router.

    `run` returns once `stop` is set; with `exit_when_processed` the agent sets it itself when the edge has all of an
    ended stream. It raises UsageError when another robot of this name is there already, and what the source raises.
    """

    def __init__(
        self,
        fleet: Fleet,
        entry: RobotEntry,
        collector: Collector,
        spool: Spool,
        stop: asyncio.Event,
        exit_when_processed: bool = False,
    ) -> None:
        self._fleet, self._entry, self._collector, self._spool = fleet, entry, collector, spool
        self._stop = stop
        self.state = AgentState(
            stream=spool.stream,
            window=fleet.edge.window,
            can_wait=collector.can_wait,
            last_seq=spool.now().next_seq - 1,
            durable=spool.now().durable,
            exit_when_processed=exit_when_processed,
        )
        self._bus: Bus | None = None
        """while announced: frames are published from then on"""
        self._bytes_sent = 0
        self._tasks = asyncio.TaskGroup()

    async def run(self) -> None:
        async with self._tasks:
            online = self._tasks.create_task(self._online(), name="online")
            self._feed(Started())
            try:
                await self._stop.wait()
            finally:  # also when a task has failed: the thread that collects must not wait for the next sweep
                self._collector.stop()
                online.cancel()

    def status(self) -> RobotStatus:
        spooled, used = self._spool.now(), process_stats()
        return RobotStatus(
            robot=self._entry.id,
            stream=self._spool.stream,
            sent=spooled.next_seq,
            processed=self.state.processed,
            spooled=spooled.frames,
            spool_bytes=spooled.bytes,
            dropped=spooled.dropped,
            backfilled=self.state.backfilled,
            edge=self.state.edge,
            ended=self.state.ended,
            refused=self._collector.refused,
            pack_s=self._collector.busy_s / max(1, self._collector.packed),
            bytes_sent=self._bytes_sent,
            cpu_s=used.cpu_s,
            rss_mb=used.rss_mb,
            source=self._collector.profile.name,
        )

    # Events in, instructions out

    def _feed(self, event: Event) -> None:
        for instruction in self.state.handle(event):
            self._carry_out(instruction)

    def _carry_out(self, instruction: Instruction) -> None:
        match instruction:
            case Collect(limit):
                if not self._stop.is_set():
                    self._tasks.create_task(self._collect(limit), name="collect")
            case Trim(durable):
                self._tasks.create_task(self._trim(durable), name="trim")
            case AnnounceEnd(last_seq):
                log.info("source has ended", extra={"last_seq": last_seq})
                self._tasks.create_task(self._announce_end(), name="announce end")
            case Linger(number):
                loop = asyncio.get_running_loop()
                loop.call_later(self._fleet.robot.linger_s, self._feed, LingerOver(number))
            case Finish():
                log.info("all is processed", extra={"last_seq": self.state.last_seq})
                self._stop.set()

    async def _collect(self, limit: int) -> None:
        taken = await asyncio.to_thread(self._collector.take, limit)
        if taken.ended:
            self._feed(SourceEnded())
            return
        if self._bus is not None:
            for frame in taken.frames:
                self._bus.put(keys.robot_frames(self._entry.id), frame)
            self._bytes_sent += taken.bytes
        self._feed(Collected(self._spool.now().next_seq - 1))

    async def _trim(self, durable: int) -> None:
        try:
            await asyncio.to_thread(self._spool.trim, durable)
        except SpoolFull as error:  # the next ack tries again
            log.warning("durable frames stay in the spool", extra={"reason": error})

    # With a router

    async def _online(self) -> None:
        bus = await self._connect()
        try:
            await self._refuse_namesake(bus)
            await self._announce(bus)
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._hear_acks(bus), name="acks")
                tasks.create_task(self._hear_routes(bus), name="routes")
                tasks.create_task(self._hear_namesakes(bus), name="namesakes")
                tasks.create_task(tell_status(bus, keys.robot_status(self._entry.id), self.status), name="status")
        finally:
            self._bus = None
            await bus.close()

    async def _connect(self) -> Bus:
        said = False
        while True:
            try:
                return await open_bus(self._fleet, self._entry.id, "robot")
            except RouterUnreachable as error:
                if not said:
                    log.warning("no router yet: spooling", extra={"reason": error})
                said = True

    async def _refuse_namesake(self, bus: Bus) -> None:
        """One with this stream has a copy of this spool."""
        for message in await living(bus, keys.robot_profile(self._entry.id), self._fleet.bus.timeout_s):
            if isinstance(message, RobotProfile):
                raise self._in_use(message.stream)

    async def _hear_namesakes(self, bus: Bus) -> None:
        """Of two that came at the same time, or while one was cut off, the one with the smaller stream stays."""
        async for message in _messages(bus, keys.robot_profile(self._entry.id)):
            if isinstance(message, RobotProfile) and message.stream < self._spool.stream:
                raise self._in_use(message.stream)

    def _in_use(self, stream: str) -> UsageError:
        return UsageError(
            f"robot id {self._entry.id!r} is in use: another robot streams {stream} under it; "
            "stop that one or give this one another --id and a --spool of its own"
        )

    async def _announce(self, bus: Bus) -> None:
        robot = self._entry.id
        profile = RobotProfile(
            robot=robot,
            stream=self._spool.stream,
            sensor=self._collector.profile.sensor,
            range_max=self._collector.profile.range_max,
            start=self._entry.start,
            edges=self._entry.edges,
        )
        await bus.serve(keys.robot_backfill(robot), self._backfill)
        await bus.latch(keys.robot_profile(robot), profile)
        await bus.declare_alive(keys.robot_alive(robot))
        self._bus = bus
        log.info("streaming", extra={"robot": robot, "stream": self._spool.stream, "endpoint": bus.endpoint})
        await self._announce_end()

    async def _announce_end(self) -> None:
        """Also called when the router comes after the end of the source."""
        if self._bus is not None and self.state.ended:
            # first its status: who has seen the end must not find counts from before it
            await self._bus.latch(keys.robot_status(self._entry.id), self.status())
            end = EndOfStream(robot=self._entry.id, stream=self._spool.stream, last_seq=self.state.last_seq)
            await self._bus.latch(keys.robot_end(self._entry.id), end)

    async def _hear_acks(self, bus: Bus) -> None:
        async for message in _messages(bus, keys.edge_ack(keys.ANY, self._entry.id)):
            if isinstance(message, Ack):
                ignored, false = self.state.ignored, self.state.false_acks
                self._feed(AckReceived(message))
                if false == 0 and self.state.false_acks:
                    log.error(
                        "an edge has frames that this spool has not numbered, as if it were an old copy: "
                        "stop the robot and move the spool away, so that a new stream begins",
                        extra={"spool": self._spool.path, "ack": message},
                    )
                elif ignored == 0 and self.state.ignored:
                    log.warning("ack ignored; further ones are only counted", extra={"ack": message})

    async def _hear_routes(self, bus: Bus) -> None:
        async for message in _messages(bus, keys.SCHEDULER_ROUTES):
            route = message.routes.get(self._entry.id) if isinstance(message, Routes) else None
            if route is not None:
                self._feed(RouteChanged(route.slam_edge, route.epoch))

    async def _backfill(self, key: str, params: Mapping[str, str]) -> Message:
        """Frames `from` .. `to` of `stream`, a page at a time; a page's `next` is where the page after it begins.

        `probe` asks for so many bytes that mean nothing instead: an edge measures the link.
        """
        spool = self._spool
        if "probe" in params:
            noise = os.urandom(min(number(params, "probe"), PAGE_BYTES))
            return FramePage(robot=self._entry.id, stream=spool.stream, frames=(noise,), oldest=spool.now().oldest)
        stream = params.get("stream", spool.stream)
        if stream != spool.stream:
            raise UsageError(f"robot {self._entry.id} streams {spool.stream}, not {stream}; take its stream from zero")
        start = number(params, "cursor", number(params, "from"))
        known = self.state.last_seq  # no frame is acknowledged before the state has heard of it
        end = min(known, number(params, "to", known))
        page, following = await asyncio.to_thread(spool.read, start, PAGE_BYTES, end)
        frames = tuple(data for _, data in page)
        self._bytes_sent += sum(len(data) for data in frames)
        self._feed(BackfillServed(len(frames)))
        return FramePage(robot=self._entry.id, stream=stream, frames=frames, oldest=spool.now().oldest, next=following)


async def _messages(bus: Bus, key_expr: str) -> AsyncIterator[Message]:
    async for received in bus.watch(key_expr):
        yield received.message
