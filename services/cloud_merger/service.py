"""The cloud merger: the shell around its state machine and the process that merges."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Coroutine, Mapping
from typing import Any

from common.bus import Bus, keys
from common.bus.intake import Received
from common.bus.parameters import number
from common.bus.tiles import TILE_BYTES, fetch_tiles, tile_page
from common.config import Fleet
from common.errors import PeerError, QueryFailed, WorkerDied
from common.grid.versions import count_of
from common.link import LinkMeter
from common.service import Service
from common.telemetry import process_stats
from common.wire import (
    CloudStatus,
    EdgeMapNotice,
    GlobalMapNotice,
    MapNotice,
    Message,
    PoseTuple,
    RobotProfile,
    RobotStatus,
    Routes,
    Transforms,
    Verdicts,
    decode,
    encode,
)
from common.workers import WarmWorker, WorkerError
from services.cloud_merger import events as merging
from services.cloud_merger.joint import corrected
from services.cloud_merger.state import CloudState
from services.cloud_merger.trace import trace

TARGET = "services.cloud_merger.merge_host:MergeHost"

log = logging.getLogger(__name__)


class CloudMerger(Service):
    """The one cloud of a fleet; `run` returns when `stop` is set."""

    def __init__(self, fleet: Fleet, bus: Bus, stop: asyncio.Event) -> None:
        super().__init__(bus, stop)
        self._fleet = fleet
        self.state = CloudState(expected=fleet.expected_robots())
        self._process = WarmWorker("merging", TARGET, fleet.fusion.settings)
        self._statuses: dict[str, RobotStatus] = {}
        self._starts: dict[str, PoseTuple | None] = {}
        self._transfers: dict[str, float] = {}
        self._stages: dict[str, float] = {}
        self._shown: GlobalMapNotice | None = None
        self._whole = asyncio.Lock()
        """the merging process holds the map that is shown, not one that nobody was told of"""
        self._problems: deque[str] = deque(maxlen=16)
        self._links = LinkMeter()

    async def _open(self) -> None:
        await self._refuse_second(keys.CLOUD_STATUS, self._fleet.bus.timeout_s)
        await self._process.start()
        await self.bus.serve(keys.CLOUD_MAP, self._tiles)
        await self.bus.declare_alive(keys.CLOUD_ALIVE)

    def _begin(self) -> None:
        self._follow(
            keys.SCHEDULER_ROUTES,
            keys.edge_robot_map(keys.ANY, keys.ANY),
            keys.edge_map(keys.ANY),
            keys.edge_verdicts(keys.ANY),
            keys.robot_status(keys.ANY),
            keys.robot_profile(keys.ANY),
        )
        self._every(self._fleet.cloud.merge_every_s, self._tick, "tick")
        self._tell_status(keys.CLOUD_STATUS, self.status)

    async def _close(self) -> None:
        await self._process.close()

    # Events in

    def _heard(self, received: Received) -> None:
        match received.message:
            case Routes() as routes:
                self._feed(merging.Routed(routes))
            case MapNotice() as notice:
                self._feed(merging.MapNoticed(notice))
            case EdgeMapNotice() as notice:
                self._feed(merging.EdgeMapNoticed(notice))
            case Verdicts() as verdicts:
                self._feed(merging.VerdictsCame(keys.edge_of(received.key) or "", verdicts))
            case RobotStatus() as status:
                self._statuses[status.robot] = status
            case RobotProfile() as profile:
                self._starts[profile.robot] = profile.start

    async def _tick(self) -> None:
        await self._restart()
        self._feed(merging.Tick())

    # Instructions out

    def _feed(self, event: merging.Event) -> None:
        for step in self.state.handle(event):
            match step:
                case merging.FetchSketch():
                    self._do(self._fetch_sketch(step), f"sketch of {step.notice.robot}")
                case merging.FetchPart():
                    self._do(self._fetch_part(step), f"map of {step.notice.edge}")
                case merging.Forget(robot):
                    self._do(self._call("forget", robot=robot), f"forget {robot}")
                case merging.Solve():
                    self._do(self._solve(step), "solve")
                case merging.Compose():
                    self._do(self._compose(step), "compose")

    def _do(self, work: Coroutine[Any, Any, None], name: str) -> None:
        self._start(self._guarded(work), name)

    async def _guarded(self, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except WorkerDied:
            if not self._stop.is_set():
                await self._restart()

    async def _fetch_sketch(self, step: merging.FetchSketch) -> None:
        notice = step.notice
        key = keys.edge_robot_map(notice.edge, notice.robot)
        try:
            delta = await fetch_tiles(self.bus, key, kind="occupancy")
            if notice.final and not delta.final:
                raise QueryFailed("the map is not final any more; another notice will come", key)
            await self._call(
                "put_sketch",
                robot=notice.robot,
                resolution=delta.resolution,
                version=notice.version,
                final=notice.final,
                tiles=[(tile.x, tile.y, tile.data) for tile in delta.tiles],
            )
        except (PeerError, WorkerError) as error:
            self._problem(f"sketch of {notice.robot} from {notice.edge}: {error}")
            self._feed(merging.FetchFailed(step))
            return
        self._feed(merging.SketchFetched(step))

    async def _fetch_part(self, step: merging.FetchPart) -> None:
        begin, edge = asyncio.get_running_loop().time(), step.notice.edge
        try:
            delta = await fetch_tiles(self.bus, keys.edge_map(edge), step.since)
            self._links.took(f"edge/{edge}", delta.size, asyncio.get_running_loop().time() - begin)
            tiles = [(tile.x, tile.y, tile.data) for tile in delta.tiles]
            part = {"resolution": delta.resolution, "version": delta.version, "whole": delta.whole}
            await self._call("put_part", edge=edge, tiles=tiles, **part)
        except (PeerError, WorkerError) as error:
            log.debug("edge map not fetched", extra={"edge": edge, "reason": error})
            self._feed(merging.FetchFailed(step))
            return
        self._transfers[edge] = self._stages["transfer"] = asyncio.get_running_loop().time() - begin
        self._feed(merging.PartFetched(step, delta.version, delta.world_epoch, delta.covers, delta.final))

    async def _solve(self, step: merging.Solve) -> None:
        worker = self._process.up()
        try:
            done = await worker.call(
                "solve",
                robots=list(step.robots),
                pairs=list(step.pairs),
                verdicts=encode(Verdicts(owner="edges", pairs=step.verdicts)),
                final=step.final,
                previous=encode(step.previous) if step.previous is not None else None,
                above=step.above,
                starts={robot: pose for robot in step.robots if (pose := self._starts.get(robot)) is not None},
            )
        except WorkerError as error:
            self._problem(f"solve: {error}")
            self._feed(merging.Solved(None))
            return
        if step.final and self._fleet.cloud.joint and done["merged"]:
            done = await corrected(done, self.state.slam_edges(), self.bus, worker.call, self._problem)
        self._stages["solve"] = done["seconds"]
        self.state.counters["full pair checks"] = done["checks"]
        await self.bus.latch(keys.CLOUD_VERDICTS, decode(done["verdicts"]))
        transforms = decode(done["transforms"])
        assert isinstance(transforms, Transforms)
        if step.previous is None or transforms.world_epoch != step.previous.world_epoch:
            log.info("world", extra={"world_epoch": transforms.world_epoch, "reason": transforms.reason})
            await self.bus.latch(keys.CLOUD_TRANSFORMS, transforms)
        self._feed(merging.Solved(transforms))

    async def _compose(self, step: merging.Compose) -> None:
        async with self._whole:
            try:
                done = await self._call("compose", versions=dict(step.versions))
            except WorkerError as error:
                self._problem(f"compose: {error}")
                done = None
            if done is not None:
                if step.final:  # before anybody is told that the map is final
                    await self._export()
                await self._show(step, done)
        self._feed(merging.Composed(well=done is not None))

    async def _export(self) -> None:
        out = self._fleet.cloud.out
        if out is None:
            return
        try:
            await self._call("export", folder=str(out))
            log.info("final map exported", extra={"folder": out})
        except WorkerError as error:
            self._problem(f"cloud.out {out}: {error}")

    async def _show(self, step: merging.Compose, done: Mapping[str, Any]) -> None:
        self._stages["fuse"] = done["seconds"] + self._stages.get("solve", 0.0)
        robot_maps = {robot: held for robot, held in self.state.sketches.items() if robot in step.covers}
        notice = GlobalMapNotice(
            version=done["version"],
            world_epoch=step.world.world_epoch,
            final=step.final,
            resolution=done["resolution"],
            digest=done["digest"],
            components=step.world.components,
            covers=step.covers,
            changes=step.changes,
            trace=trace(
                step.versions, self.state.edge_maps, robot_maps, self._statuses, self._transfers, self._stages["fuse"]
            ),
        )
        self._shown = notice
        await self.bus.latch(keys.CLOUD_MAP, notice)
        contents = {"robots": len(notice.covers), "components": len(notice.components), "final": notice.final}
        log.info("global map", extra={"version": count_of(notice.version), **contents})
        for change in notice.changes:
            log.info("changed", extra={"version": count_of(notice.version), "reason": change})

    async def _tiles(self, key: str, params: Mapping[str, str]) -> Message:
        since, cursor = number(params, "since"), params.get("cursor", "")
        async with self._whole:
            shown = self._shown
            if shown is None:
                raise PeerError("no global map yet; wait for the first notice", "cloud")
            page = await self._call("tiles", since=since, cursor=cursor, limit_bytes=TILE_BYTES)
        return tile_page("cloud", "counts", page, shown.covers, shown.final, shown.world_epoch)

    def status(self) -> CloudStatus:
        used = process_stats(self._process.pids())
        refused = self.bus.counters.refused.total()
        return CloudStatus(
            version=self._shown.version if self._shown is not None else 0,
            world_epoch=self.state.world.world_epoch if self.state.world is not None else 0,
            robots=tuple(sorted(self.state.members)),
            components=len(self.state.world.components) if self.state.world is not None else 0,
            cpu_s=used.cpu_s,
            rss_mb=used.rss_mb,
            stages=dict(self._stages),
            counters={**self.state.counters, "messages refused": refused, "dropped": self.bus.counters.dropped},
            bytes_in=self.bus.counters.received_bytes,
            links=self._links.statuses(),
            problems=(*self.bus.problems, *self._problems)[-16:],
        )

    def _problem(self, text: str) -> None:
        log.warning("%s", text)
        self._problems.append(text[:500])

    async def _call(self, method: str, **arguments: Any) -> Any:
        return await self._process.up().call(method, **arguments)

    async def _restart(self) -> None:
        """Another merging process if it has died, and everything fetched anew."""
        try:
            if not await self._process.replaced():
                return
        except (WorkerDied, WorkerError, OSError) as error:
            self._problem(f"merging process: {error}; trying again")
            return  # the next tick does
        self.state = self.state.empty_handed()
        self._feed(merging.Tick())
