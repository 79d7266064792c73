"""The scheduler: the shell around its state machine and the planning process."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from common.bus import Bus, keys
from common.bus.intake import Received
from common.bus.tiles import fetch_tiles
from common.config import Fleet
from common.errors import PeerError, UsageError, WorkerDied
from common.presence import Linked, RobotSeen
from common.service import Service
from common.wire import (
    Claims,
    EdgeStatus,
    MapNotice,
    OverlapMatrix,
    Plan,
    RobotProfile,
    SchedulerStatus,
    decode,
    encode,
)
from common.workers import Worker, WorkerError
from services.scheduler import events as scheduling
from services.scheduler.events import MakePlan, Publish
from services.scheduler.inputs import Inputs
from services.scheduler.overload import Overloads
from services.scheduler.profile import load_profile
from services.scheduler.state import SchedulerState
from services.scheduler.topology import Topology
from services.scheduler.what_if import WhatIf

TARGET = "services.scheduler.plan_host:PlanHost"
TICK_S = 0.2
AT_ONCE = 50
"""robots whose measurements are gathered for a plan before others have their turn"""
AS_IT_IS = WhatIf()

log = logging.getLogger(__name__)


class Scheduler(Service):
    """The one scheduler of a fleet; `run` returns when `stop` is set."""

    def __init__(self, fleet: Fleet, bus: Bus, stop: asyncio.Event) -> None:
        super().__init__(bus, stop)
        self._fleet = fleet
        self._clock = asyncio.get_running_loop().time
        # Robots and the cloud may have heard tables of an earlier scheduler of which no edge is left to tell.
        term = int(time.time())
        self.state = SchedulerState(Topology(fleet.topology), fleet.edge_ids(), fleet.bus.grace_s, term)
        self._worker: Worker | None = None
        self._inputs = Inputs(fleet, load_profile(fleet.scheduler.profile))
        self._overloads = Overloads(self._inputs, 0 if fleet.robot.realtime else fleet.edge.window)
        self._sketched: dict[str, MapNotice] = {}
        self._stages: dict[str, float] = {}
        self._plans = 0
        self._problems: deque[str] = deque(maxlen=16)

    async def _open(self) -> None:
        await self._refuse_second(keys.SCHEDULER_STATUS, self._fleet.bus.timeout_s)
        self._worker = await Worker.start(TARGET)
        await self._worker.ready()
        self._feed(scheduling.Claimed(await self._claims(), self._clock()))
        await self.bus.serve(keys.SCHEDULER_PLAN, self._asked)
        await self.bus.declare_alive(keys.SCHEDULER_ALIVE)

    def _begin(self) -> None:
        self._follow(
            keys.robot_profile(keys.ANY),
            keys.robot_status(keys.ANY),
            keys.edge_status(keys.ANY),
            keys.edge_claims(keys.ANY),
            keys.edge_robot_map(keys.ANY, keys.ANY),
            keys.edge_map(keys.ANY),
            keys.CLOUD_TRANSFORMS,
            keys.CLOUD_STATUS,
        )
        self._follow_presence(keys.robot_alive(keys.ANY), keys.edge_alive(keys.ANY))
        self._every(TICK_S, lambda: self._feed(scheduling.Tick(self._clock())), "tick")
        self._every(
            self._fleet.scheduler.interval_s, lambda: self._feed(scheduling.Interval(self._clock())), "interval"
        )
        self._tell_status(keys.SCHEDULER_STATUS, self.status)

    async def _close(self) -> None:
        if self._worker is not None:
            await self._worker.close()

    async def _claims(self) -> tuple[Claims, ...]:
        """Robots that edges run already keep their places; who does not answer now is heard later."""
        try:
            answers = await self.bus.get(keys.edge_claims(keys.ANY), everyone=True)
        except PeerError as error:
            self._problem(f"claims: {error}")
            return ()
        return tuple(answer.message for answer in answers if isinstance(answer.message, Claims))

    # Events in

    def _heard(self, received: Received) -> None:
        self._inputs.hear(received.message, self._clock())
        match received.message:
            case RobotProfile() as profile:
                self._feed(scheduling.Profiled(profile, self._clock()))
            case Claims() as claims:
                self._feed(scheduling.Claimed((claims,), self._clock()))
            case EdgeStatus() as status:
                self._relieve(status)

    def _relieve(self, status: EdgeStatus) -> None:
        """Take robots off an edge that cannot keep up; `static` leaves all where they are."""
        self._overloads.reported(status, self._clock())
        if self._fleet.scheduler.policy == "static" or not self.state.topology.regroups:
            return
        rested = self.state.rested_edges(self._clock())
        reach = {each.robot: self.state.reachable(each.robot, rested) for each in status.instances}
        relief = self._overloads.relief(status.edge, reach)
        if relief is None:
            return
        if not relief.moves:
            self._problem(relief.reason)
        self._feed(scheduling.Relieved(status.edge, relief.moves, relief.reason, self._clock()))

    def _linked(self, up: bool) -> None:
        self._feed(Linked(up, self._clock()))

    def _seen(self, tier: str, name: str, alive: bool) -> None:
        kind = RobotSeen if tier == "robot" else scheduling.EdgeSeen
        self._feed(kind(name, alive, self._clock()))

    # Instructions out

    def _feed(self, event: scheduling.Event) -> None:
        for step in self.state.handle(event):
            match step:
                case Publish():
                    self._start(self._publish(step), "publish")
                case MakePlan():
                    self._start(self._plan(step), "plan")

    async def _publish(self, step: Publish) -> None:
        log.info("routes", extra={"epoch": step.routes.epoch, "reason": step.reason})
        await self.bus.latch(keys.SCHEDULER_ROUTES, step.routes)

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
        overlap = decode(made["overlap"]) if made["overlap"] is not None else None
        if isinstance(overlap, OverlapMatrix):
            await self.bus.latch(keys.SCHEDULER_OVERLAP, overlap)
        self._feed(scheduling.Planned(step.epoch, made["slam"], made["fuse"], self._clock()))
        await self.bus.latch(keys.SCHEDULER_PLAN, self._message(made))

    async def _asked(self, key: str, params: Mapping[str, str]) -> Plan | None:
        """What would be planned if edges were down, slower or faster; nothing is changed by the question."""
        if "what_if" not in params:
            return None  # the plan itself is latched; there is none yet
        what_if, alive = WhatIf.parse(params["what_if"]), self.state.alive_edges()
        what_if.check(alive)
        edges = [edge for edge in alive if edge not in what_if.down]
        known = [robot for robot in sorted(self.state.routes) if self.state.reachable(robot, edges)]
        if not known:
            raise UsageError("no robot that reaches one of these edges has come yet")
        stranded = sorted(set(self.state.routes) - set(known))
        made = await self._make(MakePlan(self.state.epoch, tuple(known), tuple(edges)), what_if)
        if stranded:
            made["reason"] += f"; without an edge: {', '.join(stranded)}"
        return self._message(made)

    def _message(self, made: dict[str, Any]) -> Plan:
        said = {name: made[name] for name in Plan.model_fields if name in made}
        return Plan.model_validate({**said, "epoch": self.state.epoch, "policy": self._fleet.scheduler.policy})

    async def _fetch_sketches(self, robots: tuple[str, ...]) -> None:
        """What has changed of the robot maps since the last plan."""
        for robot in robots:
            notice = self._inputs.notices.get((robot, self.state.routes[robot].slam_edge))
            if notice is None or notice == self._sketched.get(robot):
                continue
            try:
                delta = await fetch_tiles(self.bus, keys.edge_robot_map(notice.edge, robot), kind="occupancy")
            except PeerError as error:
                log.debug("sketch not fetched", extra={"robot": robot, "reason": error})
                continue
            tiles = [(tile.x, tile.y, tile.data) for tile in delta.tiles]
            try:
                await self._call("put_sketch", robot=robot, resolution=delta.resolution, tiles=tiles)
            except WorkerError as error:  # planned without it until there is another
                self._problem(f"edge/{notice.edge}: sketch of {robot}: {error}")
            self._sketched[robot] = notice

    async def _make(self, step: MakePlan, what_if: WhatIf = AS_IT_IS) -> dict[str, Any]:
        config, inputs, state = self._fleet.scheduler, self._inputs, self.state
        edges, rows = list(step.edges), []
        for first in range(0, len(step.robots), AT_ONCE):
            robots = step.robots[first : first + AT_ONCE]
            reach = {robot: state.reachable(robot, edges) for robot in robots}
            rows += inputs.robot_rows(robots, edges, state.routes, reach)
            await asyncio.sleep(0)  # whoever asks for something meanwhile is answered
        made: dict[str, Any] = await self._call(
            "plan",
            robots=rows,
            edges=inputs.edge_rows(edges, what_if.speed),
            transforms=encode(inputs.world) if inputs.world is not None else None,
            policy=config.policy,
            budget_s=config.budget_s,
            kappa=config.kappa,
            tau=config.tau,
            hysteresis=config.hysteresis,
            fusion=inputs.fusion(),
            horizon=config.horizon_s / self._fleet.edge.map_every_s,
            noise=inputs.noise(),
        )
        for problem in made["problems"]:
            self._problem(problem)
        return made

    def status(self) -> SchedulerStatus:
        def word(alive: bool) -> str:
            return "alive" if alive else "gone"

        state, edges = self.state, self.state.alive_edges()
        stranded = [f"robot/{robot}: no edge that it reaches is there" for robot in sorted(state.stranded)]
        return SchedulerStatus(
            epoch=state.epoch,
            policy=self._fleet.scheduler.policy,
            robots={robot: word(seen.alive) for robot, seen in sorted(state.robots.items())},
            edges={edge: word(seen.alive) for edge, seen in sorted(state.edges.items())},
            plans=self._plans,
            moved=state.moved,
            stages=dict(self._stages),
            counters={**state.counters, "messages refused": self.bus.counters.refused.total()},
            measured={
                **self._inputs.figures(edges),
                **{f"late {edge} s": self._overloads.late_s(edge) for edge in edges},
            },
            problems=(*self.bus.problems, *self._problems, *stranded)[-16:],
        )

    def _problem(self, text: str) -> None:
        if text[:500] not in self._problems:  # as long as it stays, every plan meets it again
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
