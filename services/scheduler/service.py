"""The scheduler: the shell around its state machine and the planning process."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Coroutine
from typing import Any

from common.bus import Bus, keys
from common.bus.tiles import fetch_tiles
from common.config import Fleet
from common.errors import PeerError, WorkerDied
from common.service import Stopped, until_stopped
from common.wire import (
    Claims,
    EdgeStatus,
    MapNotice,
    OverlapMatrix,
    Plan,
    RobotProfile,
    RobotStatus,
    SchedulerStatus,
    Transforms,
    decode,
    encode,
)
from common.workers import Worker, WorkerError
from services.scheduler import state as scheduling
from services.scheduler.state import MakePlan, Publish, SchedulerState
from services.scheduler.topology import Topology

TARGET = "services.scheduler.plan_host:PlanHost"
TICK_S = 0.2
STATUS_S = 1.0

log = logging.getLogger(__name__)


class Scheduler:
    """The one scheduler of a fleet; `run` returns when `stop` is set."""

    def __init__(self, fleet: Fleet, bus: Bus, stop: asyncio.Event) -> None:
        self._fleet, self._bus, self._stop = fleet, bus, stop
        self._clock = asyncio.get_running_loop().time
        self.state = SchedulerState(Topology(fleet.topology), fleet.edge_ids(), fleet.bus.grace_s)
        self._worker: Worker | None = None
        self._notices: dict[tuple[str, str], MapNotice] = {}
        self._sketched: dict[str, MapNotice] = {}
        self._statuses: dict[str, RobotStatus] = {}
        self._cores: dict[str, int] = {}
        self._world: Transforms | None = None
        self._stages: dict[str, float] = {}
        self._plans = 0
        self._problems: deque[str] = deque(maxlen=16)
        self._tasks = asyncio.TaskGroup()

    async def run(self) -> None:
        try:
            if await until_stopped(self._open(), self._stop):
                return
            async with self._tasks as tasks:
                self._feed(scheduling.Claimed(await self._claims(), self._clock()))
                await self._bus.declare_alive(keys.SCHEDULER_ALIVE)
                log.info("ready")
                for key in (
                    keys.robot_profile(keys.ANY),
                    keys.robot_status(keys.ANY),
                    keys.edge_status(keys.ANY),
                    keys.edge_claims(keys.ANY),
                    keys.edge_robot_map(keys.ANY, keys.ANY),
                    keys.CLOUD_TRANSFORMS,
                ):
                    tasks.create_task(self._hear(key), name=f"hear {key}")
                tasks.create_task(self._hear_link(), name="link")
                tasks.create_task(self._hear_alive(keys.robot_alive(keys.ANY)), name="robots")
                tasks.create_task(self._hear_alive(keys.edge_alive(keys.ANY)), name="edges")
                tasks.create_task(self._tick(), name="tick")
                tasks.create_task(self._interval(), name="interval")
                tasks.create_task(self._report(), name="status")
                await self._stop.wait()
                raise Stopped
        except* Stopped:
            pass
        finally:
            if self._worker is not None:
                await self._worker.close()

    async def _open(self) -> None:
        self._worker = await Worker.start(TARGET)
        await self._worker.ready()

    async def _claims(self) -> tuple[Claims, ...]:
        """Robots that edges run already keep their places; who does not answer now is heard later."""
        try:
            answers = await self._bus.get(keys.edge_claims(keys.ANY), everyone=True)
        except PeerError as error:
            self._problem(f"claims: {error}")
            return ()
        return tuple(answer.message for answer in answers if isinstance(answer.message, Claims))

    # Events in

    async def _hear(self, key_expr: str) -> None:
        async for received in self._bus.watch(key_expr):
            match received.message:
                case RobotProfile() as profile:
                    self._feed(scheduling.Profiled(profile, self._clock()))
                case RobotStatus() as status:
                    self._statuses[status.robot] = status
                case EdgeStatus() as status:
                    self._cores[status.edge] = status.cores
                case Claims() as claims:
                    self._feed(scheduling.Claimed((claims,), self._clock()))
                case MapNotice() as notice:
                    self._notices[notice.robot, notice.edge] = notice
                case Transforms() as transforms:
                    self._world = transforms

    async def _hear_link(self) -> None:
        async for link in self._bus.watch_link():
            self._feed(scheduling.Linked(link.up, self._clock()))

    async def _hear_alive(self, key_expr: str) -> None:
        async for token in self._bus.watch_alive(key_expr):
            tier, name = keys.owner(token.key)
            if tier == "robot":
                self._feed(scheduling.RobotSeen(name, token.alive, self._clock()))
            else:
                self._feed(scheduling.EdgeSeen(name, token.alive, self._clock()))

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            self._feed(scheduling.Tick(self._clock()))

    async def _interval(self) -> None:
        while True:
            await asyncio.sleep(self._fleet.scheduler.interval_s)
            self._feed(scheduling.Interval(self._clock()))

    # Instructions out

    def _feed(self, event: scheduling.Event) -> None:
        for step in self.state.handle(event):
            match step:
                case Publish():
                    self._start(self._publish(step), "publish")
                case MakePlan():
                    self._start(self._plan(step), "plan")

    def _start(self, work: Coroutine[Any, Any, None], name: str) -> None:
        self._tasks.create_task(work, name=name)

    async def _publish(self, step: Publish) -> None:
        log.info("routes", extra={"epoch": step.routes.epoch, "reason": step.reason})
        await self._bus.latch(keys.SCHEDULER_ROUTES, step.routes)

    async def _plan(self, step: MakePlan) -> None:
        try:
            await self._fetch_sketches(step.robots)
            made = await self._make(step)
        except (WorkerError, WorkerDied) as error:
            self._problem(f"plan: {error}")
            await self._restart()
            self._feed(scheduling.PlanFailed())
            return
        self._plans += 1
        self._stages["plan"] = made["seconds"]
        overlap = decode(made["overlap"])
        if isinstance(overlap, OverlapMatrix):
            await self._bus.latch(keys.SCHEDULER_OVERLAP, overlap)
        self._feed(scheduling.Planned(step.epoch, made["slam"], made["fuse"], self._clock()))
        plan = Plan(
            epoch=self.state.epoch,
            policy=self._fleet.scheduler.policy,
            groups={edge: tuple(robots) for edge, robots in made["groups"].items()},
            in_group=made["in_group"],
            cut=made["cut"],
            predicted=made["predicted"],
            alternative=made["alternative"],
            reason=made["reason"],
            seconds=made["seconds"],
        )
        await self._bus.latch(keys.SCHEDULER_PLAN, plan)

    async def _fetch_sketches(self, robots: tuple[str, ...]) -> None:
        """What has changed of the robot maps since the last plan."""
        for robot in robots:
            notice = self._notices.get((robot, self.state.routes[robot].slam_edge))
            if notice is None or notice == self._sketched.get(robot):
                continue
            try:
                delta = await fetch_tiles(self._bus, keys.edge_robot_map(notice.edge, robot), kind="occupancy")
            except PeerError as error:
                log.debug("sketch not fetched", extra={"robot": robot, "reason": error})
                continue
            tiles = [(tile.x, tile.y, tile.data) for tile in delta.tiles]
            await self._call("put_sketch", robot=robot, resolution=delta.resolution, tiles=tiles)
            self._sketched[robot] = notice

    async def _make(self, step: MakePlan) -> Any:
        config = self._fleet.scheduler
        entries = {entry.id: entry for entry in self._fleet.edges}
        edges = [
            {
                "name": edge,
                "speed": entries[edge].speed if edge in entries else 1.0,
                "bandwidth": (entries[edge].bandwidth_mbps if edge in entries else 1000.0) * 1e6 / 8,
                "cores": self._cores.get(edge, 1),
            }
            for edge in step.edges
        ]
        return await self._call(
            "plan",
            robots=[self._robot(robot, step.edges) for robot in step.robots],
            edges=edges,
            transforms=encode(self._world) if self._world is not None else None,
            policy=config.policy,
            budget_s=config.budget_s,
            kappa=config.kappa,
            tau=config.tau,
            hysteresis=config.hysteresis,
        )

    def _robot(self, robot: str, edges: tuple[str, ...]) -> dict[str, Any]:
        route, profile = self.state.routes[robot], self.state.profiles.get(robot)
        status = self._statuses.get(robot)
        notice = self._notices.get((robot, route.slam_edge))
        frames = notice.cover.seq + 1 if notice is not None else 0
        sent = max(1, status.sent) if status is not None else 1
        return {
            "name": robot,
            "reach": self.state.reachable(robot, list(edges)),
            "start": profile.start if profile is not None else None,
            "range_max": profile.range_max if profile is not None else 0.0,
            "frame_bytes": status.bytes_sent / sent if status is not None else 1000.0,
            "slam_s": notice.slam_s / frames if notice is not None and frames else 0.005,
            "pack_s": status.pack_s if status is not None else 0.0,
            "frames": frames,
            "slam": route.slam_edge,
            "fuse": route.fuse_edge,
        }

    async def _report(self) -> None:
        while True:
            await self._bus.latch(keys.SCHEDULER_STATUS, self.status())
            await asyncio.sleep(STATUS_S)

    def status(self) -> SchedulerStatus:
        def word(alive: bool) -> str:
            return "alive" if alive else "gone"

        state = self.state
        stranded = [f"robot/{robot}: no edge that it reaches is there" for robot in sorted(state.stranded)]
        return SchedulerStatus(
            epoch=state.epoch,
            policy=self._fleet.scheduler.policy,
            robots={robot: word(seen.alive) for robot, seen in sorted(state.robots.items())},
            edges={edge: word(seen.alive) for edge, seen in sorted(state.edges.items())},
            plans=self._plans,
            moved=state.moved,
            stages=dict(self._stages),
            counters={**state.counters, "messages refused": self._bus.counters.refused.total()},
            problems=(*self._bus.problems, *self._problems, *stranded)[-16:],
        )

    def _problem(self, text: str) -> None:
        log.warning("%s", text)
        self._problems.append(text[:500])

    async def _call(self, method: str, **arguments: Any) -> Any:
        if self._worker is None:
            raise WorkerDied("the planning process is not up")
        return await self._worker.call(method, **arguments)

    async def _restart(self) -> None:
        if self._worker is not None and self._worker.gone.is_set() and not self._stop.is_set():
            self._sketched.clear()
            self._worker = await Worker.start(TARGET)
