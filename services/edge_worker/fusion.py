"""Preparative fusion: the shell around the state machine of fusing.py and the process that computes."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from typing import Any

from common.bus import Bus, keys
from common.bus.parameters import number
from common.bus.tiles import TILE_BYTES, fetch_tiles, tile_page
from common.config import Fleet
from common.errors import PeerError, QueryFailed, WorkerDied
from common.link import LinkMeter
from common.wire import Component, Cover, EdgeMapNotice, MapNotice, Message, Routes, Transforms, decode, encode
from common.workers import WarmWorker, WorkerError
from services.edge_worker import fusing
from services.edge_worker.fusing import FusingState

TARGET = "services.edge_worker.fusion_host:FusionHost"
RETRY_S = 1.0

log = logging.getLogger(__name__)


class Fusion:
    """Fetches the robot maps that the routing table sends here, fuses them and shows the edge map."""

    def __init__(self, fleet: Fleet, edge: str, bus: Bus, links: LinkMeter) -> None:
        self._fleet, self._edge, self._bus, self._links = fleet, edge, bus, links
        self.state = FusingState(edge)
        self._process = WarmWorker("fusion", TARGET, fleet.fusion.settings)
        self._steps: asyncio.Queue[fusing.Instruction | None] = asyncio.Queue(maxsize=4096)
        self._shown: EdgeMapNotice | None = None
        self.stages: dict[str, float] = {}
        """seconds of the last run of each stage"""
        self.failures = 0
        self._missing: dict[str, str] = {}
        """robot → why its map could not be taken the last time"""

    async def open(self) -> None:
        await self._process.start()
        await self._bus.serve(keys.edge_map(self._edge), self._tiles)

    async def close(self) -> None:
        await self._process.close()

    def pids(self) -> list[int]:
        return self._process.pids()

    def problems(self) -> list[str]:
        """Whose maps of those to be fused here cannot be, and why."""
        missing = sorted((robot, why) for robot, why in self._missing.items() if robot in self.state.members)
        return [f"robot/{robot}: its map is not fused: {why}" for robot, why in missing]

    def routed(self, routes: Routes) -> None:
        self._feed(fusing.Routed(routes))

    def noticed(self, notice: MapNotice) -> None:
        self._feed(fusing.MapNoticed(notice))

    def world_seen(self, transforms: Transforms) -> None:
        self._feed(fusing.WorldSeen(transforms))

    async def run(self) -> None:
        """Carry out instructions one by one, with a tick every `map_every_s`."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._tick(), name="fusion tick")
            guard = tasks.create_task(self._guard(), name="fusion guard")
            while True:
                step = await self._steps.get()
                try:
                    if step is None:
                        raise WorkerDied("the fusion process has ended")
                    await self._carry_out(step)
                except WorkerDied as death:
                    log.error("starting another fusion process; all maps are fetched anew", extra={"reason": death})
                    guard.cancel()
                    await self._restart()
                    guard = tasks.create_task(self._guard(), name="fusion guard")

    async def _guard(self) -> None:
        """Wake `run` when the process dies while it has nothing to do."""
        await self._process.up().gone.wait()
        self._steps.put_nowait(None)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(self._fleet.edge.map_every_s)
            self._feed(fusing.Tick())

    def _feed(self, event: fusing.Event) -> None:
        for step in self.state.handle(event):
            self._steps.put_nowait(step)

    async def _carry_out(self, step: fusing.Instruction) -> None:
        match step:
            case fusing.Fetch():
                await self._fetch(step)
            case fusing.Forget(robot):
                await self._call("forget", robot=robot)
            case fusing.Fuse():
                await self._fuse(step)

    async def _fetch(self, step: fusing.Fetch) -> None:
        begin = asyncio.get_running_loop().time()
        notice = step.notice
        try:
            delta = await fetch_tiles(self._bus, keys.edge_robot_map(notice.edge, notice.robot), step.since)
            if notice.edge != self._edge:
                self._links.took(f"edge/{notice.edge}", delta.size, asyncio.get_running_loop().time() - begin)
            cover = delta.covers.get(notice.robot)
            if cover is None:
                raise QueryFailed("the map does not say what it contains; fetch again", f"edge/{notice.edge}")
            await self._call(
                "put",
                robot=notice.robot,
                resolution=delta.resolution,
                version=delta.version,
                final=delta.final,
                cover=cover.model_dump(),
                tiles=[(tile.x, tile.y, tile.data) for tile in delta.tiles],
                whole=delta.whole,
            )
        except (PeerError, WorkerError) as error:
            self.failures += 1
            self._missing[notice.robot] = str(error)
            log.info("robot map not fetched", extra={"robot": notice.robot, "edge": notice.edge, "reason": error})
            self._feed(fusing.FetchFailed(step))
            return
        self._missing.pop(notice.robot, None)
        self.stages["transfer"] = asyncio.get_running_loop().time() - begin
        self._feed(fusing.Fetched(step, delta.version, cover, delta.final))

    async def _fuse(self, step: fusing.Fuse) -> None:
        world = encode(step.world) if step.world is not None else None
        try:
            done = await self._call("fuse", edge=self._edge, robots=list(step.robots), world=world)
        except WorkerError as error:
            self.failures += 1
            log.error("fusion failed", extra={"edge": self._edge, "reason": error})
            self._feed(fusing.Fused(well=False))
            return
        self.stages["fuse"] = done["seconds"]
        await self._bus.latch(keys.edge_verdicts(self._edge), decode(done["verdicts"]))
        await self._show(step, done)
        self._feed(fusing.Fused(well=True))

    async def _show(self, step: fusing.Fuse, done: Mapping[str, Any]) -> None:
        """Publish the notice of the edge map."""
        covers = {robot: Cover.model_validate(cover) for robot, cover in done["covers"].items()}
        notice = EdgeMapNotice(
            edge=self._edge,
            version=done["version"],
            world_epoch=done["world_epoch"],
            resolution=done["resolution"],
            components=tuple(Component.model_validate(each) for each in done["components"]),
            covers=covers,
            final=step.whole and done["final"] and step.world is not None and step.world.final,
            fuse_s=self.stages.get("fuse", 0.0),
            transfer_s=self.stages.get("transfer", 0.0),
            area_m2=done["area_m2"],
        )
        self._shown = notice
        await self._bus.latch(keys.edge_map(self._edge), notice)

    async def _tiles(self, key: str, params: Mapping[str, str]) -> Message:
        shown = self._shown
        if shown is None:
            raise PeerError("no edge map yet: nothing has been fused here", f"edge/{self._edge}")
        page = await self._call(
            "tiles",
            since=number(params, "since"),
            cursor=params.get("cursor", ""),
            limit_bytes=TILE_BYTES,
        )
        if page["version"] != shown.version:
            raise PeerError("a fusion is under way; ask again after the next notice", f"edge/{self._edge}")
        return tile_page(f"edge/{self._edge}", "counts", page, shown.covers, shown.final, shown.world_epoch)

    async def _call(self, method: str, **arguments: Any) -> Any:
        return await self._process.up().call(method, **arguments)

    async def _restart(self) -> None:
        """Another process, tried for until one has come up: SLAM goes on meanwhile."""
        while True:
            try:
                await self._process.replaced()
                break
            except (WorkerDied, WorkerError, OSError) as error:
                log.error("the fusion process did not come up; trying again", extra={"reason": error})
                await asyncio.sleep(RETRY_S)
        while not self._steps.empty():  # of maps and fusions that died with the process
            self._steps.get_nowait()
        members, notices, world, epoch = (
            self.state.members,
            self.state.notices,
            self.state.world,
            self.state.epoch,
        )
        self.state = FusingState(self._edge, epoch, members, notices, world=world)
        self._feed(fusing.Tick())
