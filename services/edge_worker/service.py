"""An edge worker: the thin shell around two state machines, one for SLAM and one for preparative fusion.

What comes from the bus and from the processes becomes events; instructions are carried out here. Nothing is computed
in this process: SLAM runs in the pool, fusion in a process of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import time
from collections.abc import Coroutine
from functools import partial
from typing import Any

from common.bus import Bus, Stream, keys
from common.bus.intake import Received
from common.config import Fleet
from common.errors import BadMessage, PeerError, WorkerDied
from common.link import LinkMeter
from common.presence import Linked, RobotSeen
from common.service import Service
from common.wire import (
    Ack,
    EdgeStatus,
    EndOfStream,
    Frame,
    FramePage,
    MapNotice,
    RobotProfile,
    Routes,
    Transforms,
    decode,
)
from services.edge_worker import state as slam
from services.edge_worker.fusion import Fusion
from services.edge_worker.instructions import (
    Acknowledge,
    Claim,
    Feed,
    Fetch,
    Finish,
    GiveUp,
    Instruction,
    Keep,
    Listen,
    Open,
    Release,
)
from services.edge_worker.kernels import Kernels
from services.edge_worker.pool import Pool
from services.edge_worker.probing import Probes
from services.edge_worker.report import Report
from services.edge_worker.robot_maps import RobotMaps
from services.edge_worker.state import EdgeState

TICK_S = 0.5

log = logging.getLogger(__name__)


class EdgeWorker(Service):
    """One edge; `run` returns when `stop` is set."""

    def __init__(self, fleet: Fleet, edge: str, bus: Bus, workers: int, stop: asyncio.Event) -> None:
        super().__init__(bus, stop)
        self._fleet, self.edge, config = fleet, edge, fleet.edge
        self.state = EdgeState(
            edge,
            workers,
            config.window,
            first_life=secrets.randbits(31),
            lease_s=config.lease_s,
            keep_frames=config.checkpoint_frames,
            keep_s=config.checkpoint_s,
        )
        self.links = LinkMeter()
        self._pool = Pool(workers, fleet.slam.kernel, fleet.edge.scan_limit_s, self._worker_died)
        self._fusion = Fusion(fleet, edge, bus, self.links)
        self.maps = RobotMaps(edge, self.state, self._pool, bus)
        self._frames: dict[str, Stream[Received]] = {}
        self._dropped = 0
        """frames of robots that have been released, of those that the bus dropped"""
        self._report = Report(self.state, self._pool, self._fusion, self.maps, bus, self.links)
        self._kernels = Kernels(fleet, self.state, self._pool, bus, self._report.problem)

    async def _open(self) -> None:
        await self._refuse_second(keys.edge_status(self.edge), self._fleet.bus.timeout_s)
        await self._pool.open()
        await self._fusion.open()
        await self.maps.open()
        await self.bus.declare_alive(keys.edge_alive(self.edge))

    def _begin(self) -> None:
        self._follow(
            keys.SCHEDULER_ROUTES,
            keys.robot_profile(keys.ANY),
            keys.robot_end(keys.ANY),
            keys.CLOUD_TRANSFORMS,
            keys.edge_robot_map(keys.ANY, keys.ANY),
        )
        self._follow_presence(keys.robot_alive(keys.ANY))
        self._every(TICK_S, lambda: self._feed(slam.Tick(time.monotonic())), "tick")
        for worker in range(self.state.workers):
            self._every(self._fleet.edge.map_every_s, partial(self.maps.tell_all, worker), f"maps of worker {worker}")
        self._start(self._pool.watch(), "SLAM workers")
        self._start(self._fusion.run(), "fusion")
        self._tell_status(keys.edge_status(self.edge), self._status)
        if every_s := self._fleet.edge.probe_every_s:
            self._start(Probes(self.edge, self.bus, self.state, self.links, every_s).run(), "probes")

    async def _close(self) -> None:
        await self._pool.close()
        await self._fusion.close()

    # Events in

    def _heard(self, received: Received) -> None:
        match received.message:
            case Routes() as routes:
                self._feed(slam.Routed(routes))
                self._fusion.routed(routes)
            case RobotProfile() as profile:
                self._feed(slam.Profiled(profile))
            case EndOfStream() as end:
                self._feed(slam.Ended(end))
            case MapNotice() as notice:
                self._fusion.noticed(notice)
            case Transforms() as transforms:
                self._fusion.world_seen(transforms)

    async def _follow_frames(self, robot: str, stream: Stream[Received]) -> None:
        async for received in stream:
            if isinstance(received.message, Frame):
                if received.sent_s:
                    self.maps.delayed(robot, time.time() - received.sent_s)
                self._feed(slam.FrameCame(received.message))

    def _seen(self, tier: str, name: str, alive: bool) -> None:
        self._feed(RobotSeen(name, alive, time.monotonic()))

    def _linked(self, up: bool) -> None:
        self._feed(Linked(up, time.monotonic()))

    # Instructions out

    def _feed(self, event: slam.Event) -> None:
        for instruction in self.state.handle(event):
            self._carry_out(instruction)

    def _carry_out(self, step: Instruction | Claim) -> None:
        match step:
            case Listen(robot):
                if robot not in self._frames:
                    stream = self._frames[robot] = self.bus.subscribe(keys.robot_frames(robot), depth=1024)
                    self._start(self._follow_frames(robot, stream), f"frames of {robot}")
            case Open():
                self._start(self._answered(self._kernels.open(step)), f"open {step.robot}")
            case Feed():
                self._start(self._answered(self._kernels.process(step)), f"scan of {step.robot}")
            case Keep():
                self._start(self._answered(self._kernels.keep(step)), f"keep {step.robot}")
            case Finish():
                self._start(self._finish(step), f"finish {step.robot}")
            case Fetch():
                self._start(self._fetch(step), f"fetch from {step.robot}")
            case Acknowledge(robot):
                self._start(self._acknowledge(robot), f"ack to {robot}")
            case GiveUp(robot, _, seq):
                last = f"vanished at frame {seq}" if seq >= 0 else "vanished, and nothing of it is left"
                log.warning("robot given up", extra={"robot": robot, "frame": seq})
                self._report.problem(f"robot/{robot}: {last}; its map is final as it is, until it comes back")
            case Claim():
                self._start(self.bus.latch(keys.edge_claims(self.edge), self.state.claims()), "claims")
            case Release(robot):
                stream = self._frames.pop(robot)
                stream.close()
                self._dropped += stream.dropped
                self.maps.forget(robot)
                self._start(self._release(step), f"close {robot}")

    async def _answered(self, work: Coroutine[Any, Any, slam.Event | None]) -> None:
        event = await work
        if event is not None:
            self._feed(event)

    def _worker_died(self, number: int, how: str) -> None:
        self._report.problem(f"SLAM worker {number} {how}; its robots go on from their checkpoints")
        self._feed(slam.WorkerDied(number))

    async def _fetch(self, step: Fetch) -> None:
        params: dict[str, str | int] = {"from": step.start}
        if step.stream:
            params["stream"] = step.stream
        begin = time.monotonic()
        try:
            answers = await self.bus.get(keys.robot_backfill(step.robot), params)
        except PeerError as error:
            log.debug("backfill failed", extra={"robot": step.robot, "reason": error})
            answers = []
        page = answers[0].message if answers else None
        if not isinstance(page, FramePage):
            self._feed(slam.FetchFailed(step.robot, step.life))
            return
        self.links.took(f"robot/{step.robot}", sum(map(len, page.frames)), time.monotonic() - begin)
        frames = tuple(frame for data in page.frames if (frame := self._spooled(data, step.robot)) is not None)
        self._feed(slam.PageCame(step.robot, step.life, page.stream, frames, page.oldest, page.next))

    def _spooled(self, data: bytes, robot: str) -> Frame | None:
        """A frame out of the robot's spool; None, told in the status, when it is none."""
        try:
            frame = decode(data, sender=f"robot/{robot}")
            if not isinstance(frame, Frame) or frame.robot != robot:
                raise BadMessage("its spool gave what is no frame of its own", f"robot/{robot}")
        except BadMessage as error:
            self._report.problem(str(error))
            return None
        return frame

    async def _finish(self, step: Finish) -> None:
        await self._answered(self._kernels.finish(step))
        # first its state: who has seen the final map must not find one from before it
        await self.bus.latch(keys.edge_status(self.edge), self._status())
        await self.maps.tell(step.robot)

    async def _release(self, step: Release) -> None:
        robot = step.robot
        with contextlib.suppress(WorkerDied):
            await self._kernels.close(step)
        for key in (keys.edge_ack(self.edge, robot), keys.edge_robot_map(self.edge, robot)):
            if robot not in self.state.instances:  # it may have come back
                await self.bus.unlatch(key)
        log.info("SLAM instance released", extra={"robot": robot})

    async def _acknowledge(self, robot: str) -> None:
        instance = self.state.instances.get(robot)
        if instance is not None and instance.stream:
            ack = Ack(
                robot=robot,
                edge=self.edge,
                stream=instance.stream,
                epoch=instance.epoch,
                processed=instance.processed,
                durable=instance.keeping.durable,
                window=self._fleet.edge.window,
            )
            await self.bus.latch(keys.edge_ack(self.edge, robot), ack)

    def _status(self) -> EdgeStatus:
        return self._report.status(self._dropped + sum(stream.dropped for stream in self._frames.values()))
