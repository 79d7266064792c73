"""Robot maps as the edge shows them: notices of new versions, pages of tiles and of trajectories."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from common.bus import Bus, keys
from common.bus.parameters import number
from common.bus.tiles import TILE_BYTES, tile_page
from common.errors import PeerError, UsageError, WorkerDied
from common.wire import Cover, Epoch, MapNotice, Message, decode
from common.workers import WorkerError
from services.edge_worker.instance import Instance
from services.edge_worker.phase import Phase
from services.edge_worker.pool import Pool
from services.edge_worker.state import EdgeState


class RobotMaps:
    """Answers and tells about the maps of the robots that run here."""

    def __init__(self, edge: str, state: EdgeState, pool: Pool, bus: Bus) -> None:
        self._edge, self._state, self._pool, self._bus = edge, state, pool, bus
        self._told: dict[str, tuple[Epoch, int, bool]] = {}
        """robot → epoch, version and finality of the last notice"""
        self.delays: dict[str, deque[float]] = {}
        """robot → recent times of a frame from its hands to ours, s"""
        self.scan_s: dict[str, float] = {}
        """robot → mean time of a scan lately"""

    async def open(self) -> None:
        await self._bus.serve(keys.edge_robot_map(self._edge, keys.ANY), self._tiles)
        await self._bus.serve(keys.edge_trajectory(self._edge, keys.ANY), self._trajectory)

    def delayed(self, robot: str, seconds: float) -> None:
        """A frame has taken this long to come."""
        self.delays.setdefault(robot, deque(maxlen=100)).append(max(0.0, seconds))

    def forget(self, robot: str) -> None:
        for known in (self._told, self.delays, self.scan_s):
            known.pop(robot, None)

    async def tell_all(self, worker: int) -> None:
        """Tell of all robots in this worker; one that is stuck holds up nobody in others."""
        for robot, instance in sorted(self._state.instances.items()):
            if instance.worker == worker:
                await self.tell(robot)

    async def tell(self, robot: str) -> None:
        """Publish a notice if the robot's map is another than last told."""
        instance = self._state.instances.get(robot)
        if instance is None or instance.phase is Phase.OPENING or not instance.stream:
            return
        life = instance.life
        try:
            news = await self._pool.call(instance.worker, "news", robot=robot)
        except (WorkerDied, WorkerError):
            return  # being opened anew: it will have news then
        final = bool(news["final"]) and instance.phase is Phase.FINAL
        told = (instance.epoch, news["version"], final)
        if instance.life != life or self._told.get(robot) == told:
            return
        self._told[robot] = told
        self.scan_s[robot] = news["scan_s"]
        delays = self.delays.get(robot) or [0.0]
        notice = MapNotice(
            robot=robot,
            edge=self._edge,
            epoch=instance.epoch,
            version=news["version"],
            resolution=news["resolution"],
            cover=_cover(instance, news),
            final=final,
            slam_s=news["slam_s"],
            transfer_s=sum(delays) / len(delays),
        )
        await self._bus.latch(keys.edge_robot_map(self._edge, robot), notice)

    async def _tiles(self, key: str, params: Mapping[str, str]) -> Message:
        robot, instance = self._instance(key)
        kind = params.get("kind", "counts")
        if kind not in ("counts", "occupancy"):
            raise UsageError(f"parameter kind={kind[:40]!r} is none: ask for counts or occupancy")
        page: dict[str, Any] = await self._pool.call(
            instance.worker,
            "tiles",
            robot=robot,
            kind=kind,
            since=number(params, "since"),
            cursor=params.get("cursor", ""),
            limit_bytes=TILE_BYTES,
        )
        final = bool(page["final"]) and instance.phase is Phase.FINAL
        covers = {robot: _cover(instance, page)} if instance.stream else {}
        return tile_page(f"robot/{robot}", kind, page, covers, final, 0)

    async def _trajectory(self, key: str, params: Mapping[str, str]) -> Message:
        robot, instance = self._instance(key)
        start = number(params, "cursor" if "cursor" in params else "from")
        return decode(await self._pool.call(instance.worker, "trajectory", robot=robot, start=start))

    def _instance(self, key: str) -> tuple[str, Instance]:
        robot = keys.robot_of(key) or ""
        if robot not in self._state.instances:
            raise PeerError(f"{robot} does not run here; ask the edge that the routing table names")
        return robot, self._state.instances[robot]


def _cover(instance: Instance, news: Mapping[str, Any]) -> Cover:
    return Cover(
        stream=instance.stream,
        seq=news["seq"],
        epoch=instance.epoch,
        corrections=news["corrections"],
        corrected_m=news["corrected_m"],
    )
